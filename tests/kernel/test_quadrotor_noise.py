"""Statistics of the quadrotor's actuation noise; long runs, so only with the JIT."""

import math

import numpy as np

from tests.kernel.test_quadrotor import MODEL, hold, run


def test_effect_of_rotor_noise_does_not_depend_on_the_substep():
    spread = [run(hold((0, 0, 0, 0), 60.0), substep=s, rotor_noise=0.01)[1]["rotor0"].std() for s in (0.005, 0.00125)]
    np.testing.assert_allclose(spread[0], spread[1], rtol=0.05)


def test_random_force_has_its_deviation_and_its_memory():
    _, flights = run(hold((0, 0, 0, 0), 2000.0), force_noise=0.2, force_time=0.5)
    lag = round(0.5 / MODEL["tick"])
    for name in ("fx", "fy", "fz"):
        f = flights[name][lag:]
        np.testing.assert_allclose(f.std(), 0.2, rtol=0.06)
        np.testing.assert_allclose(np.corrcoef(f[lag:], f[:-lag])[0, 1], math.exp(-1.0), atol=0.06)


def test_hover_under_the_random_force_spreads_as_the_linear_loop_predicts():
    """Behind poles 1 and 4 of the position loop and 1 of the force: variance (sigma / m)^2 (a + b + c) / (a b ...)."""
    bodies, _ = run(hold((0, 0, 0, 0), 4000.0), force_noise=0.2)
    a, b, c = 1.0, 4.0, 1.0
    expected = 0.2 / MODEL["mass"] * math.sqrt(c * (a + b + c) / (a * b * c * (a + b) * (b + c) * (a + c)))
    for name in "xyz":
        np.testing.assert_allclose(bodies[name][1000:].std(), expected, rtol=0.08)
