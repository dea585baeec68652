"""What must hold of any team: symmetry, connectivity, no common frame, no names, no telepathy."""

import ast
import copy
import inspect
from pathlib import Path

import numpy as np
import pytest

from fovconn_env.kernel import step
from fovconn_env.kernel.onboard import (
    detections,
    flooding,
    liveness,
    messages,
    observation,
    power_iteration,
    relative_yaw,
    robot,
)
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.settings import Airframe, Camera, Clock, Course, Noise, Radio
from fovconn_env.sim.simulator import Simulator
from fovconn_env.sim.starts import EpisodeStart
from tests import reference as ref
from tests.helpers import contents, differing, draw_team, few, fiedler, recorded_actions, small, snapshot

pytestmark = pytest.mark.nojit

NOISE = Noise(
    **dict(
        position_noise=0.05,
        position_bias=0.05,
        velocity_noise=0.05,
        velocity_bias=0.05,
        gyro_noise=0.05,
        gyro_bias=0.02,
    ),
    **dict(attitude_noise=0.02, attitude_bias=0.02, range_noise=0.05, range_bias=0.05),
)
ROUGH = Airframe(rotor_noise=0.02, force_noise=0.3)
MOVING = Course(settle=0.0)


def pillars():
    """Obstacles inside and around the start box of four robots."""
    tower = Map().circle((1.0, 0.5), 0.3).wall((-5.0, 2.0), (-5.0, -2.0), 0.3, low=-2.0, high=1.0)
    return tower.polygon([(3.0, -4.0), (5.0, -4.0), (5.0, -2.0), (4.0, -3.0)], low=-1.0, high=1.0)


# ---------------------------------------------------------------------------------------------------- the graph
def connected(A):
    reach = np.eye(len(A)) + (A > 0)
    return bool((np.linalg.matrix_power(reach, len(A)) > 0).all())


@pytest.mark.parametrize("n", [2, 3, 5, 8, 16])
def test_lambda2_is_positive_exactly_when_connected(n):
    rng, counts = np.random.default_rng(n), [0, 0]
    for _ in range(few(200, 25)):
        A = np.triu(rng.uniform(0.05, 1, (n, n)) * (rng.random((n, n)) < rng.uniform(0.5, 6.0) / n), 1)
        A += A.T
        lambda2 = fiedler(A, np.zeros(n))
        assert (lambda2 > 1e-9) == connected(A)
        counts[connected(A)] += 1
    assert min(counts) > 0


@pytest.mark.parametrize("changes", [{}, {"dynamics": "quadrotor", "airframe": ROUGH}], ids=["kinematic", "quadrotor"])
def test_true_graph(changes):
    """Weights are symmetric and in [0, 1]; lambda2 and v2 are those of a Laplacian: L 1 = 0, L v2 = lambda2 v2."""
    simulator = Simulator(small(n_agents=5, **changes))
    simulator.reset(1)
    for action in recorded_actions(few(80, 4), 5):
        simulator.step(action)
        A, lambda2 = simulator.adjacency()[0], simulator.state.episode["lambda2"][0]
        v2 = simulator.state.fiedler[0]
        assert (A == A.T).all()
        assert (np.diag(A) == 0).all()
        assert ((0 <= A) & (A <= 1)).all()
        L = ref.laplacian(A)
        np.testing.assert_allclose(L.sum(axis=1), 0.0, rtol=0, atol=1e-12)
        np.testing.assert_allclose(L @ v2, lambda2 * v2, rtol=0, atol=1e-9)
        assert v2.sum() == pytest.approx(0.0, abs=1e-9)
        assert lambda2 == pytest.approx(np.linalg.eigvalsh(L)[1], abs=1e-9)


# ------------------------------------------------------------------------------------------------ no names: labels
PER_ROBOT = "body flight ego belief fiedler info reward flat".split()
PER_PAIR = "pair sight inbox track".split()
FLOODING = {"lambda2": "flooding"}


def relabel(simulator, order):
    """The same simulation with its robots counted in another order."""
    state = simulator.state
    for name in PER_ROBOT:
        array = getattr(state, name)
        array[:] = array[:, order].copy()
    for name in PER_PAIR:
        array = getattr(state, name)
        array[:] = array[:, order][:, :, order].copy()
    state.broadcast[:] = state.broadcast[:, :, order].copy()
    state.unicast[:] = state.unicast[:, :, order][:, :, :, order].copy()
    if simulator.scenario.lambda2 == "flooding":
        entries = [*order, len(order)]  # and the tick
        state.table[:] = state.table[:, order][:, :, order][..., entries].copy()
        state.air[:] = state.air[:, :, order][:, :, :, order][..., entries].copy()
        state.mode[:] = state.mode[:, order][:, :, order].copy()
    state.episode["leader"] = order.index(int(state.episode["leader"][0]))


@pytest.mark.parametrize("lambda2", ["power", "flooding", "true"])
@pytest.mark.parametrize("dynamics", ["kinematic", "quadrotor"])
def test_relabelling_robots_permutes_what_they_get(dynamics, lambda2):
    order = [3, 0, 4, 1, 2]
    plain = Simulator(
        small(n_agents=5, course=MOVING, dynamics=dynamics, lambda2=lambda2, leader_index=2, map=pillars())
    )
    plain.reset(4)
    renamed = copy.deepcopy(plain)
    relabel(renamed, order)
    for action in recorded_actions(few(60, 4), 5):
        before = plain.observations.copy()
        plain.step(action)
        renamed.step(action[:, order])
        np.testing.assert_allclose(renamed.observations[0], plain.observations[0, order], rtol=0, atol=1e-5)
        np.testing.assert_allclose(renamed.rewards[0], plain.rewards[0, order], rtol=0, atol=1e-9)
        for name in plain.infos.dtype.names:
            np.testing.assert_allclose(
                renamed.infos[name][0], plain.infos[name][0, order], rtol=0, atol=1e-7, err_msg=name
            )
        assert plain.over[0] == renamed.over[0]
        if plain.over[0]:
            break
        assert (before != plain.observations).any()


# ------------------------------------------------------------------------------------------------------ messages
LINKED = {
    "paper": {},
    "slow": {"radio": Radio(delay=3)},
    "noisy": {"noise": NOISE, "camera": Camera(miss=0.2, coast=0.05)},
    "radio": {"link": "radio", "weight": "product"},
}


@pytest.mark.parametrize("case", LINKED)
def test_both_ends_of_a_link_agree(case):
    """Without loss both ends use the same bits for A_ij, and what one adds in the consensus the other takes away."""
    simulator = Simulator(small(n_agents=5, patience=1e3, **LINKED[case]))
    simulator.reset(3)
    links = set()
    for action in recorded_actions(few(150, 5), 5):
        simulator.step(action)
        state = simulator.state
        fresh, weight = state.inbox["fresh"][0], state.track["weight"][0]
        assert (fresh == fresh.T).all()
        assert (weight == weight.T).all()
        for q in ("q1", "q2", "q3"):  # M is symmetric and its rows sum to 0: the sum of M y is 0
            assert abs(state.belief[q][0].sum()) < 1e-12
        links.add(fresh.tobytes())
        if simulator.over[0]:
            break
    assert len(links) > (few(3, 0) if case != "radio" else 0)


@pytest.mark.parametrize("rounds", [1, 2])
@pytest.mark.parametrize("delay", [1, 2, 3])
def test_a_message_arrives_in_a_later_round(delay, rounds):
    """Each step, a tick here, every robot flies at another speed: its neighbours hear it `delay` rounds later."""
    simulator = Simulator(small(clock=Clock(ticks=1, rounds=rounds), radio=Radio(delay=delay), patience=1e3))
    simulator.reset(6)
    spoken, heard = [], 0
    for k in range(8):
        action = np.zeros((1, 4, 4))
        action[..., 0] = 0.01 * (k + 1)
        simulator.step(action)
        # the rounds of this tick deliver what was written `delay` rounds before
        spoken += [simulator.state.ego["vx"][0].copy()] * rounds
        inbox = simulator.state.inbox[0]
        for i, j in zip(*np.nonzero(inbox["fresh"]), strict=True):
            if len(spoken) > delay:
                heard += 1
                assert inbox["vx"][i, j] == spoken[-1 - delay][j]
    assert heard > 20


OPTIONS = {
    "delay": {"radio": Radio(delay=2)},
    "long delay": {"radio": Radio(delay=5)},
    "loss": {"radio": Radio(loss=0.3)},
    "heavy loss": {"radio": Radio(loss=0.9)},
    "loss and delay": {"radio": Radio(loss=0.2, delay=2)},
    "noise": {"noise": NOISE, "camera": Camera(miss=0.5)},
    "one slow round": {"clock": Clock(tick=0.05, ticks=1, rounds=1)},
    "product": {"weight": "product", "link": "radio"},
    "omni": {"weight": "omni"},
}


@pytest.mark.parametrize("case", OPTIONS)
def test_options_keep_observations_within_bounds(case):
    """Whatever a scenario allows, observations are finite numbers within their bounds."""
    simulator = Simulator(small(n_agents=6, patience=1e3, warmup=few(500, 20) * 0.01, **OPTIONS[case]))
    for seed in range(few(4, 1)):
        simulator.reset(seed)
        for action in recorded_actions(few(100, 2), 6, seed=seed):
            simulator.step(action)
        observations, world = simulator.observations, simulator.world
        assert np.isfinite(observations).all()
        assert ((world.low <= observations) & (observations <= world.high)).all()
        for name in simulator.state.belief.dtype.names:
            assert np.isfinite(simulator.state.belief[name]).all()


# ------------------------------------------------------------------------------------------------ no common frame
def start_of(simulator):
    world = simulator.world
    piece = world.piece[0][world.piece[0]["count"] > 0]
    waypoints = world.waypoint[0, : world.n_waypoints[0]].copy()
    return EpisodeStart(simulator.poses()[0], waypoints, piece, world.vertex[0].copy())


def turned(start, angle, shift):
    """The start with the world turned about z, then shifted (3,)."""
    R, poses, pieces = ref.Rz(angle), start.poses.copy(), start.pieces.copy()
    poses[:, :3] = poses[:, :3] @ R.T + shift
    poses[:, 3] += angle
    pieces["low"] += shift[2]
    pieces["high"] += shift[2]
    return EpisodeStart(poses, start.waypoints @ R.T + shift, pieces, start.vertices @ R[:2, :2].T + shift[:2])


def difference(a, b):
    """Largest difference of the observations (float32), and of what stands behind them (float64)."""
    differences = [np.abs(a.observations - b.observations).max(), np.abs(a.rewards - b.rewards).max()]
    for name in ("ego", "belief", "info"):
        x, y = getattr(a.state, name), getattr(b.state, name)
        differences += [np.abs(x[field] - y[field]).max() for field in x.dtype.names]
    return max(differences)


FRAMES = {
    "kinematic": {},
    "obstacles": {"map": pillars, "camera": Camera(occlusion=True)},
    "quadrotor, noise": {
        "dynamics": "quadrotor",
        "airframe": ROUGH,
        "noise": NOISE,
        "camera": Camera(miss=0.05, occlusion=True),
        "radio": Radio(loss=0.1),
        "map": pillars,
    },
}


def framed(case):
    """The scenario's changes; a map is made when it is needed: pymunk complains of one that outlives it."""
    changes = FRAMES[case]
    return {**changes, "map": changes["map"]()} if "map" in changes else changes


TURNS = [(-0.7, (1e3, -700.0, 50.0)), (2.0, (0.0, 0.0, 0.0)), (np.pi, (-1e3, 1e3, -1e2))]


@pytest.mark.parametrize("angle, shift", TURNS[: few(3, 1)])
@pytest.mark.parametrize("case", FRAMES)
def test_turning_and_shifting_the_world_changes_nothing(case, angle, shift):
    here = Simulator(small(course=MOVING, patience=1e3, **framed(case)))
    here.reset(7)
    there, start = copy.deepcopy(here), start_of(here)
    here.reset(7, starts=start)
    there.reset(7, starts=turned(start, angle, np.array(shift)))
    worst = difference(here, there)
    for action in recorded_actions(20, 4, size=0.3):
        here.step(action)
        there.step(action)
        worst = max(worst, difference(here, there))
        assert not here.over[0]
    assert np.abs(there.poses() - here.poses()).max() > 1.0  # it is elsewhere
    assert np.abs(here.observations).max() > 1.0
    print(f"worst difference {worst:.1e}")  # pytest -rP shows it
    assert worst < 1e-5


# ---------------------------------------------------------------------------------------------------- no telepathy
ON_BOARD = "ego sight inbox track belief table mode flat".split()


def on_board(simulator, i):
    """Everything that robot i has on board, as bytes."""
    parts = {name: contents(getattr(simulator.state, name)[0, i]) for name in ON_BOARD}
    return {f"{part}.{name}": data for part, fields in parts.items() for name, data in fields.items()}


def position(simulator, k):
    return simulator.poses()[0, k, :3]


def scramble(simulator, k, rng, away):
    """Put robot k somewhere else, in another state, with other beliefs."""
    state = simulator.state
    for name in ("ego", "belief"):
        array = getattr(state, name)
        for field in array.dtype.names:
            array[field][0, k] = rng.random()
    for name in ("track", "inbox", "sight"):
        array = getattr(state, name)
        for field in array.dtype.names:
            kind = array.dtype[field]
            array[field][0, k] = (
                rng.uniform(0.1, 1, array.shape[2]) if kind.kind == "f" else rng.random(array.shape[2]) < 0.5
            )
    state.table[0, k] = rng.uniform(0, 100, state.table[0, k].shape)
    body = state.body
    for axis, value in zip("xyz", away, strict=True):
        body[axis][0, k] = value
    yaw = rng.uniform(-3, 3)
    body["yaw"][0, k], body["cos_yaw"][0, k], body["sin_yaw"][0, k] = yaw, np.cos(yaw), np.sin(yaw)
    if simulator.scenario.dynamics == "quadrotor":
        state.flight["qw"][0, k], state.flight["qz"][0, k] = np.cos(yaw / 2), np.sin(yaw / 2)
        state.flight["rotor0"][0, k] *= 1.02


@pytest.mark.parametrize("case", ["kinematic", "quadrotor, noise", "flooding"])
def test_a_robot_out_of_touch_changes_nothing(case):
    """Not in sight, not in range, not linked: within a tick of two rounds, nothing that i has changes by a bit."""
    changes = {**(FLOODING if case == "flooding" else FRAMES[case]), "map": None}
    simulator = Simulator(small(n_agents=6, clock=Clock(ticks=1, rounds=2), patience=1e3, **changes))
    rng, compared = np.random.default_rng(8), 0
    for seed in range(few(12, 1)):
        simulator.reset(seed)
        for action in recorded_actions(few(5, 2), 6, seed=seed):
            simulator.step(action)
        action, state = recorded_actions(1, 6, seed=100 + seed)[0], simulator.state
        mute = ~(state.pair["linked"][0] | state.inbox["fresh"][0] | state.unicast["arrives"][0, 0])
        for i, k in np.argwhere(mute & (state.pair["distance"][0] > 4.0))[: few(30, 4)]:
            plain, other = copy.deepcopy(simulator), copy.deepcopy(simulator)
            scramble(other, k, rng, position(simulator, k) + np.array([60.0, 0.0, 20.0]))
            action_k = action.copy()
            action_k[0, k] = rng.uniform(-1, 1, 4)
            plain.step(action)
            other.step(action_k)
            assert differing(on_board(plain, i), on_board(other, i)) == []
            assert differing(on_board(plain, k), on_board(other, k)) != []
            compared += 1
    assert compared > few(20, 1)


@pytest.mark.parametrize(
    "changes", [{}, {"radio": Radio(delay=3, loss=0.2), "camera": Camera(miss=0.3, coast=0.12)}, FLOODING]
)
def test_pairs_that_sleep_have_nothing_to_do(changes):
    """Pairs without a link for long are left out of every tick; visiting them anyway changes no bit."""
    sleepy = Simulator(small(n_agents=6, patience=1e9, course=MOVING, **changes))
    sleepy.reset(2)
    awake = copy.deepcopy(sleepy)
    awake.params["rest_ticks"] = 10**9
    slept = woke = 0
    for action in recorded_actions(few(400, 6), 6, size=1.0):
        before = sleepy.state.pair["idle_ticks"] == sleepy.params["rest_ticks"]
        for simulator in (sleepy, awake):
            simulator.step(action)
        asleep = sleepy.state.pair["idle_ticks"] == sleepy.params["rest_ticks"]
        slept, woke = slept + (asleep & ~before).sum(), woke + (before & ~asleep).sum()
        apart = set(differing(snapshot(sleepy, 0), snapshot(awake, 0)))
        assert apart <= {"pair.idle_ticks", "pair.cosine"}, apart  # nobody reads the cosine of a pair out of reach
        if sleepy.over[0]:
            break
    assert min(slept, woke) > few(5, -1)


def test_a_robot_in_touch_does_change_something():
    """The check above can fail: a robot that is in sight does change what the other has."""
    simulator = Simulator(small(n_agents=6, clock=Clock(ticks=1, rounds=2), patience=1e3))
    simulator.reset(0)
    state = simulator.state
    i, k = np.argwhere(state.sight["seen"][0])[0]
    plain, other = copy.deepcopy(simulator), copy.deepcopy(simulator)
    scramble(other, k, np.random.default_rng(1), position(simulator, k) + 0.01)
    for s in (plain, other):
        s.step(np.zeros((1, 6, 4)))
    assert differing(on_board(plain, i), on_board(other, i)) != []


# ------------------------------------------------------------------------------- decentralised by the signatures
MODULES = (detections, flooding, liveness, messages, observation, power_iteration, relative_yaw, robot)
TRUTH = {"body", "bodies", "pair", "pairs", "flight", "flights", "world", "state", "piece", "vertex", "info", "infos"}
TRUTH |= {"episode", "episodes", "key", "beliefs", "params"}
FUNCTIONS = {"start", "sense", "look", "see", "receive", "send", "send_note", "estimate_yaw", "observe"}  # a robot's
SLICES = {"Robot": ("b", "i"), "Outbox": ("b", "slot", "i"), "Message": ("b", "slot", "j")}  # of robot i, or of j


def plain(function):
    return getattr(function, "py_func", getattr(function, "__wrapped__", function))


def on_board_functions():
    names = {
        f"{module.__name__.rpartition('.')[2]}.{node.name}": getattr(module, node.name)
        for module in MODULES
        for node in ast.parse(inspect.getsource(module)).body
        if isinstance(node, ast.FunctionDef)
    }
    assert {f"robot.{name}" for name in FUNCTIONS} <= set(names)
    return names


def test_every_on_board_module_is_checked():
    folder = Path(robot.__file__).parent
    assert {Path(module.__file__) for module in MODULES} == set(folder.glob("*.py")) - {folder / "__init__.py"}


@pytest.mark.parametrize("name", on_board_functions())
def test_on_board_kernels_cannot_reach_the_truth(name):
    function = plain(on_board_functions()[name])
    assert not set(inspect.signature(function).parameters) & TRUTH
    body = ast.parse(inspect.getsource(function))
    used = {node.id for node in ast.walk(body) if isinstance(node, ast.Name)}
    used |= {node.attr for node in ast.walk(body) if isinstance(node, ast.Attribute)}
    assert not used & TRUTH


def test_what_a_robot_is_handed_holds_no_truth():
    for kind in (messages.Message, messages.Outbox, messages.Round, robot.Robot):
        assert not set(kind._fields) & TRUTH
    assert set(inspect.signature(plain(robot.start)).parameters) == {"me", "x", "p"}  # the start draw, not the key


def calls(tree, module):
    """Calls of functions of a module, or of one name, in a tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            f = node.func
            if isinstance(f, ast.Attribute) and isinstance(f.value, ast.Name) and f.value.id == module:
                yield f.attr, node
            elif isinstance(f, ast.Name) and f.id == module:
                yield f.id, node


def test_a_robot_is_handed_its_own_slices():
    """In step.py, what a robot gets is cut out of the state for it alone: every array is indexed by the robot."""
    tree = ast.parse(inspect.getsource(step))
    for kind, index in SLICES.items():
        ((_, made),) = calls(tree, kind)  # in one place
        arrays = [argument for argument in made.args if not (isinstance(argument, ast.Name) and argument.id == "i")]
        assert len(made.args) == len(getattr(robot if kind == "Robot" else messages, kind)._fields)
        assert not made.keywords
        for argument in arrays:
            at = [ast.unparse(part) for part in argument.slice.elts]
            own = [*index, "i"] if (kind, argument.value.attr) == ("Message", "unicast") else list(index)
            assert at == own, ast.unparse(argument)


def test_step_hands_robots_nothing_else():
    """Each call of a robot's function gets a robot's slices and plain numbers, never the arrays of all."""
    tree = ast.parse(inspect.getsource(step))
    plain_numbers = {"x", "j", "p", "turn", "tick", "leads", "stick", "work", "bounds"}
    slices = {"robot_of(state, b, i)", "outbox_of(state, b, slot, i)", "contacts_of(scratch, i)", "message"}
    slices |= {"report_of(state, b, (tick + 1) % slots, i)"}
    called = set()
    for name, call in calls(tree, "robot"):
        called.add(name)
        assert {ast.unparse(argument) for argument in call.args} <= plain_numbers | slices, ast.unparse(call)
        assert not call.keywords
    assert called == FUNCTIONS
    named = {"message": "message_of(state, b, slot, j, i)"}
    named |= {"work": "(scratch.laplacian, scratch.spectrum, scratch.nearest)", "bounds": "(world.low, world.high)"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            target, value = node.targets[0], node.value
            both = isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple)
            for name, part in zip(target.elts, value.elts, strict=True) if both else [(target, value)]:
                for known in {n.id for n in ast.walk(name) if isinstance(n, ast.Name)} & set(named):
                    assert ast.unparse(part) == named[known]


def test_step_calls_no_other_on_board_function():
    """But for the oracle of lambda2, a switch."""
    tree = ast.parse(inspect.getsource(step))
    imported = {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fovconn_env.kernel.onboard")
        for alias in node.names
    }
    assert imported == {
        "Message",
        "Outbox",
        "Robot",
        "Round",
        "power_iteration",
        "relative_yaw",
        "robot",
        "set_estimate",
    }
    assert not list(calls(tree, "power_iteration")) + list(calls(tree, "relative_yaw"))  # constants


def test_every_start_of_a_pair_is_symmetric():
    """Who is linked does not depend on who asks: the truth about (i, j) and (j, i) agrees."""
    rng, scenario = np.random.default_rng(9), small(n_agents=5)
    simulator = Simulator(scenario)
    for _ in range(few(50, 5)):
        team = draw_team(rng, 5)
        try:
            simulator.reset(1, poses=np.array([[*pose.p, pose.yaw] for pose in team]))
        except ValueError:
            continue  # too near
        pair = simulator.state.pair[0]
        for name in ("distance", "blocked", "linked", "weight"):
            assert (pair[name] == pair[name].T).all()
