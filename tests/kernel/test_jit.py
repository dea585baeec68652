"""Compiled and plain: 50 steps on recorded actions, once with the JIT and once without, agree to 1e-9."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fovconn_env.kernel import records
from fovconn_env.kernel.jit import code_of, entry
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.settings import Airframe, Camera, Course, Noise
from fovconn_env.sim.simulator import Simulator
from tests.helpers import JIT, recorded_actions, small

pytestmark = pytest.mark.nojit

STEPS = 50
CASES = {
    "kinematic": {},
    "quadrotor": {
        "dynamics": "quadrotor",
        "airframe": Airframe(rotor_noise=0.01, force_noise=0.2),
        "noise": Noise(position_noise=0.02, gyro_noise=0.01, attitude_noise=0.01, range_noise=0.02),
        "camera": Camera(occlusion=True, miss=0.05),
    },
}


def record(case):
    """Every field of every step, by name: (STEPS, ...) each, and the observations as they are (float32)."""
    obstacles = Map().circle((1.5, 1.0), 0.3).polygon([(-4.0, -4.0), (-2.0, -4.0), (-3.0, -3.5), (-4.0, -2.0)])
    changes = {**CASES[case], "map": obstacles if case == "quadrotor" else None}
    scenario = small(n_agents=3, course=Course(settle=0.5), patience=1e3, warmup=0.1, **changes)
    simulator, columns = Simulator(scenario), {}
    simulator.reset(3)
    for action in recorded_actions(STEPS, 3, size=0.3):
        simulator.step(action)
        assert not simulator.over[0]
        for name, array in (simulator.state.arrays() | {"range_row": simulator.state.range_row}).items():
            for field in array.dtype.names or ("",):
                columns.setdefault(f"{name}.{field}", []).append((array[field] if field else array).copy())
    return {name: np.array(values) for name, values in columns.items()}


@pytest.mark.parametrize("case", CASES)
def test_compiled_and_plain_agree(case, tmp_path):
    program = f"import sys, numpy; from {__name__} import record; numpy.savez(sys.argv[1], **record({case!r}))"
    if JIT:
        program = f"from tests.plain import quicken_records; quicken_records(); {program}"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1" if JIT else "0"}
    command = [sys.executable, "-c", program, str(tmp_path / "other.npz")]
    other = subprocess.Popen(command, cwd=Path(__file__).parents[2], env=environment)
    here = record(case)
    assert other.wait() == 0
    with np.load(tmp_path / "other.npz") as there:
        assert set(there) == set(here)
        for name, values in here.items():
            assert not np.isnan(values).any(), name
            single = values.dtype == np.float32  # the last bit of a single may round the other way
            np.testing.assert_allclose(values, there[name], rtol=1e-6 if single else 0, atol=1e-9, err_msg=name)
    assert here["track.present"].any()
    assert (here["range_row.present"] > 0).any()
    assert here["reward."].any()


def test_fields_of_a_record_are_read_and_written_by_name():
    """With the JIT by numpy, without it as `plain` has them; a record in a record is a part of it."""
    kinds = [kind for kind in vars(records).values() if isinstance(kind, np.dtype)]
    assert len(kinds) > 10
    for kind in kinds:
        array, record = np.zeros(1, kind), np.zeros(2, kind)[1]
        parts = [(array[0], record)]
        for one, other in parts:
            for k, name in enumerate(one.dtype.names):
                if one.dtype[name].names is not None:
                    parts.append((getattr(one, name), getattr(other, name)))
                    continue
                one[name] = (k + 1) % 2
                setattr(other, name, (k + 1) % 2)
                assert getattr(other, name) == (k + 1) % 2
                assert type(getattr(other, name)) is one.dtype[name].type
        assert record.item() == array[0].item()
        with pytest.raises(AttributeError):
            record.no_such_field  # noqa: B018


@entry
def double(values):
    """Twice the values (n,), in place."""
    for k in range(values.shape[0]):
        values[k] *= 2.0


def test_code_is_called_directly():
    """That of the arguments' types, whatever else was compiled."""
    values, single = np.ones(3), np.ones(3, np.float32)
    assert code_of(double, values) is double, "nothing is compiled yet"
    double(values)
    code_of(double, values)(values)
    assert (values == 4.0).all()
    assert (code_of(double, values) is double) is not JIT
    assert code_of(double, single) is double, "not compiled for such arrays"
    double(single)
    code_of(double, single)(single)
    assert (single == 4.0).all()
    assert (code_of(double, single) is code_of(double, values)) is not JIT
