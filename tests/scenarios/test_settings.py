"""Bad input: one clear error that names the field, its rule, the value, and where it helps a likely cause."""

import dataclasses
import math
import re

import numpy as np
import pytest

from fovconn_env.baselines import Gains
from fovconn_env.bounds import check_numbers, fraction, non_negative, number, positive
from fovconn_env.errors import SettingError
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.presets import PRESETS, scenario
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.scenarios.settings import (
    Airframe,
    Camera,
    Clock,
    Course,
    Flooding,
    Noise,
    PowerIteration,
    Radio,
    Rangefinder,
    Reward,
    Start,
    YawEstimator,
)
from fovconn_env.sim.simulator import Simulator
from tests.helpers import small

INF, NAN = math.inf, math.nan

# (what makes it, what the message names: field, rule, value)
IMPOSSIBLE = [
    (lambda: Camera(a_min=0.95), "Camera.a_min", "below a_max (0.95)", "0.95"),
    (lambda: Camera(a_min=0.99), "Camera.a_min", "below a_max (0.95)", "0.99"),
    (lambda: Camera(a_min=-1.5), "Camera.a_min", "at least -1", "-1.5"),
    (lambda: Camera(a_max=1.5), "Camera.a_max", "at most 1", "1.5"),
    (lambda: Camera(d_min=3.0), "Camera.d_min", "below D1 (3)", "3.0"),
    (lambda: Camera(d_min=4.0), "Camera.d_min", "below D1 (3)", "4.0"),
    (lambda: Camera(D1=7.5), "Camera.D1", "below D2 (7)", "7.5"),
    (lambda: Camera(D2=9.0), "Camera.D2", "below d_max (9)", "9.0"),
    (lambda: Camera(d_min=0.0), "Camera.d_min", "above 0", "0.0"),
    (lambda: Camera(optical_axis=(0.0, 0.0, 0.0)), "Camera.optical_axis", "not all 0", "(0.0, 0.0, 0.0)"),
    (lambda: Camera(optical_axis=(1.0, 0.0)), "Camera.optical_axis", "three", "(1.0, 0.0)"),
    (lambda: Camera(optical_axis=(1.0, NAN, 0.0)), "Camera.optical_axis", "finite", "nan"),
    (lambda: Camera(miss=1.5), "Camera.miss", "in [0, 1]", "1.5"),
    (lambda: Camera(coast=-0.1), "Camera.coast", "at least 0", "-0.1"),
    (lambda: Clock(tick=0.0), "Clock.tick", "above 0", "0.0"),
    (lambda: Clock(tick=0.1), "Clock.tick", "at most 0.05", "0.1"),
    (lambda: Clock(ticks=0), "Clock.ticks", "above 0", "0"),
    (lambda: Clock(ticks=2.5), "Clock.ticks", "whole", "2.5"),
    (lambda: Clock(rounds=0), "Clock.rounds", "above 0", "0"),
    (lambda: Rangefinder(range_max=-1.0), "Rangefinder.range_max", "above 0", "-1.0"),
    (lambda: Radio(loss=-0.1), "Radio.loss", "in [0, 1]", "-0.1"),
    (lambda: Radio(loss=1.1), "Radio.loss", "in [0, 1]", "1.1"),
    (lambda: Radio(delay=0), "Radio.delay", "above 0", "0"),
    (lambda: Radio(delay=1.5), "Radio.delay", "whole", "1.5"),
    (lambda: Radio(memory=0.0), "Radio.memory", "above 0", "0.0"),
    (lambda: YawEstimator(v_min=0.2), "YawEstimator.v_min", "below v_max (0.2)", "0.2"),
    (lambda: YawEstimator(k1=0.0), "YawEstimator.k1", "above 0", "0.0"),
    (lambda: YawEstimator(hold=-1.0), "YawEstimator.hold", "at least 0", "-1.0"),
    (lambda: PowerIteration(k2=-8.0), "PowerIteration.k2", "above 0", "-8.0"),
    (lambda: PowerIteration(lead=-1.0), "PowerIteration.lead", "at least 0", "-1.0"),
    (lambda: PowerIteration(team=0), "PowerIteration.team", "above 0", "0"),
    (lambda: Flooding(memory=0.0), "Flooding.memory", "above 0", "0.0"),
    (lambda: Noise(gyro_bias=-0.1), "Noise.gyro_bias", "at least 0", "-0.1"),
    (lambda: Start(box=(9.0, -9.0, 3.0)), "Start.box[1]", "above 0", "-9.0"),
    (lambda: Start(box=(9.0, 9.0)), "Start.box", "three numbers", "(9.0, 9.0)"),
    (lambda: Start(spacing=0.0), "Start.spacing", "above 0", "0.0"),
    (lambda: Start(lambda2_low=2.0, lambda2_high=1.0), "Start.lambda2_low", "below lambda2_high", "2.0"),
    (lambda: Course(legs=0), "Course.legs", "above 0", "0"),
    (lambda: Course(legs=1.5), "Course.legs", "whole", "1.5"),
    (lambda: Course(turn_low=2.0, turn_high=1.0), "Course.turn_low", "at most turn_high", "2.0"),
    (lambda: Course(climb=1.5), "Course.climb", "must be", "1.5"),
    (lambda: Airframe(rotor_min=100.0), "Airframe.rotor_min", "below rotor_max", "100.0"),
    (lambda: Airframe(mass=5.0), "Airframe.mass", "below 2.65 kg", "5.0"),
    (lambda: Airframe(force_noise=-1.0), "Airframe.force_noise", "at least 0", "-1.0"),
    (lambda: Airframe(rotor_lag=0.0), "Airframe.rotor_lag", "above 0", "0.0"),
    # turning this fast, the slowest rotors lift more than the robot weighs
    (lambda: Airframe(rotor_min=80.0), "Airframe.rotor_min", "must be", "80.0"),
    (lambda: Airframe(max_tilt=math.pi / 2), "Airframe.max_tilt", "must be", "1.57"),
    (lambda: Reward(near=0.0), "Reward.near", "above 0", "0.0"),
    (lambda: Reward(effort=-1.0), "Reward.effort", "at least 0", "-1.0"),
    (lambda: Gains(k_v=0.0), "Gains.k_v", "above 0", "0.0"),
    (lambda: Gains(closest=0.9), "Gains.closest", "between d_min_obs", "0.9"),
    (lambda: scenario(n_agents=1), "Scenario.n_agents", "at least 2", "1"),
    (lambda: scenario(n_agents=0), "Scenario.n_agents", "at least 2", "0"),
    (lambda: scenario(n_agents=2.5), "Scenario.n_agents", "whole", "2.5"),
    (lambda: scenario(n_agents=True), "Scenario.n_agents", "whole", "True"),
    (lambda: scenario(leader_index=6), "Scenario.leader_index", "in 0..5", "6"),
    (lambda: scenario(leader_index=-1), "Scenario.leader_index", "at least 0", "-1"),
    (lambda: scenario(speed_limit=0.0), "Scenario.speed_limit", "above 0", "0.0"),
    (lambda: scenario(stick_speed=-1.0), "Scenario.stick_speed", "above 0", "-1.0"),
    (lambda: scenario(max_neighbors=0), "Scenario.max_neighbors", "above 0", "0"),
    (lambda: scenario(max_cycles=0), "Scenario.max_cycles", "above 0", "0"),
    (lambda: scenario(warmup=-1.0), "Scenario.warmup", "at least 0", "-1.0"),
    (lambda: scenario(lambda2_min=3.5), "Scenario.lambda2_min", "below lambda2_max (3.01)", "3.5"),
    (lambda: scenario(start=Start(spacing=0.4)), "Start.spacing", "above collision_robot (0.5)", "0.4"),
    (lambda: scenario(floor="low"), "Scenario.floor", "a number or None", "'low'"),
    (lambda: scenario(ceiling=True), "Scenario.ceiling", "a number or None", "True"),
    (lambda: scenario(floor=NAN), "Scenario.floor", "finite", "nan"),
    (lambda: scenario(floor=-INF), "Scenario.floor", "finite", "-inf"),
    (lambda: scenario(ceiling=1001), "Scenario.ceiling", "at most 1000", "1001"),
    (lambda: scenario(floor=0.1), "Scenario.floor", "at most 0", "0.1"),  # starts reach 1.5 m up, and keep 1.5 m
    (lambda: scenario(ceiling=-0.1), "Scenario.ceiling", "at least 0", "-0.1"),
    (lambda: scenario(floor=-1.0, ceiling=1.9), "Scenario.floor", "3 m below ceiling (1.9)", "-1.0"),
    (lambda: scenario(floor=5.0, ceiling=-5.0), "Scenario.floor", "3 m below ceiling (-5.0)", "5.0"),
    (lambda: scenario(start=Start(clearance=0.0), floor=1.3), "Scenario.floor", "at most 1.25", "1.3"),
    (lambda: scenario(dynamics="quad"), "Scenario.dynamics", "one of kinematic, quadrotor", "'quad'"),
    (lambda: scenario(weight="both"), "Scenario.weight", "one of union, product, omni", "'both'"),
    (lambda: scenario(lambda2="flood"), "Scenario.lambda2", "one of power, flooding, true, none", "'flood'"),
    (lambda: scenario(relative_yaw=True), "Scenario.relative_yaw", "one of estimated, true, none", "True"),
    (lambda: scenario(link="wifi"), "Scenario.link", "one of sight, radio", "'wifi'"),
    (lambda: scenario(leader="hand"), "Scenario.leader", "one of waypoints, none, random, human", "'hand'"),
    (lambda: scenario(dynamics=["kinematic"]), "Scenario.dynamics", "one of kinematic, quadrotor", "['kinematic']"),
]


@pytest.mark.parametrize("make, field, rule, value", IMPOSSIBLE, ids=[f"{case[1]}={case[3]}" for case in IMPOSSIBLE])
def test_impossible_settings(make, field, rule, value):
    with pytest.raises(ValueError, match=r".") as error:
        make()
    message = str(error.value)
    assert field in message
    assert rule in message
    assert value in message.replace("np.float64(", "").replace("np.int64(", "")
    assert ": " in message  # followed by a hint


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: scenario("LeaderFolow-v0"), ("LeaderFolow-v0", "did you mean 'LeaderFollow-v0'?", *PRESETS)),
        (lambda: scenario("zzz"), ("zzz", *PRESETS)),
        (lambda: scenario(n_agent=4), ("n_agent", "did you mean 'n_agents'?")),
        (lambda: scenario(dynamics="Quadrotor"), ("Scenario.dynamics", "did you mean 'quadrotor'?")),
        (lambda: scenario(zzz=4), ("zzz", "n_agents", "camera")),
    ],
    ids=["preset", "no preset", "setting", "word", "no setting"],
)
def test_unknown_names_get_the_nearest_known_one(make, words):
    with pytest.raises(ValueError, match=r".") as error:
        make()
    for word in words:
        assert word in str(error.value)


def test_an_unknown_setting_is_an_unexpected_keyword():
    """As for any function; and an error of settings."""
    for name in ("n_agent", "camera.a_mim", "camra.a_min"):
        with pytest.raises(TypeError, match=rf"\(\) got an unexpected keyword argument '{name.split('.')[-1]}|{name}'"):
            scenario(**{name: 4})
        with pytest.raises(SettingError, match="did you mean "):
            scenario(**{name: 4})


def test_rules_stand_on_the_fields():
    """One that a subclass declares anew has a rule again."""

    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Group:
        a: float = positive(1.0)
        b: int = non_negative(0)
        c: float = fraction(0.5)
        d: float = number(math.inf, 1e-6, 1e9, infinite=True)
        g: float | None = number(None, -5.0, 5.0)
        e: float = -1.0
        f: bool = False

        __post_init__ = check_numbers

    Group(a=0.1, b=3, c=1.0, d=2.0, e=-5, f=True)
    for changes, says in (
        ({"a": 0.0}, "Group.a must be above 0, got 0.0"),
        ({"a": math.inf}, "Group.a must be finite"),
        ({"b": -1}, "Group.b must be at least 0"),
        ({"b": 1.5}, "Group.b must be a whole number"),
        ({"c": 1.1}, "Group.c must be in [0, 1]"),
        ({"d": math.nan}, "Group.d must be finite"),
        ({"e": None}, "Group.e must be a number"),
        ({"f": 1}, "Group.f must be True or False"),
        ({"g": 6.0}, "Group.g must be at most 5"),
        ({"g": "6"}, "Group.g must be a number or None"),
    ):
        with pytest.raises(SettingError, match=re.escape(says)):
            Group(**changes)


@pytest.mark.parametrize(
    "make, field",
    [
        (lambda: scenario(camera=0.1), "Scenario.camera"),
        (lambda: scenario(map="forest"), "Scenario.map"),
        (lambda: scenario(speed_limit="fast"), "Scenario.speed_limit"),
        (lambda: scenario(speed_limit=None), "Scenario.speed_limit"),
        (lambda: Camera(d_max="9"), "Camera.d_max"),
        (lambda: Camera(a_min="0.1"), "Camera.a_min"),
        (lambda: Camera(occlusion="no"), "Camera.occlusion"),
        (lambda: Start(box=9.0), "Start.box"),
        (lambda: Camera(optical_axis="x"), "Camera.optical_axis"),
        (lambda: Clock(ticks=True), "Clock.ticks"),
        (lambda: scenario(3), "scenario"),
    ],
)
def test_wrong_types(make, field):
    with pytest.raises((TypeError, ValueError)) as error:
        make()
    assert str(error.value).startswith(field)
    assert "must be" in str(error.value)


GROUPS = [
    Camera,
    Clock,
    Rangefinder,
    Radio,
    YawEstimator,
    PowerIteration,
    Flooding,
    Noise,
    Start,
    Course,
    Airframe,
    Reward,
    Gains,
]
NUMBERS = [(kind, field.name) for kind in (*GROUPS, Scenario) for field in dataclasses.fields(kind)]
NUMBERS = [(k, n) for k, n in NUMBERS if type(getattr(k(), n)) in (float, int)]


ENDLESS = {"Scenario.patience", "Start.lambda2_high"}  # "for ever", "any"
HARMLESS = {"Course.settle", "Course.pause", "Course.goal_hold", "Course.goal_lambda2"}  # "never": as you like


def accepted(value_of):
    """Settings that take value_of(their default) without an error that says what they must be."""
    names = set()
    for kind, name in NUMBERS:
        try:
            kind(**{name: value_of(getattr(kind(), name))})
        except (ValueError, TypeError) as error:
            if " must be " not in str(error):
                names.add(f"{kind.__name__}.{name}, not clearly: {error}")
        else:
            names.add(f"{kind.__name__}.{name}")
    return names


def test_nan_is_no_number():
    assert accepted(lambda default: NAN) == set()


def test_infinite_numbers():
    """An infinite limit or gain ends in NaN, an infinite range in an observation without bounds."""
    assert accepted(lambda default: INF) - HARMLESS == ENDLESS


def test_every_number_is_checked():
    assert accepted(lambda default: -1e9) == set()


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_numpy_numbers_are_numbers(kind):
    wanted = {f"{k.__name__}.{name}" for k, name in NUMBERS}
    assert wanted - accepted(lambda value: np.int64(value) if isinstance(value, int) else kind(value)) == set()


@pytest.mark.parametrize("kind", [*GROUPS, Scenario])
def test_settings_are_frozen_and_keyword_only(kind):
    plain = kind()
    name = dataclasses.fields(kind)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(plain, name, getattr(plain, name))
    with pytest.raises(TypeError):
        kind(getattr(plain, name))
    assert plain == kind()


# -------------------------------------------------------------------------------------------- starts and poses
def test_obstacles_that_leave_no_room():
    crowded = Map().circle((0.0, 0.0), 30.0)
    simulator = Simulator(small(map=crowded))
    with pytest.raises(ValueError, match=r"Start.box must have room .* obstacle 0 covers the start box"):
        simulator.reset(1)
    with pytest.raises(ValueError, match=r"Forest found no room|Start must"):
        Simulator(small("LeaderObstacles-v0", map=Forest(n_pillars=400))).reset(1)


def test_a_team_that_cannot_be_connected():
    with pytest.raises(ValueError, match=r"Start must .*lambda2 in \(4, inf\)"):
        Simulator(small(start=Start(lambda2_low=4.0))).reset(1)


def test_a_box_that_is_too_small():
    with pytest.raises(ValueError, match=r"Start must .*: enlarge Start.box"):
        Simulator(small(start=Start(box=(1.0, 1.0, 1.0)))).reset(1)


def test_way_points_inside_obstacles():
    ring = Map()
    for angle in np.linspace(0, 2 * math.pi, 33)[:-1]:
        at = 14.0 * np.array([math.cos(angle), math.sin(angle)])
        ring.circle(at, 5.0)
    with pytest.raises(ValueError, match=r"Course must keep its way points .* found none"):
        Simulator(small(map=ring, course=Course(leg=14.0, turn_low=0.0, turn_high=0.0, legs=1))).reset(1)


FAR = np.array([[0.0, 0, 0, 0], [3.0, 0, 0, 0], [0, 3.0, 0, 0], [3.0, 3.0, 0, 0]])


@pytest.mark.parametrize(
    "poses, words",
    [
        (FAR[:3], ("poses must have the shape (4, 4), got (3, 4)",)),
        (FAR[:, :3], ("poses must have the shape (4, 4), got (4, 3)",)),
        (FAR + NAN * np.eye(4)[2][:, None], ("poses must be finite",)),
        (FAR + np.array([INF, 0, 0, 0]), ("poses must be finite",)),
        (FAR * 0.1, ("poses must keep robots 0.5 m apart", "uav_0", "uav_1")),
        (FAR + np.array([10.0, 0, 0, 0]), ("poses must keep 0.25 m from obstacles", "uav_0")),
        ("somewhere", ("poses must",)),
        ([[1, 2], [3]], ("poses must",)),
    ],
    ids=["too few", "too short", "nan", "inf", "overlapping", "in an obstacle", "text", "ragged"],
)
def test_bad_poses(poses, words):
    simulator = Simulator(small(map=Map().circle((10.0, 0.0), 0.5)))
    simulator.reset(1, poses=FAR)
    with pytest.raises(ValueError, match=r".") as error:
        simulator.reset(poses=poses)
    for word in words:
        assert word in str(error.value)
    np.testing.assert_array_equal(simulator.poses()[0], FAR)


@pytest.mark.parametrize("n_worlds", [0, -1, 1.5, True, None, "two"])
def test_bad_batches(n_worlds):
    with pytest.raises(ValueError, match=f"n_worlds must be a whole number, at least 1, got {n_worlds!r}"):
        Simulator(small(), n_worlds)


@pytest.mark.parametrize("chosen", ["LeaderFollow-v0", None, 3])
def test_a_simulator_needs_a_scenario(chosen):
    with pytest.raises(TypeError, match=f"must be a Scenario, got {chosen!r}: fovconn_env.scenario"):
        Simulator(chosen)


@pytest.mark.parametrize("n_threads", [0, -2, 1.5, True, "two"])
def test_bad_threads(n_threads):
    with pytest.raises(ValueError, match="n_threads must be"):
        Simulator(small(), 40, n_threads=n_threads)


@pytest.mark.parametrize("seed", [-1, [1, 2], "seven", 1.5])
def test_bad_seeds(seed):
    with pytest.raises((ValueError, TypeError), match="seed must be"):
        Simulator(small()).reset(seed)


def test_rules_read_as_sentences():
    with pytest.raises(ValueError, match=r"^Camera.a_min must be below a_max \(0.95\), got 0.96: both are cosines"):
        Camera(a_min=0.96)
