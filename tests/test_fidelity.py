"""docs/fidelity.json: rotorpy's flights, to which ours must stay equal."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).parents[1] / "docs"
sys.path.append(str(DOCS))
import fidelity  # noqa: E402

RECORD = json.loads((DOCS / "fidelity.json").read_text("utf-8"))
APART = {"speed": 0.001, "tilt": 0.02, "rate": 0.001, "x": 0.02}  # m/s, deg, rad/s, cm; stored with three decimals


@pytest.mark.parametrize("name", fidelity.SCENES)
def test_we_fly_as_rotorpys_body_under_our_controller(name):
    track, _, _ = fidelity.fly_ours(fidelity.SCENES[name])
    stored = RECORD["curves"][name]
    for key, values in fidelity.curves(name, track).items():
        np.testing.assert_allclose(values, stored["plant"][key], rtol=0.0, atol=APART[key])
        drag = np.abs(np.subtract(values, stored["drag"][key])).max()
        assert drag > 5.0 * APART[key]  # else it could not fail


@pytest.mark.parametrize("name", fidelity.SCENES)
def test_our_numbers_in_the_record_are_todays(name):
    track, _, _ = fidelity.fly_ours(fidelity.SCENES[name])
    found, stored = fidelity.measures(name, track), RECORD["measures"][name]["ours"]
    assert found.keys() == stored.keys()
    for key, value in found.items():
        np.testing.assert_allclose(value, stored[key], rtol=1e-3, atol=1e-5)


def test_open_loops_differ_by_the_error_of_our_substep():
    for name, apart in RECORD["open loop"].items():
        if name == "rotor":  # exact in both
            assert max(apart) < 1e-9
        else:
            assert apart[0] < 0.003  # m, m/s, rad, rad/s
            np.testing.assert_allclose([apart[0] / apart[1], apart[1] / apart[2]], 4.0, rtol=0.02)


def test_response_of_a_first_order_lag():
    time = fidelity.TICK * np.arange(1, 400)
    found = fidelity.response(1.0 - np.exp(-time / 0.3))
    assert found["rise"] == pytest.approx(0.3 * np.log(9.0), abs=1e-3)
    assert found["settle"] == pytest.approx(0.3 * np.log(20.0), abs=fidelity.TICK)
    assert found["overshoot"] == 0.0
