"""Timing: what `fovconn bench` does."""
