"""Evaluation, training and the `fovconn` command."""

if __name__ == "training":  # found in a clone's root: a second copy of every class would follow
    raise ImportError("write `from fovconn_env import training`, not `import training`: it is a part of fovconn_env")
