"""`fovconn play`: a person flies the leader, or any other robot. Only `app`, `panels` and `cockpit` know pygame."""
