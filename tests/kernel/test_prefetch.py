"""Asking for memory is a hint to the processor, and changes nothing."""

import numba
import numpy as np
import pytest

from fovconn_env.kernel import records
from fovconn_env.kernel.jit import entry
from fovconn_env.kernel.prefetch import LINE, prefetch
from tests.helpers import JIT


@entry
def ask(tracks, numbers):
    prefetch(tracks[0])
    prefetch(tracks)
    prefetch(numbers)


@pytest.mark.nojit
def test_memory_that_is_asked_for_keeps_its_bytes():
    tracks, numbers = np.zeros(3, records.TRACK), np.arange(5.0, dtype=np.float32)
    tracks["x"] = 1.5
    before = tracks.tobytes(), numbers.tobytes()
    ask(tracks, numbers)
    assert (tracks.tobytes(), numbers.tobytes()) == before


@pytest.mark.skipif(not JIT, reason="plain Python asks for nothing")
def test_every_line_is_asked_for():
    """A record has a size that is known: one request for each line that it begins, and one for its last byte."""
    plain = numba.njit(lambda record: prefetch(record))
    plain(np.zeros(3, records.TRACK)[0])
    (code,) = plain.inspect_asm().values()
    assert code.count("prefetch") >= -(-records.TRACK.itemsize // LINE) + 1
