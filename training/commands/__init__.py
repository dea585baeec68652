"""The commands of `fovconn`, one a module: what it is told, what it prints. The work is done elsewhere."""
