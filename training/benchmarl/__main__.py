"""BenchMARL's own command with our tasks: `python -m fovconn_env.training.benchmarl task=fovconn/mix ...`."""

from benchmarl.run import hydra_experiment

import fovconn_env.training.benchmarl  # noqa: F401  registers the tasks

hydra_experiment()
