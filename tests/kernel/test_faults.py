"""What dies in an episode: cameras, radios, robots. What they lose, what stays, and that all else is as before."""

import copy
import dataclasses
import itertools
import math
import pickle

import numpy as np
import pytest

from fovconn_env import Camera, Clock, Course, Fault, Map, Radio, Simulator, layout, parallel_env, scenario
from fovconn_env.baselines import POLICIES, find_policy
from fovconn_env.flights.metrics import Meter
from fovconn_env.scenarios.presets import PRESETS
from fovconn_env.sim.starts import draw_faults
from tests import reference as ref
from tests.helpers import JIT, differing, few, recorded_actions, small, snapshot

pytestmark = pytest.mark.nojit

WHEN = few(5, 1)  # index of the step in which faults begin
AT = 0.05 * WHEN + 0.01  # s, after the first tick of that step
ENDLESS = {"patience": math.inf, "course": Course(settle=0.0)}
FLIGHTS = {
    "kinematic": {},
    "quadrotor": {"dynamics": "quadrotor"},
    "radio": {"link": "radio", "radio": Radio(delay=3)},
    "flooding": {"lambda2": "flooding"},
    "true": {"lambda2": "true", "relative_yaw": "true"},
}


def begin(*faults, seed=3, poses=None, n_worlds=1, **changes):
    simulator = Simulator(small(**({"n_agents": 5, "faults": faults} | ENDLESS | changes)), n_worlds)
    simulator.reset(seed, poses=poses)
    return simulator


def actions(steps=12, n=5, **more):
    return recorded_actions(steps, n, size=0.4, **more)


# ------------------------------------------------------------------------------------------------ nothing is shifted
@pytest.mark.parametrize("flight", FLIGHTS)
def test_a_fault_changes_nothing_before_it_begins(flight):
    """Same start, same key, same bits; and one that never begins changes none at all."""
    plain = begin(**FLIGHTS[flight])
    others = [begin(Fault(kind=kind, robot=2, at=AT), **FLIGHTS[flight]) for kind in ("camera", "radio", "robot")]
    never = begin(Fault(kind="robot", robot=2, at=100.0), Fault(kind="camera", at=(100.0, 200.0)), **FLIGHTS[flight])
    for k, action in enumerate(actions(few(10, 3))):
        for simulator in (plain, never, *others):
            simulator.step(action)
        assert set(differing(snapshot(never, 0), snapshot(plain, 0))) == {
            f"fault.{x}" for x in never.world.fault.dtype.names
        }
        for simulator in others:
            changed = {name for name in differing(snapshot(simulator, 0), snapshot(plain, 0)) if name[:6] != "fault."}
            assert bool(changed) == (k >= WHEN), changed


def test_blackout_starts_as_leader_follow():
    blackout, plain = (Simulator(scenario(name, warmup=0.1)) for name in ("Blackout-v0", "LeaderFollow-v0"))
    for simulator in (blackout, plain):
        simulator.reset(11)
    assert {name[:6] for name in differing(snapshot(blackout, 0), snapshot(plain, 0))} == {"fault."}


# ------------------------------------------------------------------------------------------------------------ camera
@pytest.mark.parametrize("flight", FLIGHTS)
def test_a_dead_camera_sees_nobody_and_is_seen(flight):
    plain = begin(**FLIGHTS[flight])
    blind = begin(Fault(kind="camera", robot=2, at=AT), **FLIGHTS[flight])
    watched = watching = 0
    for k, action in enumerate(actions(few(20, 4))):
        plain.step(action)
        blind.step(action)
        pair, whole = blind.state.pair[0], plain.state.pair[0]
        if k < WHEN:
            continue
        assert not pair["seen"][2].any()
        assert (pair["f_star"][2] == 0).all()
        assert not blind.state.sight["seen"][0, 2].any()
        others = np.arange(5) != 2
        assert (pair["seen"][others] == whole["seen"][others]).all()
        assert (pair["f_star"][:, 2] == whole["f_star"][:, 2]).all()
        watched, watching = watched + pair["seen"][:, 2].sum(), watching + whole["seen"][2].sum()
        np.testing.assert_allclose(pair["weight"][2], np.where(pair["seen"][:, 2], pair["weight"][2], 0.0))
    assert watched * watching > 0
    assert (blind.infos["alive"] == 1).all()


def test_a_fault_begins_and_ends_with_its_tick():
    """Two robots face each other; a step is one tick. Blind from 0.03 s on and again seeing from 0.05 s on."""
    facing = np.array([[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 0.0, math.pi]])
    ahead = Camera(optical_axis=(1.0, 0.0, 0.0))
    fault = Fault(kind="camera", robot=1, at=0.03, lasts=0.02)
    simulator = begin(fault, poses=facing, n_agents=2, clock=Clock(ticks=1), camera=ahead, stick_speed=0.01)
    seen = []
    for _ in range(8):
        simulator.step(np.zeros((1, 2, 4)))
        seen.append([bool(simulator.state.pair["seen"][0, i, 1 - i]) for i in (0, 1)])
        A = 1.0 * np.ones((2, 2)) - np.eye(2)  # 4 m, in the middle of the view: one watcher is enough
        np.testing.assert_allclose(simulator.adjacency()[0], A, rtol=0, atol=1e-12)
    assert seen == [[True, k not in (2, 3)] for k in range(8)]


# ------------------------------------------------------------------------------------------------------------- radio
@pytest.mark.parametrize("flight", FLIGHTS)
def test_a_dead_radio_neither_sends_nor_hears(flight):
    """From its tick on no message comes from or to it, not even those on the air; sights and true weights stay."""
    plain = begin(**FLIGHTS[flight])
    mute = begin(Fault(kind="radio", robot=2, at=AT), **FLIGHTS[flight])
    linked = 0
    for k, action in enumerate(actions(few(20, 4))):
        plain.step(action)
        mute.step(action)
        if k < WHEN:
            continue
        state = mute.state
        assert mute.infos["bytes_sent"][0, 2] == 0
        linked += plain.infos["bytes_sent"][0, 2] > 0
        inbox, mail, pair = state.inbox[0], state.unicast[0], state.pair[0]
        assert not (inbox["fresh"][2].any())
        assert not (inbox["fresh"][:, 2].any())
        assert not (mail["arrives"][:, 2].any())
        assert not (mail["arrives"][:, :, 2].any())
        assert not (pair["linked"][2].any())
        assert not (pair["linked"][:, 2].any())
        if k > WHEN + 1:  # radio.memory
            assert (state.track["weight"][0, 2] == 0).all()
        for name in ("seen", "f_star", "weight"):
            assert (pair[name] == plain.state.pair[name][0]).all()
        assert state.episode["lambda2"][0] == plain.state.episode["lambda2"][0]
    assert linked > 0


def test_what_is_on_the_air_to_a_dead_radio_is_gone():
    """A step is a tick, a message travels for five; in the third nothing arrives any more."""
    simulator = begin(Fault(kind="radio", robot=2, at=0.03), clock=Clock(ticks=1), radio=Radio(delay=10), warmup=0.1)
    heard = []
    for _ in range(6):
        simulator.step(np.zeros((1, 5, 4)))
        fresh = simulator.state.inbox["fresh"][0]
        heard.append((bool(fresh[2].any()), bool(fresh[:, 2].any())))
    assert heard == [(k < 2, k < 2) for k in range(6)]


def test_who_sees_a_silent_robot_goes_on_measuring_it():
    """A row without messages: where it is now, with its last words and no agreed weight."""
    mute = begin(Fault(kind="radio", robot=2, at=AT))
    for action in actions(few(60, 12)):
        mute.step(action)
    track, pair = mute.state.track[0], mute.state.pair[0]
    found = 0
    for i in range(5):
        if i != 2 and pair["seen"][i, 2]:
            found += 1
            assert track["present"][i, 2]
            assert track["distance"][i, 2] == pytest.approx(pair["distance"][i, 2], abs=1e-9)
    rows = layout.rows(mute.observations, mute.scenario.max_neighbors, mute.scenario.max_ranges).neighbors[0]
    silent = (rows["present"] > 0) & (rows["weight"] == 0) & (rows["f_ij"] > 0)
    assert silent[[0, 1, 3, 4]].sum() >= found > 0


@pytest.mark.parametrize("kind", ["camera", "radio", "robot"])
def test_pairs_that_sleep_have_nothing_to_do(kind):
    faults = Fault(kind=kind, robot=1, at=AT, lasts=1.0), Fault(kind=kind, robot=3, at=AT + 0.24)
    sleepy = begin(*faults, n_agents=6)
    awake = copy.deepcopy(sleepy)
    awake.params["rest_ticks"] = 10**9
    for action in actions(few(300, 8), 6):
        sleepy.step(action)
        awake.step(action)
        assert set(differing(snapshot(sleepy, 0), snapshot(awake, 0))) <= {"pair.idle_ticks", "pair.cosine"}
        if sleepy.over[0]:
            break


# ------------------------------------------------------------------------------------------------------------- robot
@pytest.mark.parametrize("flight", FLIGHTS)
def test_a_dead_robot(flight):
    """It stays where it is whatever it is told, sees, says and observes nothing, and is not one of the team."""
    dead = begin(Fault(kind="robot", robot=2, at=AT), **FLIGHTS[flight])
    other = copy.deepcopy(dead)
    for k, action in enumerate(actions(few(20, 4))):
        before = dead.poses()[0, 2]
        dead.step(action)
        action = action.copy()
        if k > WHEN:
            action[0, 2] = -action[0, 2]
        other.step(action)
        assert differing(snapshot(dead, 0), snapshot(other, 0)) == []
        if k < WHEN:
            assert (dead.infos["alive"] == 1).all()
            continue
        info, pair = dead.infos[0], dead.state.pair[0]
        assert k == WHEN or (dead.poses()[0, 2] == before).all()
        assert dead.state.body["vx"][0, 2] == dead.state.body["roll"][0, 2] == 0
        assert (dead.observations[0, 2] == 0).all()
        assert (dead.observations[0, [0, 1, 3, 4]] != 0).any(axis=1).all()
        assert info["alive"].tolist() == [1, 1, 0, 1, 1]
        assert info["bytes_sent"][2] == info["lambda2_hat"][2] == info["reward_effort"][2] == 0
        for name in ("seen", "linked", "weight", "f_star"):
            assert not (pair[name][2].any())
            assert not (pair[name][:, 2].any())
        living = np.delete(np.delete(dead.adjacency()[0], 2, 0), 2, 1)
        lambda2, v2 = ref.lambda2_v2(living)
        assert dead.state.episode["lambda2"][0] == pytest.approx(lambda2, abs=1e-9)
        found = dead.state.fiedler[0]
        assert found[2] == 0
        if np.diff(np.linalg.eigvalsh(ref.laplacian(living)))[1] > 1e-3:
            assert abs(np.delete(found, 2) @ v2) == pytest.approx(1.0, abs=1e-6)
        graph = dead.graph()
        assert (graph.nodes[2] == 0).all()
        assert not (graph.edge_index[1] == 2).any()
        if k > WHEN + 1:
            assert not (graph.edge_index == 2).any()
        block = dead.privileged()[0].reshape(-1)[: 5 * len(layout.STATE)].reshape(5, -1)[2]
        assert (block[3:] == 0).all()  # no heading: cosine and sine are 0, too
        assert (block[:3] != 0).any()
        assert not dead.over[0]


@pytest.mark.parametrize("end", ["robot", "scan"])
def test_a_dead_robot_is_an_obstacle(end):
    """The other flies into it, and its distance sensor has told so."""
    poses = np.array([[0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0]])
    simulator = begin(Fault(robot=1, at=0.0), poses=poses, n_agents=2, leader="none")
    ranges = []
    for _ in range(40):
        simulator.step(np.array([[[0.5, 0, 0, 0], [0, 0, 0, 0]]]))
        row = layout.rows(simulator.observations, 8, 8).ranges[0, 0, 0]
        ranges.append(float(row["x"]))
        if simulator.over[0]:
            break
    assert simulator.state.episode["collision"][0]
    assert ranges[0] == pytest.approx(1.75 - 1.25 * 0.05, abs=1e-3)
    assert ranges[-1] < 0.25


def test_one_robot_alone_is_no_team():
    simulator = begin(Fault(robot=1, at=0.0), n_agents=2)
    simulator.step(np.zeros((1, 2, 4)))
    assert simulator.state.episode["lambda2"][0] == 0.0
    assert (simulator.state.fiedler[0] == 0).all()
    assert (simulator.infos["connected"] == 0).all()


def test_all_robots_may_die():
    simulator = begin(*(Fault(robot=i, at=0.0) for i in range(5)))
    meter = Meter(simulator)
    for action in actions(3):
        simulator.step(action)
        meter.update()
    assert (simulator.observations == 0).all()
    assert np.isnan(meter.results()["mutual_share"][0])


def test_a_dead_leader_is_pulled_in_vain():
    simulator = begin(Fault(robot=0, at=AT))
    for action in actions(few(12, 4)):
        simulator.step(action)
    at, info = simulator.poses()[0, 0], simulator.infos[0]
    assert any(simulator.state.episode[f"stick_{axis}"][0] != 0 for axis in "xyz")
    simulator.step(actions(1)[0])
    assert (simulator.poses()[0, 0] == at).all()
    assert (info["reward_progress"] == 0).all()


@pytest.mark.parametrize("flight", FLIGHTS)
@pytest.mark.parametrize("kind", ["camera", "radio", "robot"])
def test_what_lasts_for_a_while_works_again(kind, flight):
    again = few(11, 3)  # index of the step in which it ends, after the fourth tick
    simulator = begin(Fault(kind=kind, robot=2, at=AT, lasts=0.05 * again + 0.04 - AT), **FLIGHTS[flight])
    back, sent = False, 0.0
    for k, action in enumerate(actions(few(40, 8))):
        before = simulator.poses()[0, 2]
        simulator.step(action)
        if simulator.over[0]:
            break
        body = simulator.state.body[0, 2]
        works = body["alive"] and body["sees"] and body["talks"]
        assert works == (k < WHEN or k >= again)
        if k > again + 1:
            back = back or simulator.state.sight["seen"][0, 2].any()
            sent += simulator.infos["bytes_sent"][0, 2]
            assert (simulator.poses()[0, 2] != before).any()
            heading = np.arctan2(body["sin_yaw"], body["cos_yaw"])
            assert ref.wrap(heading - body["yaw"]) == pytest.approx(0.0, abs=1e-9)
    assert sent > 0
    assert back


def test_faults_of_one_robot_add_up():
    simulator = begin(
        *(Fault(kind=kind, robot=2, at=0.26) for kind in ("camera", "radio")),
        Fault(kind="camera", robot=2, at=0.0, lasts=0.1),
    )
    flags = []
    for action in actions(7):
        simulator.step(action)
        body = simulator.state.body[0, 2]
        flags.append((bool(body["alive"]), bool(body["sees"]), bool(body["talks"])))
    assert flags == [(True, k in (1, 2, 3, 4), k < 5) for k in range(7)]


# ------------------------------------------------------------------------------------------------------- what is told
def test_a_link_lost_to_a_fault_is_called_so():
    facing = np.array([[0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 0.0, 0.0], [4.0, 3.0, 0.0, math.pi]])
    ahead = Camera(optical_axis=(1.0, 0.0, 0.0))  # 0 sees 1 and 2, 2 sees 0
    simulator = begin(Fault(kind="camera", robot=0, at=AT), poses=facing, n_agents=3, camera=ahead, leader="none")
    meter, causes = Meter(simulator), []
    for _ in range(8):
        simulator.step(np.zeros((1, 3, 4)))
        meter.update()
        causes.append([layout.LOST_LINK[int(code)] for code in simulator.infos["lost_link_cause"][0]])
    assert causes == [["fault", "fault", "none"] if k == WHEN else ["none"] * 3 for k in range(8)]
    results = meter.results()
    assert results["lost_by_fault"][0] == 1
    assert results["lost_by_view"][0] == 0
    assert layout.LOST_PAIR[int(results["split_cause"][0])] == "fault"


def test_measures_are_of_the_living():
    """As those of a team of five from which the sixth, which has been far away all the time, is missing."""
    poses = np.array([[0, 0, 0, 0], [4, 0, 0, 3.1], [4, 3, 0, 3.0], [0, 3, 0, 0.2], [2, 5, 0, -1.5], [60, 0, 0, 0.0]])
    settings = {"course": Course(settle=100.0), "lambda2": "true"}
    six = begin(Fault(robot=5, at=0.0), poses=poses, n_agents=6, **settings)
    five = begin(poses=poses[:5], n_agents=5, **settings)
    meters = Meter(six), Meter(five)
    for action in actions(few(60, 6), 6):
        six.step(action)
        five.step(action[:, :5])
        for meter in meters:
            meter.update()
    a, b = (meter.results() for meter in meters)
    for name in sorted(a.keys() - {"return", "bytes_per_second"}):  # mean over all agents; word of all robots is sent
        np.testing.assert_allclose(a[name], b[name], rtol=1e-9, atol=1e-12, err_msg=name)
    np.testing.assert_array_equal(meters[0].histograms()[:, 1:], meters[1].histograms()[:, 1:])
    assert meters[0].histograms()[:, 0].sum() == meters[1].histograms()[:, 0].sum()


def test_agents_stay_until_the_common_end():
    env = parallel_env(small(n_agents=4, faults=(Fault(robot=2, at=0.1),), max_cycles=6, **ENDLESS))
    env.reset(seed=1)
    for k in range(6):
        assert env.agents == env.possible_agents
        step = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        observations, _, terminations, truncations, infos = step
        assert infos["uav_2"]["alive"] == (k < 1)
        assert env.observation_space("uav_2").contains(observations["uav_2"])
        assert env.state_space.contains(env.state())
        assert len({*terminations.values(), *truncations.values()}) == 1 + (k == 5)
    assert env.agents == []


# ------------------------------------------------------------------------------------------------------------- draws
def test_draws():
    """Followers, each once, at times within bounds; other seeds, other draws; the same seed, the same."""
    preset, seen = PRESETS["Blackout-v0"], set()
    for seed in range(200):
        faults, again = (draw_faults(preset, np.random.default_rng(seed)) for _ in range(2))
        assert (faults == again).all()
        assert len(set(faults["robot"])) == 3
        assert faults["kind"].tolist() == [0, 1, 2]
        assert ((10 <= faults["at"]) & (faults["at"] <= 40)).all()
        np.testing.assert_array_equal(faults["until"], faults["at"] + [np.inf, 10.0, np.inf])
        seen.add(tuple(faults["robot"]))
    assert {robot for robots in seen for robot in robots} == {1, 2, 3, 4, 5}
    assert len(seen) > 40


@pytest.mark.parametrize(
    "changes, allowed",
    [
        ({"n_agents": 2}, {1}),
        ({"leader_index": 2}, {0, 1, 3, 4, 5}),
        ({"leader": "none"}, {0, 1, 2, 3, 4, 5}),
        ({"faults": (Fault(robot=0), Fault(robot=3), Fault(kind="camera"))}, {0, 3, 1, 2, 4, 5}),
    ],
)
def test_who_may_be_drawn(changes, allowed):
    settings, drawn = scenario("Blackout-v0", **changes), set()
    for seed in range(60):
        robots = draw_faults(settings, np.random.default_rng(seed))["robot"].tolist()
        assert len(set(robots)) == min(3, len(allowed))
        drawn |= set(robots)
    assert drawn == allowed


def test_nothing_is_drawn_without_need():
    for faults in ((), (Fault(kind="radio", robot=1, at=2.0),)):
        rng = np.random.default_rng(1)
        draw_faults(scenario(faults=faults), rng)
        assert rng.bit_generator.state == np.random.default_rng(1).bit_generator.state


def test_each_world_has_its_own_faults():
    """World b of a batch is the single world of seed s + b, also with a policy's other starts rules and in copies."""
    batch = Simulator(small("Blackout-v0"), 3)
    batch.reset(5)
    for b in range(3):
        alone = Simulator(small("Blackout-v0"))
        alone.reset(5 + b)
        assert (alone.world.fault[0] == batch.world.fault[b]).all()
    twin = pickle.loads(pickle.dumps(batch))
    before = batch.world.fault.copy()
    batch.reset(mask=np.array([False, True, False]))
    twin.reset(mask=np.array([False, True, False]))
    assert (batch.world.fault == twin.world.fault).all()
    assert (batch.world.fault == before)[[0, 2]].all()
    assert not (batch.world.fault == before)[1].all()


# ---------------------------------------------------------------------------------------------------------- policies
@pytest.mark.skipif(not JIT, reason="each takes seconds without the JIT, and the kernels are those of other tests")
@pytest.mark.parametrize("name", POLICIES)
def test_policies_fly_on(name):
    """Whatever fails, actions are finite, also those of the dead, who observe zeros."""
    kinds = itertools.cycle(("camera", "radio", "robot"))
    faults = tuple(Fault(kind=next(kinds), at=(0.05, 0.3), lasts=lasts) for lasts in (math.inf, 0.2, math.inf))
    base = small("Blackout-v0", n_agents=6, faults=faults, max_cycles=few(40, 10))
    kind = find_policy(name)
    simulator = Simulator(kind.equip(base), 2, starts=base)
    pilot, observations = kind(simulator.scenario), simulator.reset(4)
    while not simulator.over.all():
        action = pilot.act(observations)
        assert np.isfinite(action).all()
        observations = simulator.step(action)
    assert (simulator.infos["alive"].sum(axis=1) == 5).all()


# --------------------------------------------------------------------------------------------------------- bad input
@pytest.mark.parametrize(
    "make, field, rule, value",
    [
        (lambda: Fault(kind="rotor"), "Fault.kind", "one of camera, radio, robot", "'rotor'"),
        (lambda: Fault(robot=-1), "Fault.robot", "from 0 to 255", "-1"),
        (lambda: Fault(robot=1.5), "Fault.robot", "whole", "1.5"),
        (lambda: Fault(robot=True), "Fault.robot", "whole", "True"),
        (lambda: Fault(at=-1.0), "Fault.at", "at least 0", "-1.0"),
        (lambda: Fault(at=math.inf), "Fault.at", "finite", "inf"),
        (lambda: Fault(at=(20.0, 10.0)), "Fault.at", "in order", "(20.0, 10.0)"),
        (lambda: Fault(at=(1.0, 2.0, 3.0)), "Fault.at", "two", "(1.0, 2.0, 3.0)"),
        (lambda: Fault(at=[2.0]), "Fault.at", "two", "[2.0]"),
        (lambda: Fault(at="soon"), "Fault.at", "a number", "'soon'"),
        (lambda: Fault(lasts=0.0), "Fault.lasts", "above 0", "0.0"),
        (lambda: Fault(lasts=math.nan), "Fault.lasts", "finite", "nan"),
        (lambda: scenario(faults=(Fault(), Fault(robot=6))), "Scenario.faults[1].robot", "in 0..5", "6"),
        (lambda: scenario("Blackout-v0", n_agents=1), "Scenario.n_agents", "at least 2", "1"),
    ],
)
def test_impossible_faults(make, field, rule, value):
    with pytest.raises(ValueError, match=r".") as error:
        make()
    message = str(error.value)
    assert message.startswith(field)
    assert rule in message
    assert value in message
    assert ": " in message


@pytest.mark.parametrize("faults", [Fault(), ["robot"], ("robot",), None])
def test_faults_are_a_tuple_of_faults(faults):
    with pytest.raises(TypeError, match=r"Scenario\.faults must be a tuple of Faults"):
        scenario(faults=faults)


def test_faults_are_settings_like_others():
    settings = scenario("Blackout-v0")
    assert hash(settings) == hash(scenario("Blackout-v0"))
    assert settings == dataclasses.replace(settings)
    assert settings != scenario("Blackout-v0", faults=())
    assert pickle.loads(pickle.dumps(settings)) == settings


def test_faults_among_obstacles():
    """A dead robot among pillars: the judge, the sensor and the picture all go on."""
    tower = Map().circle((30.0, 0.0), 0.5)
    simulator = begin(Fault(kind="robot", at=(0.0, 0.2)), map=tower, camera=Camera(occlusion=True))
    for action in actions(8):
        simulator.step(action)
    assert simulator.infos["alive"].sum() == 4
