"""Evaluation, training and the `fovconn` command."""
