"""A folder of the user's that is called like one of the clone."""

OWNER = "user"
