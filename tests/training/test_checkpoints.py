"""Checkpoints with right checksums that hold what no training leaves: refused in one line, and no index is followed."""

import dataclasses
import json

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from fovconn_env import Forest, scenario
from fovconn_env.errors import SettingError
from fovconn_env.files import Archive, Damaged
from fovconn_env.training.learn.dagger import Dagger, DaggerSettings
from fovconn_env.training.learn.learning import restore
from fovconn_env.training.learn.model import Network
from fovconn_env.training.learn.origin import check_recipe
from fovconn_env.training.learn.ppo import PPOSettings, Team

TINY = {"n_agents": 3, "warmup": 0.1, "max_cycles": 20, "course.settle": 0.0}
TASKS = [scenario(**TINY), scenario("LeaderObstacles-v0", map=Forest(n_pillars=3, n_walls=1), **TINY)]
SMALL = Network(width=8, spots=4, hidden=(16, 8))
BEST = {"worth": 1.0, "steps": 8, "success": 0.5}


def dagger():
    settings = DaggerSettings(n_worlds=2, n_steps=8, every=2, capacity=60, n_updates=2, batch=16, mixed=0.9)
    return Dagger(TASKS, 3, settings, SMALL, n_threads=1)


def team():
    settings = PPOSettings(n_worlds=2, n_steps=12, batch=24, n_epochs=1)
    return Team(TASKS[:1], 3, dataclasses.replace(settings), SMALL, n_threads=1)


@pytest.fixture(scope="module")
def contents():
    """What DAgger leaves after an iteration."""
    algorithm = dagger()
    algorithm.iterate(0.0)
    algorithm.iteration += 1
    arrays = {name: np.array(array) for name, array in algorithm.pack().items()}
    return Archive({"recipe": algorithm.recipe(), "best": BEST}, arrays)


@pytest.fixture(scope="module")
def target():
    return dagger()


def test_what_was_left_is_restored(contents):
    algorithm = dagger()
    assert restore(algorithm, contents, {}, "c.npz") == BEST
    again = algorithm.pack()
    assert again.keys() == contents.arrays.keys()
    for name, array in contents.arrays.items():
        for field in array.dtype.names or (...,):
            np.testing.assert_array_equal(again[name][field], array[field], err_msg=name)


def put(name, value, field=..., at=0):
    """An array with another number in one place."""

    def change(arrays):
        array = arrays[name].copy()
        array[field].reshape(-1)[at] = value
        return {**arrays, name: array}

    return change


def other(name, change):
    return lambda arrays: {**arrays, name: change(arrays[name])}


WEIGHT, MOMENT = "policy/action_net.weight", "optimizer/1/exp_avg"
HOSTILE = {
    "gone": (
        lambda a: {name: array for name, array in a.items() if name != WEIGHT},
        "policy of the checkpoint must be",
    ),
    "more": (
        lambda a: {**a, "policy/code": np.zeros(1)},
        "policy of the checkpoint must be an object of known names, got 'code'",
    ),
    "shape": (other(WEIGHT, lambda w: w.T), "weight must be of the shape"),
    "type": (other(WEIGHT, lambda w: w.astype("f8")), "weight must be of the type float32, got 'float64'"),
    "NaN": (put(WEIGHT, np.nan), "weight must be finite"),
    "moments": (other(MOMENT, lambda m: m[:0]), "exp_avg must be of the shape"),
    "moments of nobody": (lambda a: {**a, "optimizer/999/step": np.zeros((), "f4")}, "optimizer of the checkpoint"),
    "moments of a name": (lambda a: {**a, "optimizer/x/step": np.zeros((), "f4")}, "optimizer of the checkpoint"),
    "counters": (put("counters", -1.0), "counters must be at least 0"),
    "counters gone": (lambda a: {n: v for n, v in a.items() if n != "counters"}, "counters must be an array"),
    "counters without end": (put("counters", np.inf), "counters must be finite"),
    "more than the buffer": (
        lambda a: {**a, "seen": np.zeros((61, 205), "f4"), "wanted": np.zeros((61, 4), "f4")},
        "seen must be at most 60 rows",
    ),
    "seen without wanted": (other("wanted", lambda w: w[:-1]), "wanted must be of the shape"),
    "by_law": (other("by_law", lambda b: b.astype("f4")), "by_law must be of the type bool"),
    "observations": (other("rows/observations", lambda o: o[:, 1:]), "rows/observations must be of the shape"),
    "state gone": (lambda a: {n: v for n, v in a.items() if n != "rows/1/state/body"}, "state/body must be an array"),
    "state of others": (other("rows/0/state/pair", lambda p: p[:, :2]), "state/pair must be of the shape"),
    "plain state": (other("rows/0/state/body", lambda b: b["x"]), "state/body must be records with x"),
    "leader": (put("rows/0/state/episode", 10**9, "leader"), r"leader of the checkpoint must be in 0\.\.2"),
    "leader below": (put("rows/0/state/episode", -1, "leader"), r"leader of the checkpoint must be in 0\.\.2"),
    "way point": (put("rows/0/state/episode", -(2**40), "waypoint"), "waypoint of the checkpoint must be in"),
    "way points": (put("rows/0/world/n_waypoints", 10**6), "n_waypoints of the checkpoint must be in"),
    "vertices": (put("rows/1/world/piece", 10**9, "first"), "piece.first of the checkpoint must be in"),
    "vertices below": (put("rows/1/world/piece", -1, "count"), "piece.count of the checkpoint must be in"),
    "vertices past the end": (
        lambda a: put("rows/1/world/piece", 2, "count")(
            put("rows/1/world/piece", a["rows/1/world/vertex"].shape[1], "first")(a)
        ),
        r"piece.first \+ count of the checkpoint must be in",
    ),
    "vertex": (other("rows/1/world/vertex", lambda v: v[..., 0]), "world/vertex must be of the shape"),
    "generators": (other("rows/0/generators", lambda g: np.array(["{}"] * len(g))), "generators must be states"),
    "generators nested": (other("rows/0/generators", lambda g: np.array(["[" * 5000] * len(g))), "generators must be"),
    "generators gone": (lambda a: {n: v for n, v in a.items() if n != "rows/0/generators"}, "generators must be"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_arrays_of_no_training_are_refused(case, contents, target):
    change, message = HOSTILE[case]
    with pytest.raises(Damaged, match=message) as problem:
        restore(target, contents._replace(arrays=change(contents.arrays)), {}, "c.npz")
    assert str(problem.value).startswith("c.npz is damaged: ")
    assert str(problem.value).isprintable()


HEADERS = {
    "best": ({"best": [1]}, "best must be an object, got 'list'"),
    "worth": ({"best": {"worth": "much"}}, "best must be scores"),
    "score": ({"best": {"worth": 1, "success": {}}}, "best must be scores"),
    "recipe": ({"recipe": None}, "recipe must be an object"),
    "scenarios": ({"recipe": {"scenarios": [1]}}, "scenarios must be a list of objects"),
    "more": ({"code": "x"}, "got 'code'"),
}


@pytest.mark.parametrize("case", HEADERS)
def test_headers_of_no_training_are_refused(case, contents, target):
    changes, message = HEADERS[case]
    with pytest.raises(Damaged, match=message):
        restore(target, contents._replace(header=contents.header | changes), {}, "c.npz")


@pytest.mark.parametrize("network", [None, [], {}, {"kind": []}, "\x1b[2J"])
def test_another_recipe_is_another_training(network, contents, target):
    recipe = json.loads(json.dumps(contents.header["recipe"])) | {"network": network}
    with pytest.raises(SettingError, match=r"network.* must be the checkpoint's") as problem:
        restore(target, contents._replace(header=contents.header | {"recipe": recipe}), {}, "c.npz")
    assert str(problem.value).isprintable()


def test_a_rollout_of_others_is_refused():
    algorithm = team()
    archive = Archive({"recipe": algorithm.recipe(), "best": {}}, algorithm.pack())
    assert restore(team(), archive, {}, "c.npz") == {}
    arrays = archive.arrays | {"rows/length": archive.arrays["rows/length"][1:]}
    with pytest.raises(Damaged, match="rows/length must be of the shape"):
        restore(team(), archive._replace(arrays=arrays), {}, "c.npz")


@pytest.mark.parametrize("make", [dagger, team], ids=["dagger", "ppo"])
@pytest.mark.parametrize("group", ["settings", "network"])
def test_a_setting_that_came_later_was_at_its_default(make, group):
    """Checkpoints lack what did not exist yet: no other value goes on from them."""
    algorithm = make()
    mine, recipe = getattr(algorithm, group), algorithm.recipe()
    for field in dataclasses.fields(mine):
        stored = {**recipe, group: {name: value for name, value in recipe[group].items() if name != field.name}}
        if getattr(mine, field.name) == field.default:
            check_recipe(stored, recipe, **{group: mine})
        else:
            with pytest.raises(SettingError, match=rf"{group}\.{field.name}.* must be the checkpoint's"):
                check_recipe(stored, recipe, **{group: mine})
