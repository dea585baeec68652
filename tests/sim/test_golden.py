"""Short recorded runs come out as they were; `python tests/golden/remake.py` makes them anew.

Values, not bits: another processor's sine may differ in its last digit.
"""

import numpy as np
import pytest

from tests.golden import remake

TOLERANCE = {"observations": 1e-6}  # float32
PLAIN = ("LeaderFollow", "Everything")  # without the JIT, too; each takes seconds there


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.nojit] * (name in PLAIN)) for name in remake.RUNS]
)
def test_run_is_as_recorded(name):
    kept = {key.partition("/")[2]: value for key, value in remake.load().items() if key.startswith(f"{name}/")}
    now = remake.record(name)
    assert set(kept) == set(now)
    same = (kept.pop("digest") == now.pop("digest")).all()
    print(f"{name}: {'the same' if same else 'other'} bits")  # pytest -rP shows it
    for key, value in kept.items():
        assert np.isfinite(value).all()
        worst = remake.difference(value, now[key])
        assert worst <= TOLERANCE.get(key, 1e-9), f"{key} differs by {worst:.1e}: if meant, run tests/golden/remake.py"


def test_runs_are_recorded_whole():
    kept = remake.load()
    assert {key.partition("/")[0] for key in kept} == set(remake.RUNS)
    assert remake.FILE.stat().st_size < 200_000
    for name, settings in remake.RUNS.items():
        poses = kept[f"{name}/poses"]
        assert poses.shape == (remake.N_STEPS // remake.EVERY + 1, settings.n_agents, 4)
        assert np.abs(np.diff(poses, axis=0)).max() > 0.1
        assert kept[f"{name}/weights"].max() > 0.1
