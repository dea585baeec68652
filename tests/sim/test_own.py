"""Own reward, termination, course and observation, in the core; tests/envs/test_own.py has the adapters."""

import copy
import pickle
from typing import Any

import numba
import numpy as np
import pytest

import fovconn_env
from fovconn_env import Simulator, layout, scenario
from fovconn_env.errors import OwnError, SettingError
from fovconn_env.flights.state_hash import state_hash
from fovconn_env.scenarios.own import Columns, OnBoard, Step
from fovconn_env.sim.own import PAIRS, ROBOTS, TEAMS

B, STEPS = 5, 12
ACTIONS = np.random.default_rng(3).uniform(-0.6, 0.6, (STEPS, B, 6, 4))


def crowding(step):
    near = -np.maximum(1.5 - step.robots["nearest"], 0.0)
    return {"near": near, "lambda2": step.teams["lambda2"][:, None]}


@numba.njit
def filled(step, reward):
    for b in range(reward.shape[0]):
        for i in range(reward.shape[1]):
            near = max(1.5 - step.robots[b, i].nearest, 0.0)
            reward[b, i] = step.teams[b].lambda2 - near


def widest(rows):
    return rows.neighbors["distance"].max(axis=1)


def after(count):
    def late(step):
        return step.teams["step"] >= count

    return late


def fly(**own: Any):
    simulator = Simulator(scenario("LeaderFollow-v0", **own), B)
    simulator.reset(7)
    results = []
    for actions in ACTIONS:
        simulator.step(actions)
        results.append((simulator.rewards.copy(), simulator.observations.copy(), simulator.over.copy()))
    return simulator, results


def hashes(simulator):
    return [state_hash(simulator, b) for b in range(B)]


# ------------------------------------------------------------------------------------------------------- reward
def test_a_flight_with_an_own_reward_is_the_same_flight():
    plain, _ = fly()
    for own in ({"reward": crowding}, {"reward": filled}, {"observation": Columns(widest, gap=(0, 9))}):
        assert hashes(plain) == hashes(fly(**own)[0])


def test_a_reward_is_the_sum_of_its_terms_computed_from_the_truth_after_the_step():
    simulator, results = fly(reward=crowding)
    body, episode = simulator.state.body, simulator.state.episode
    near = -np.maximum(1.5 - body["nearest"], 0.0)
    assert near.any()
    np.testing.assert_array_equal(simulator.reward_terms()["near"], near)
    np.testing.assert_array_equal(results[-1][0], near + episode["lambda2"][:, None])
    assert list(simulator.reward_terms()) == ["near", "lambda2"]


def test_a_compiled_function_pays_what_numpy_pays():
    for (a, *_), (b, *_) in zip(fly(reward=crowding)[1], fly(reward=filled)[1], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


def test_a_batch_pays_what_single_worlds_are_paid():
    _, batch = fly(reward=crowding)
    for b in range(B):
        single = Simulator(scenario("LeaderFollow-v0", reward=crowding), 1)
        single.reset(7 + b)
        for actions, (rewards, *_) in zip(ACTIONS, batch, strict=True):
            single.step(actions[b : b + 1])
            assert single.rewards[0].tobytes() == rewards[b].tobytes()


def test_built_in_terms_and_the_stick_of_the_step_are_at_hand():
    _, expected = fly()

    def again(step):
        return sum(step.infos[f"reward_{name}"] for name in layout.REWARDS)

    for (a, *_), (b, *_) in zip(expected, fly(reward=again)[1], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)
    seen = []
    simulator = Simulator(scenario("LeaderFollow-v0", leader="human", reward=lambda s: seen.append(s) or s.v2), 1)
    simulator.reset(7)
    simulator.push([0.3, 0.0, 0.0])
    simulator.step(np.full((1, 6, 4), 3.0))
    assert seen[-1].stick.tolist() == [[0.3, 0.0, 0.0]]
    assert (seen[-1].actions == 1.0).all()


def test_worlds_that_are_over_keep_their_reward_and_may_divide_by_zero():
    def risky(step):
        return np.where(step.moved[:, None], 1.0, np.nan) * np.ones(step.actions.shape[:2])

    settings = {"termination": lambda step: step.robots["x"][:, 0] > 0.0, "reward": risky}
    simulator, _ = fly(**settings)
    assert simulator.over.any()
    assert not simulator.over.all()
    assert (simulator.rewards == 1.0).all()


def test_a_reset_pays_nothing():
    simulator, _ = fly(reward=crowding)
    simulator.reset(mask=np.array([True, False, False, False, False]))
    assert (simulator.rewards[0] == 0).all()
    assert (simulator.reward_terms()["lambda2"][0] == 0).all()
    assert (simulator.rewards[1:] != 0).all()


@pytest.mark.parametrize(
    ("returned", "says"),
    [
        (lambda s: np.zeros(3), r"own reward f must be of the shape \(5, 6\), got \(3,\): .*x\[:, None\]"),
        (lambda s: {"a": np.zeros((5, 6)), "b": np.zeros(5)}, r"own reward f, term b must be of the shape"),
        (lambda s: np.full((5, 6), np.nan), "own reward f must be finite, got nan for uav_0 of world 0: a division"),
        (lambda s: None, "own reward f must be .*got (None|nan|\\(\\))"),
        (lambda s: "much", "own reward f must be an array of numbers, got 'much'"),
        (lambda s: {}, "own reward f must be an array, or a dict of arrays by name"),
    ],
)
def test_what_is_no_reward_is_refused_and_changes_no_reward(returned, says):
    wrong = [False]

    def f(step):
        return returned(step) if wrong[0] else np.ones((5, 6))

    simulator = Simulator(scenario("LeaderFollow-v0", reward=f), B)
    simulator.reset(7)
    simulator.step(ACTIONS[0])
    wrong[0] = True
    with pytest.raises(SettingError, match=says):
        simulator.step(ACTIONS[1])
    assert (simulator.rewards == 1).all()
    assert (simulator.reward_terms()["f"] == 1).all()
    wrong[0] = False
    simulator.step(ACTIONS[2])


def test_an_error_of_the_function_names_it_with_its_line():
    def broken(step) -> Any:
        return 1 / 0

    simulator = Simulator(scenario("LeaderFollow-v0", reward=broken), 1)
    simulator.reset(7)
    with pytest.raises(OwnError, match=r"own reward broken failed on LeaderFollow-v0: ZeroDivisionError.*test_own\.py"):
        simulator.step(np.zeros((1, 6, 4)))


def test_what_does_not_compile_is_told_in_short_lines_with_its_place():
    @numba.njit
    def slip(step, reward):
        reward[0, 0] = step.robotz[0, 0].x

    simulator = Simulator(scenario("LeaderFollow-v0", reward=slip), 1)
    simulator.reset(7)
    with pytest.raises(OwnError, match=r"(?s)own reward slip failed on .*'?robotz'?.*") as caught:
        simulator.step(np.zeros((1, 6, 4)))
    assert all(len(line) < 250 for line in str(caught.value).splitlines())


def test_nothing_can_be_written_to():
    def cheat(step) -> Any:
        for array in step:
            if isinstance(array, np.ndarray):
                assert not array.flags.writeable
        step.robots["x"][:] = 0.0

    simulator = Simulator(scenario("LeaderFollow-v0", reward=cheat), 1)
    simulator.reset(7)
    with pytest.raises(OwnError, match="read-only"):
        simulator.step(np.zeros((1, 6, 4)))


def test_what_is_no_function_is_refused():
    wrong: Any = 3
    with pytest.raises(SettingError, match=r"Scenario.reward must be a Reward"):
        scenario(reward=wrong)
    with pytest.raises(SettingError, match="own termination must be a function, got 3"):
        scenario(termination=wrong)
    wrong = widest
    with pytest.raises(SettingError, match="own observation must be Columns"):
        scenario(observation=wrong)
    with pytest.raises(SettingError, match=r"Columns\.gap must be two numbers, low and high, got"):
        Columns(widest, gap=(9, 0))


def test_settings_in_place_of_a_function_take_it_back():
    mine = scenario(reward=crowding, termination=after(3))
    own = scenario(mine, reward=fovconn_env.Reward(effort=0.0)).own
    assert own is not None
    assert own.reward is None
    assert scenario(mine, reward={}, termination=None).own is None


# -------------------------------------------------------------------------------------------------- termination
def test_an_own_termination_ends_the_episode_under_its_name():
    simulator, results = fly(termination=after(4))
    ended = [over.all() for *_, over in results]
    assert ended == [False] * 3 + [True] * (STEPS - 3)
    assert simulator.terminated.all()
    assert not simulator.truncated.any()
    assert simulator.own_outcomes()["late"].all()
    assert not simulator.state.episode["success"].any()
    simulator.reset(8)
    assert not simulator.own_outcomes()["late"].any()


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (lambda s: np.zeros((5, 6), bool), r"own termination <lambda> must be bool of the shape \(5,\)"),
        (lambda s: np.zeros(5), "must be bool"),
        (lambda s: {"success": np.zeros(5, bool)}, "under a name that infos have not, got 'success'"),
    ],
)
def test_what_is_no_termination_is_refused(function, says):
    simulator = Simulator(scenario(termination=function), B)
    simulator.reset(7)
    with pytest.raises(SettingError, match=says):
        simulator.step(ACTIONS[0])
    assert not simulator.over.any()


# ------------------------------------------------------------------------------------------------------- course
def test_an_own_course_changes_the_drawn_start():
    def high(start, rng):
        return start._replace(waypoints=start.waypoints + np.array([0.0, 0.0, rng.uniform(5.0, 6.0)]))

    plain, mine = Simulator(scenario()), Simulator(scenario(course=high), 2)
    plain.reset(7)
    mine.reset([7, 7])
    rise = mine.world.waypoint[:, :, 2] - plain.world.waypoint[:, :, 2]
    assert (rise[0] == rise[1]).all()
    assert 5 < rise.min() < 6
    np.testing.assert_array_equal(plain.poses()[0], mine.poses()[0])


def test_a_wrong_course_is_refused_before_anything_changes():
    for course, says in (
        (lambda start, rng: None, "own course <lambda> must be an EpisodeStart, got None"),
        (lambda start, rng: start._replace(waypoints=np.zeros((9, 3))), "waypoints of a start"),
        (lambda start, rng: 1 / 0, "own course <lambda> failed on LeaderFollow-v0: ZeroDivisionError"),
    ):
        simulator = Simulator(scenario(course=course))
        with pytest.raises(ValueError, match=says):
            simulator.reset(7)
        assert simulator.over.all()
        assert simulator.seeds == [None]


# -------------------------------------------------------------------------------------------------- observation
def test_own_columns_stand_behind_the_observation_within_their_bounds():
    plain, mine = fly()[1], fly(observation=Columns(widest, gap=(0, 4)))[1]
    for (_, a, _), (_, b, _) in zip(plain, mine, strict=True):
        assert a.tobytes() == b[..., :-1].tobytes()
        rows = layout.rows(a, 8, 8)
        np.testing.assert_array_equal(b[..., -1], np.minimum(rows.neighbors["distance"].max(axis=-1), 4))


def test_it_sees_what_is_on_board_and_nothing_else():
    """All that can be reached from the arrays is the observations."""
    handed = []
    simulator, _ = fly(observation=Columns(lambda rows: handed.append(rows) or widest(rows), gap=(0, 9)))
    simulator.reset(mask=np.array([True, False, False, False, False]))
    whole = simulator.state.flat
    sizes = {whole.nbytes, whole[:1].nbytes}
    assert {len(rows.own) for rows in handed} == {B * 6, B * 3, 6}
    for rows in handed:
        assert isinstance(rows, OnBoard)
        for array in rows:
            memory = array
            while isinstance(memory, np.ndarray):
                assert memory.nbytes <= max(sizes) + 128  # a cache line at each end
                assert not any(np.shares_memory(memory, part) for part in (simulator.state.body, simulator.state.info))
                memory = memory.base
            assert not array.flags.writeable
            assert memory is None


def test_columns_are_up_to_date_after_resets_pushes_and_copies():
    stick = Columns(lambda rows: rows.own["stick_x"], mine=(-1, 1))
    simulator = Simulator(scenario(leader="human", observation=stick), 3)
    simulator.reset(7)
    simulator.push([0.5, 0, 0])
    assert simulator.observations[:, 0, -1].tolist() == [0.5] * 3
    for twin in (copy.deepcopy(simulator), pickle.loads(pickle.dumps(Simulator(scenario(reward=crowding), 1)))):
        assert twin.scenario.own is not None
    simulator.reset(mask=np.array([True, False, False]))
    assert simulator.observations[:, 0, -1].tolist() == [0, 0.5, 0.5]


def test_a_dead_robot_observes_zeros():
    fault = fovconn_env.Fault(kind="robot", robot=2, at=0.05)
    simulator, _ = fly(observation=Columns(lambda rows: rows.own["vx"] + 5, speed=(-9, 9)), faults=(fault,))
    assert (simulator.observations[:, 2] == 0).all()
    assert (simulator.observations[:, 3, -1] > 2).all()


def test_dropped_columns_are_gone_in_value_and_bounds():
    plain, _ = fly()
    simulator, _ = fly(drop=("ranges", "neighbors.age", "self.roll"), observation=Columns(widest, gap=(0, 9)))
    names = [f"self.{c.name}" for c in layout.SELF] + [f"neighbors.{c.name}" for c in layout.NEIGHBOR] * 8
    keep = [k for k, name in enumerate(names) if name not in ("neighbors.age", "self.roll")]
    np.testing.assert_array_equal(simulator.observations[..., :-1], plain.observations[..., keep])
    for mine, all_ in zip(simulator.observation_bounds, plain.observation_bounds, strict=True):
        np.testing.assert_array_equal(mine[:-1], all_[keep])
    assert simulator.observation_groups == {
        "self": slice(0, 12),
        "neighbors": slice(12, 12 + 8 * 19),
        "extra": slice(164, 165),
    }


@pytest.mark.parametrize(
    ("own", "says"),
    [
        (
            {"observation": Columns(lambda r: r.own["vx"] - r.neighbors["distance"].mean(), a=(-9, 9))},
            "computed row by row, got 'other numbers where there are fewer rows': a robot knows no other",
        ),
        ({"drop": "rages"}, "drop must be groups and columns of the observation, got 'rages': did you mean 'ranges'?"),
        ({"drop": ("self", "neighbors", "ranges")}, "drop must be less than all columns"),
        ({"observation": Columns(lambda r: np.zeros((3, 1)), a=(0, 1))}, r"shape \(6, 1\), got \(3, 1\)"),
        (
            {"observation": Columns(lambda r: r.own["vx"] * np.nan, a=(0, 1))},
            "must be finite, got nan in column a of row 0",
        ),
    ],
)
def test_wrong_columns_are_refused(own, says):
    with pytest.raises(SettingError, match=says.replace("?", r"\?")):
        Simulator(scenario(**own), 1).reset(7)


def test_the_public_fields_are_those_of_the_records():
    simulator, _ = fly()
    for names, array in (
        (ROBOTS, simulator.state.body),
        (PAIRS, simulator.state.pair),
        (TEAMS, simulator.state.episode),
    ):
        assert set(names) <= set(array.dtype.names or ())
    assert Step._fields[0] == "moved"


def test_the_outcomes_are_the_same_in_every_step():
    ends = iter(("low", "high"))

    def changing(step):
        return {next(ends): np.zeros(len(step.moved), bool)}

    simulator = Simulator(scenario(n_agents=3, warmup=0.1, termination=changing))
    simulator.reset(7)
    simulator.step(np.zeros((1, 3, 4)))
    with pytest.raises(SettingError, match=r"of the same outcomes in every step, got \['high'\]: .* low"):
        simulator.step(np.zeros((1, 3, 4)))


def test_an_own_end_in_the_last_step_is_no_truncation():
    """As with the ends of the package: a flight that ends by itself in its last step was not cut off."""

    def now(step):
        return np.array([True, False])

    simulator = Simulator(scenario(n_agents=3, warmup=0.1, max_cycles=1, termination=now), 2)
    simulator.reset(3)
    simulator.step(np.zeros((2, 3, 4)))
    assert simulator.over.tolist() == [True, True]
    assert simulator.terminated.tolist() == [True, False]
    assert simulator.truncated.tolist() == [False, True]
