"""Every number has bounds with a reason, and within them nothing overflows, diverges, hangs or takes more memory."""

import contextlib
import dataclasses
import math
import pydoc
import re
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from fovconn_env import Forest, Map, Recorded, Simulator, parallel_env, scenario
from fovconn_env.baselines import Gains
from fovconn_env.baselines.laws.augmented import Augmented, AugmentedGains
from fovconn_env.baselines.laws.cohesive import Cohesive, CohesiveGains
from fovconn_env.baselines.laws.expert import Expert
from fovconn_env.baselines.laws.filters import filtered
from fovconn_env.baselines.laws.lambda2_cbf import Barrier
from fovconn_env.bounds import Bounds
from fovconn_env.errors import SettingError, SettingTypeError
from fovconn_env.scenarios.presets import LEVELS, PRESETS
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.settings import Camera, Clock, Course, Fault, Radio, Reward, Start
from fovconn_env.scenarios.sizes import world_bytes
from tests.fuzzing import count
from tests.helpers import JIT
from tests.scenarios.extremes import (
    KINDS,
    QUICK,
    Covering,
    accepted,
    fly,
    peak_bytes,
    random_changes,
    settings,
    stated_bytes,
)

GAINS = {kind.__name__: kind for kind in (Gains, AugmentedGains, CohesiveGains, Barrier)}
PILLARS = Map().circle((3.0, 2.0), 0.3).circle((8.0, -2.0), 0.3).wall((150, 150), (160, 150), 1.0)
NUMBERS = [
    (kind, field)
    for kind in {**KINDS, **GAINS}.values()
    for field in dataclasses.fields(kind)
    if isinstance(field.default, (int, float, tuple)) and not isinstance(field.default, bool)
    if f"{kind.__name__}.{field.name}" not in ("Scenario.faults", "Fault.at")  # tuples of their own kinds
]
IDS = [f"{kind.__name__}.{field.name}" for kind, field in NUMBERS]


# --------------------------------------------------------------------------------------------------- each by itself
@pytest.mark.nojit
@pytest.mark.parametrize("kind, field", NUMBERS, ids=IDS)
def test_each_number_has_bounds_a_unit_and_a_reason(kind, field):
    bounds = field.metadata["bounds"]
    assert isinstance(bounds, Bounds)
    assert math.isfinite(bounds.least)
    assert bounds.least < bounds.most < 2e9
    assert bounds.why
    assert field.metadata["meaning"]
    default = field.default if isinstance(field.default, tuple) else (field.default,)
    assert all(bounds.least <= value <= bounds.most or (bounds.infinite and value == math.inf) for value in default)
    assert str(bounds) in kind.__doc__


@pytest.mark.nojit
@pytest.mark.parametrize("kind, field", NUMBERS, ids=IDS)
def test_a_number_beyond_its_bounds_is_refused(kind, field):
    """The next number beyond, far beyond, and numbers that no float holds: one line of field, rule, value and hint."""
    bounds, name = field.metadata["bounds"], f"{kind.__name__}.{field.name}"
    below, above = (
        (bounds.least - 1, bounds.most + 1)
        if bounds.whole
        else (np.nextafter(bounds.least, -math.inf), np.nextafter(bounds.most, math.inf))
    )
    huge = (10**400, Fraction(10**400), 2**63) + (() if bounds.whole else (1e300, Decimal("1e5000")))
    for value in (below, above, *huge, *(-number for number in huge)):
        given = (value,) * len(field.default) if isinstance(field.default, tuple) else value
        with pytest.raises(SettingError) as error:
            kind(**{field.name: given})
        text = str(error.value)
        assert text.startswith(name)
        assert " must be " in text
        assert ", got " in text
        assert "\n" not in text
        assert len(text) < 500


@pytest.mark.nojit
@pytest.mark.parametrize("kind", [np.float32, np.float64, Fraction, Decimal, int, np.int16, np.uint8])
def test_numbers_of_any_type_become_pythons_own(kind):
    chosen = Camera(d_max=kind(20), optical_axis=[kind(1), kind(0), kind(0)])
    assert (type(chosen.d_max), chosen.d_max) == (float, 20.0)
    assert chosen.optical_axis == (1.0, 0.0, 0.0)
    assert [type(part) for part in chosen.optical_axis] == [float, float, float]
    if issubclass(kind, (int, np.integer)):
        assert type(Clock(ticks=kind(3)).ticks) is int
    else:
        with pytest.raises(SettingError, match=r"Clock\.ticks must be a whole number"):
            Clock(ticks=kind(3))


@pytest.mark.nojit
def test_switches_become_pythons_own():
    assert Camera(occlusion=np.bool_(True)).occlusion is True


@pytest.mark.parametrize("value", [True, np.True_, "1", b"1", None, [1], {1}, 1j, object(), np.array(1.0), Camera])
@pytest.mark.nojit
@pytest.mark.parametrize("kind, name", [(Camera, "d_max"), (Clock, "ticks"), (Scenario, "patience"), (Fault, "lasts")])
def test_what_is_no_number(kind, name, value):
    with pytest.raises(SettingError, match=rf"^{kind.__name__}\.{name} must be a (whole )?number, got .*: \w"):
        kind(**{name: value})


@pytest.mark.nojit
def test_published_scenarios_and_benchmarks_are_within():
    """And what people fly: a hundred robots, racing drones, rotors in rpm, a palm-sized robot, an endless flight."""
    chosen = [scenario(name, level=level + 1) for name in PRESETS for level in range(len(LEVELS.get(name, ())) + 1)]
    airframes = [
        {"airframe.rotor_min": 1000, "airframe.rotor_max": 9000, "airframe.thrust_gain": 8e-8},
        {"airframe.rotor_min": 0.1, "airframe.rotor_max": 1.0, "airframe.thrust_gain": 6.5},
        {
            **{
                "airframe.mass": 0.027,
                "airframe.inertia_xy": 1.4e-5,
                "airframe.inertia_z": 2.17e-5,
                "airframe.arm": 0.04,
            },
            **{"airframe.rotor_min": 0.1, "airframe.rotor_max": 1.0, "airframe.thrust_gain": 0.15},
            **{"airframe.drag_ratio": 0.006, "airframe.kq_tilt": 0.003, "airframe.kw_tilt": 3e-4},
            **{"airframe.kq_yaw": 4e-4, "airframe.kw_yaw": 1.5e-4},
        },
        {"airframe.max_accel": 40.0, "airframe.max_jerk": 400.0, "speed_limit": 30.0, "yaw_rate_limit": 35.0},
    ]
    chosen += [scenario("TiltDynamics-v0", **changes) for changes in airframes]
    chosen += [scenario(n_agents=100, max_cycles=10**9, patience=1e9), scenario(n_agents=256, **{"radio.delay": 80})]
    assert all(isinstance(one, Scenario) for one in chosen)


@pytest.mark.nojit
@pytest.mark.parametrize("kind", {**KINDS, **GAINS}.values())
def test_help_lists_every_setting(kind):
    """With default, unit, bounds and words."""
    text = pydoc.render_doc(kind, renderer=pydoc.plaintext)
    for field in dataclasses.fields(kind):
        assert re.search(rf"^ .* {field.name}: .*[a-zA-Z()]", text, re.MULTILINE), field.name
    if kind is Scenario:
        assert "speed_limit: 1.5; m/s, Euclidean norm; 0.001 to 100" in text
        assert 'dynamics: "kinematic"; "kinematic" or "quadrotor"; how robots fly' in text
        assert "camera: Camera(); Camera and link weights (6)-(11): who is seen" in text
        assert "docs/decisions.md), see help(Airframe)" in text


# ------------------------------------------------------------------------------------------------------ together
@pytest.mark.nojit
@pytest.mark.parametrize(
    "changes, message",
    [
        ({"clock.ticks": 1000, "clock.rounds": 3}, r"Clock\.ticks must be at most 666, got 1000: ticks \* rounds"),
        ({"clock.tick": 0.05, "yaw.k3": 41.0}, r"YawEstimator\.k3 must be at most 40, got 41\.0: .* diverges"),
        ({"clock.tick": 0.05, "yaw_rate_limit": 21.0}, r"Scenario\.yaw_rate_limit must be at most 20, got 21\.0"),
        ({"clock.tick": 0.001, "warmup": 61.0}, r"Scenario\.warmup must be at most 60, got 61\.0: .* 60000 ticks"),
        (
            {"clock.ticks": 1000, "airframe.substep": 1e-4, "clock.tick": 0.05, "clock.rounds": 1},
            "Airframe.substep must",
        ),
        ({"lambda2": "flooding", "n_agents": 129}, r'Scenario\.n_agents must be at most 128 with lambda2="flooding"'),
        ({"n_agents": 256, "radio.delay": 500}, r"Scenario must be of at most 1073741824 bytes a world, got 24\d{8}"),
        ({"lambda2": "flooding", "n_agents": 128, "radio.delay": 100}, "Scenario must be of at most 1073741824 bytes"),
        ({"n_agents": 5, "leader_index": 5}, r"Scenario\.leader_index must be in 0\.\.4, got 5"),
        ({"lambda2_min": 3.01}, r"Scenario\.lambda2_min must be below lambda2_max"),
        ({"camera.d_min": 2.9999999}, r"Camera\.d_min must be at least 1e-06 below D1 \(3\), got 2\.9999999"),
        ({"camera.optical_axis": (1e-7, 0, 0)}, r"Camera\.optical_axis must be not all 0"),
        ({"airframe.rotor_noise": 1e3}, r"Airframe\.rotor_noise must be at most 0\.3, got 1000\.0"),
        ({"airframe.drag_ratio": 1e6}, r"Airframe\.drag_ratio must be at most 1, got 1000000\.0"),
        (
            {"airframe.force_noise": 27.0},
            r"Airframe\.force_noise must be at most 26, got 27\.0: full thrust is 26\.0 N",
        ),
        ({"airframe.inertia_xy": 1e-6}, r"Airframe\.inertia_z must be at most 2 inertia_xy"),
        ({"airframe.inertia_xy": 2e-4, "airframe.inertia_z": 3e-4}, r"Airframe\.inertia_xy must be at least 0\.000529"),
        ({"airframe.kw_tilt": 10.0}, r"Airframe\.kw_tilt must be from 0\.0229 to 9\.16, got 10\.0: .* 1 / substep"),
        ({"airframe.kq_yaw": 4e3, "airframe.kw_yaw": 8.0}, r"Airframe\.kq_yaw must be at most 3536"),
        (
            {"airframe.rotor_lag": 0.1},
            r"Airframe\.rotor_lag must be at most 0\.8 kw_tilt / kq_tilt - substep \(0\.0775\)",
        ),
        (
            {"airframe.mass": 0.1},
            r"Airframe\.mass must be at least 0\.133 kg, got 0\.1: .* more than 20 times its weight",
        ),
        ({"airframe.rotor_min": 1e-6}, r"Airframe\.rotor_min must be at least 0\.1, got 1e-06"),
        ({"airframe.substep": 1e-12}, r"Airframe\.substep must be at least 0\.0001, got 1e-12"),
        ({"max_cycles": 2**63}, r"Scenario\.max_cycles must be at most 1e\+09, got 9223372036854775808"),
        ({"radio.memory": 1e300}, r"Radio\.memory must be at most 1e\+06, got 1e\+300"),
        ({"n_agents": 20_000}, r"Scenario\.n_agents must be at most 256, got 20000"),
        ({"max_neighbors": 10**9}, r"Scenario\.max_neighbors must be at most 255, got 1000000000"),
        ({"clock.rounds": 10**6}, r"Clock\.rounds must be at most 50, got 1000000"),
        ({"yaw_rate_limit": 1e39}, r"Scenario\.yaw_rate_limit must be at most 40, got 1e\+39"),
        (
            {"speed_limit": 10**400},
            r"Scenario\.speed_limit must be at most 100, got a whole number of about 401 digits",
        ),
        ({"faults": [Fault()] * 257}, r"Scenario\.faults must be at most 256, got 257"),
    ],
)
def test_what_does_not_go_together(changes, message):
    with pytest.raises(SettingError, match=message):
        scenario("TiltDynamics-v0", **changes)


@pytest.mark.nojit
@pytest.mark.parametrize(
    "make, message",
    [
        (lambda one: Simulator(one, 10**9), "n_worlds must be at most 1000000, got 1000000000"),
        (lambda one: Simulator(one, 2**63), "n_worlds must be at most 1000000"),
        (
            lambda one: Simulator(scenario(n_agents=256), 3000),
            r"n_worlds must be at most 20\d\d, got 3000: a world takes",
        ),
        (lambda one: Simulator(one, 64, n_threads=10**6), "n_threads must be at most 1024, got 1000000"),
        (lambda one: setattr(Simulator(one), "max_cycles", 2**63), "Scenario.max_cycles must be at most 1e.09, got 92"),
        (
            lambda one: setattr(parallel_env(one), "max_cycles", 10**400),
            "Scenario.max_cycles must be at most 1e.09, got a",
        ),
        (lambda one: Simulator(one).reset(0, poses=1e7 * np.eye(2, 4)), "poses must be at most 1e.06, got 10000000"),
        (lambda one: Recorded(np.broadcast_to(0.0, (10_000_001, 3))), "Recorded.sticks must be at most 10000000 rows"),
        (lambda one: Forest(n_pillars=10**6), "Forest.n_pillars must be at most 1000"),
    ],
)
def test_counts_and_places_have_bounds(make, message):
    with pytest.raises(SettingError, match=message):
        make(scenario(n_agents=2))


@pytest.mark.nojit
@pytest.mark.parametrize("name", [7, None, ["x"], "", "x" * 101, "a\nb", "\x1b[31m", "\ud800", b"x", "a\tb", "\u202e"])
def test_a_name_is_a_printable_text(name):
    with pytest.raises(SettingError, match=r"^Scenario\.name must be a text of 1 to 100 .*, got [\x20-\x7e]*$"):
        scenario(name=name)
    assert scenario(name="</script> [bold] Ünïcode 漢字").name.startswith("</")


# ------------------------------------------------------------------------------------------------------ in flight
@pytest.mark.fuzz
@pytest.mark.skipif(not JIT, reason="thousands of steps")
@pytest.mark.parametrize("seed", range(count(1, 5)))
def test_pairs_of_ends_fly(seed):
    """Every pair of ends that goes together, 50 steps: all that a caller gets is finite and within its bounds."""
    rng = np.random.default_rng(seed)
    covering, bad, flown = Covering(settings(QUICK), rng), {}, 0
    while (changes := covering.row()) is not None:
        found = fly(accepted(changes), 50, rng)
        if found:
            bad[str(changes)] = found[:3]
        flown += 1
    assert bad == {}
    assert flown >= 20
    assert covering.total - covering.impossible > 0.75 * covering.total


@pytest.mark.fuzz
@pytest.mark.skipif(not JIT, reason="thousands of steps")
def test_random_settings_fly():
    """What is accepted, flies: finite for 50 steps, whatever the settings."""
    rng, everything, bad, refused = np.random.default_rng(1), settings(QUICK), {}, 0
    many = count(30, 10_000)
    for _ in range(many):
        changes = random_changes(everything, rng)
        chosen = accepted(changes)
        with contextlib.suppress(SettingError):  # no such robot
            faults = [Fault(kind=kind, robot=rng.integers(4), at=rng.random()) for kind in ("camera", "radio", "robot")]
            chosen = dataclasses.replace(
                chosen, faults=faults[: rng.integers(4)], map=PILLARS if rng.random() < 0.5 else None
            )
        try:
            found = fly(chosen, 50, rng)
        except SettingError:  # no room between floor and ceiling, or for a course
            refused += 1
            continue
        if found:
            bad[str(changes)] = found[:3]
    assert bad == {}
    assert refused <= 0.3 * many


@pytest.mark.parametrize(
    "changes",
    [
        {"n_agents": 256, "warmup": 0.0},
        {"n_agents": 128, "warmup": 0.0, "lambda2": "flooding", "clock.ticks": 1},
        {"n_agents": 2, "clock.ticks": 1000},
        {"n_agents": 2, "clock.ticks": 40, "clock.rounds": 50, "radio.delay": 1000},
        {"n_agents": 2, "warmup": 600.0},
        {"n_agents": 2, "dynamics": "quadrotor", "clock.ticks": 40, "clock.tick": 0.05, "airframe.substep": 1e-4},
        {"n_agents": 7, "max_neighbors": 255, "max_ranges": 1024},
    ],
    ids=lambda changes: ", ".join(changes),
)
@pytest.mark.skipif(not JIT, reason="thousands of ticks")
def test_the_largest_of_what_takes_time_fly(changes):
    assert fly(accepted(changes), 2, np.random.default_rng(0)) == []


@pytest.mark.parametrize("kind", GAINS.values())
@pytest.mark.skipif(not JIT, reason="compiled laws")
def test_gains_at_their_ends_give_actions(kind):
    """Each gain at each end that goes together with the others: finite actions within [-1, 1]."""
    chosen = scenario("LeaderObstacles-v0", n_agents=4, warmup=0.5, noise={"position_noise": 1.0})
    simulator, flown = Simulator(chosen), 0
    simulator.reset(1)
    policies = {Gains: Expert, AugmentedGains: Augmented, CohesiveGains: Cohesive}
    for field in dataclasses.fields(kind):
        for end in (field.metadata["bounds"].least, field.metadata["bounds"].most):
            try:
                gains = kind(**{field.name: end})
            except SettingError:  # not in order with the others
                continue
            policy = (
                policies[kind](chosen, gains) if kind in policies else filtered("lambda2-cbf", Expert)(chosen, gains)
            )
            for _ in range(3):
                actions = np.asarray(policy.act(simulator.observations))
                assert (abs(actions) <= 1.0).all(), gains
                simulator.step(actions.reshape(1, 4, 4))
            flown += 1
    assert flown >= len(dataclasses.fields(kind))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"n_agents": 256, "warmup": 0.0},
        {"n_agents": 24, "radio.delay": 1000, "warmup": 0.0},
        {"n_agents": 24, "lambda2": "flooding", "radio.delay": 3, "warmup": 0.0},
        {"n_agents": 24, "max_neighbors": 255, "max_ranges": 1024, "warmup": 0.0},
        {"n_agents": 2, "course": Course(legs=100), "faults": [Fault()] * 256, "warmup": 0.0},
        {"n_agents": 2, "map": Map().polygon([(90, 90), (91, 90), (90, 91)]), "warmup": 0.0},
    ],
    ids=lambda changes: ", ".join(changes) or "default",
)
@pytest.mark.skipif(not JIT, reason="the traced memory is that of compiled code")
def test_a_simulator_takes_the_memory_that_is_stated(changes):
    chosen = scenario("LeaderFollow-v0", **changes)
    Simulator(scenario(n_agents=2, warmup=0.0)).reset(0)  # what is loaded once
    size = stated_bytes(chosen)
    assert 0.5 * size < peak_bytes(chosen) < 1.02 * size + 3e5


@pytest.mark.nojit
def test_the_size_is_that_of_the_arrays():
    for changes in (
        {},
        {"n_agents": 3, "radio": Radio(delay=7), "lambda2": "flooding"},
        {"camera": {"latency": 0.1, "identify": 1.0}, "max_detections": 3},
    ):
        chosen = scenario(max_ranges=5, **changes)
        simulator = Simulator(chosen)
        arrays = [*simulator.state[:-4], *simulator.world[:5]]
        assert sum(array.nbytes for array in arrays) == world_bytes(chosen)


@pytest.mark.nojit
def test_an_unknown_keyword_of_a_group_gets_the_nearest_one():
    with pytest.raises(SettingTypeError, match=r"Reward\(\) got an .* 'colision': did you mean 'collision'\?"):
        Reward(colision=1)
    with pytest.raises(SettingTypeError, match=r"Clock\(\) must be called with keywords, got 0\.01: write Clock\("):
        Clock(0.01)
    with pytest.raises(SettingTypeError, match=r"Start\(\) got an unexpected .* 'zzz': there are box, spacing"):
        Start(zzz=1)
