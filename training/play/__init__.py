"""`fovconn play`: a person flies the leader or another robot. Only `app`, `panels` and `cockpit` import pygame."""
