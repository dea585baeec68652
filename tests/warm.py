"""What a process that flies needs, for forks of one process to have it: they take a tenth of the time of new ones.

It is what a new process imports, and the kernels. `multiprocessing.forkserver` imports this; it starts no threads.
"""

from fovconn_env import scenario
from fovconn_env.baselines import POLICIES
from fovconn_env.flights.metrics import compile_ahead
from fovconn_env.training.evaluation import campaign  # noqa: F401

compile_ahead(POLICIES["expert"], scenario())
