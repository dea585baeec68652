"""BenchMARL: our scenarios as its tasks, known to BenchMARL and its hydra commands once this is imported."""

from fovconn_env.training.benchmarl.tasks import CONF, Fovconn, FovconnTask, register

__all__ = ["CONF", "Fovconn", "FovconnTask"]

register()
