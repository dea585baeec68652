"""The arrays of a batch, in one block of memory."""

import numpy as np

from fovconn_env.sim.memory import LINE, allocate
from tests.helpers import small


def test_arrays_begin_cache_lines_and_share_no_byte():
    world, state = allocate(small(lambda2="flooding", n_agents=3, camera={"identify": 1.0, "latency": 0.05}), 5, 2, 7)
    for arrays in (state[:-4], [world.piece, world.vertex, world.waypoint, world.n_waypoints]):
        for number, array in enumerate(arrays, 1):
            assert array.ctypes.data % LINE == 0
            assert array.flags.c_contiguous
            assert array.flags.writeable
            assert not array.view(np.uint8).any()
            array.reshape(-1).view(np.uint8)[:] = number
        for number, array in enumerate(arrays, 1):
            assert (array.reshape(-1).view(np.uint8) == number).all()
