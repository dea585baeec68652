"""A world alone, in a batch, on any number of threads, in another process, copied: the same bits in every field."""

import copy
import multiprocessing
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fovconn_env.kernel import step
from fovconn_env.scenarios.presets import PRESETS, scenario
from fovconn_env.scenarios.settings import Airframe, Camera, Course, Fault, Noise, Radio
from fovconn_env.sim import simulator as simulator_module
from fovconn_env.sim.simulator import Simulator
from tests.helpers import differing, digest, recorded_actions, snapshot

STEPS, WORLDS = 60, 6
ROUGH = {
    "noise": Noise(position_noise=0.05, velocity_noise=0.05, gyro_bias=0.02, attitude_noise=0.02, range_noise=0.05),
    "camera": Camera(occlusion=True, miss=0.1, coast=0.05),
    "radio": Radio(loss=0.1),
    "airframe": Airframe(rotor_noise=0.02, force_noise=0.3),
    "dynamics": "quadrotor",
    "floor": -3.0,
    "ceiling": 3.5,
    "faults": tuple(Fault(kind=kind, at=(0.2, 2.0), lasts=0.5) for kind in ("camera", "radio", "robot")),
}
CASES = {**{name: (name, {}) for name in PRESETS}, "rough": ("LeaderObstacles-v0", ROUGH)}
CASES["flooding"] = "LeaderFollow-v0", {"lambda2": "flooding", "radio": Radio(loss=0.1, delay=3)}


def build(case, n_worlds=1, **more):
    name, changes = CASES[case]
    course = Course(settle=0.3)  # the operator, too, moves within the first steps
    return Simulator(scenario(name, warmup=0.5, patience=2.0, course=course, **changes), n_worlds, **more)


def actions_for(case, n_steps=STEPS):
    name, changes = CASES[case]
    return recorded_actions(n_steps, scenario(name, **changes).n_agents, n_worlds=WORLDS)


@pytest.fixture
def tiny_slices(monkeypatch):
    """Threads even for a few worlds."""
    monkeypatch.setattr(simulator_module, "WORLDS_PER_SLICE", 1)


@pytest.mark.parametrize("case", CASES)
def test_alone_and_in_a_batch(case):
    actions = actions_for(case)
    batch = build(case, WORLDS)
    batch.reset(10)
    alone = [build(case) for _ in range(WORLDS)]
    for b, single in enumerate(alone):
        single.reset(10 + b)
        assert differing(snapshot(single, 0), snapshot(batch, b)) == []
    for t in range(STEPS):
        batch.step(actions[t])
        for b, single in enumerate(alone):
            single.step(actions[t, b : b + 1])
            assert differing(snapshot(single, 0), snapshot(batch, b)) == [], f"world {b} after step {t + 1}"
            np.testing.assert_array_equal(single.privileged()[0], batch.privileged()[b])
    assert len({snapshot(batch, b)["flat."] for b in range(WORLDS)}) == WORLDS


@pytest.mark.parametrize("case", CASES)
def test_any_number_of_threads(case, tiny_slices):
    actions, found = actions_for(case), set()
    for n_threads in (1, 2, 3, WORLDS):
        batch = build(case, WORLDS, n_threads=n_threads)
        assert batch.n_threads == n_threads
        batch.reset(20)
        for action in actions:
            batch.step(action)
        found.add(digest(batch))
    assert len(found) == 1


@pytest.mark.parametrize("case", CASES)
def test_a_masked_reset_leaves_the_others_alone(case, tiny_slices):
    """Worlds 1 and 4 begin again half-way: they are as new, the others never notice."""
    actions, mask = actions_for(case), np.isin(np.arange(WORLDS), (1, 4))
    plain, masked, fresh = build(case, WORLDS), build(case, WORLDS, n_threads=2), build(case, WORLDS)
    plain.reset(30)
    masked.reset(30)
    for t in range(STEPS):
        if t == STEPS // 2:
            before = [snapshot(masked, b) for b in range(WORLDS)]
            masked.reset(90, mask=mask)
            fresh.reset(90)
            for b in np.flatnonzero(~mask):
                assert differing(snapshot(masked, b), before[b]) == []
        plain.step(actions[t])
        masked.step(actions[t])
        if t >= STEPS // 2:
            fresh.step(actions[t])
            for b in range(WORLDS):
                other = fresh if mask[b] else plain
                assert differing(snapshot(masked, b), snapshot(other, b)) == [], f"world {b} after step {t + 1}"


def test_a_reset_forgets_the_past():
    """After any number of steps and episodes, a seeded reset gives what a new simulator gives."""
    old, new = build("rough", 2), build("rough", 2)
    for seed in (1, 2):
        old.reset(seed)
        for action in recorded_actions(STEPS, 6, n_worlds=2, seed=seed, size=1.0):
            old.step(action)
    old.reset(7)
    new.reset(7)
    for b in (0, 1):
        assert differing(snapshot(old, b), snapshot(new, b)) == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")  # Python 3.12 and newer
def test_a_forked_child_goes_on_with_threads_of_its_own(tiny_slices):
    """As in SubprocVecEnv: after the parent has stepped on two threads, both go on, with the same bits."""
    batch = Simulator(scenario("LeaderFollow-v0"), WORLDS, n_threads=2)
    batch.reset(3)
    actions = recorded_actions(8, 6, n_worlds=WORLDS)
    for action in actions[:4]:
        batch.step(action)
    assert batch.n_threads == 2

    def go_on(pipe):
        for action in actions[4:]:
            batch.step(action)
        pipe.send(digest(batch))

    here, there = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=go_on, args=(there,))
    child.start()
    try:
        assert here.poll(600), "the child hangs"
        answer = here.recv()
        child.join(600)
        assert child.exitcode == 0
    finally:
        child.kill()
    go_on(there)
    assert here.recv() == answer


def test_worlds_that_are_over_stand_still():
    batch = build("LeaderFollow-v0", 3)
    batch.reset(0)
    batch.max_cycles = 5
    batch.reset(0, mask=np.array([False, True, False]))
    actions = recorded_actions(10, 6, n_worlds=3)
    for t in range(10):
        if t == 5:
            end = snapshot(batch, 1)
            assert batch.over.tolist() == [False, True, False]
        batch.step(actions[t])
    assert differing(snapshot(batch, 1), end) == []
    assert batch.state.episode["step"].tolist() == [10, 5, 10]


def moved_by_a_byte(array):
    """A copy of an array that begins at an odd address."""
    memory = bytearray(array.nbytes + 1)
    copy = np.frombuffer(memory, array.dtype, array.size, offset=1).reshape(array.shape)
    copy[...] = array
    return copy


FORMS = {
    "single": lambda actions: actions.astype(np.float32),
    "big-endian": lambda actions: actions.astype(">f8"),
    "fortran": np.asfortranarray,
    "strided": lambda actions: np.repeat(actions, 2, axis=-1)[..., ::2],
    "repeated": lambda actions: np.broadcast_to(actions[0], actions.shape),
    "read-only": lambda actions: np.frombuffer(actions.tobytes()).reshape(actions.shape),
    "unaligned": moved_by_a_byte,
    "matrix": lambda actions: np.ma.masked_array(actions),
}


@pytest.mark.parametrize("form", FORMS)
def test_actions_and_masks_lie_in_memory_as_they_like(form):
    simulator, twin = build("LeaderFollow-v0", WORLDS), build("LeaderFollow-v0", WORLDS)
    steps, mask = actions_for("LeaderFollow-v0")[:12], np.array([True, False, False, True] * WORLDS)[::4]
    for one in (simulator, twin):
        one.reset(5)
        one.step(steps[0])
    compiled = len(step.run.signatures)
    simulator.reset(7, mask=mask)
    twin.reset(7, mask=mask.copy())
    for actions in map(FORMS[form], steps):
        simulator.step(actions)
        twin.step(np.array(actions, np.float64, order="C"))
    assert all(differing(snapshot(simulator, b), snapshot(twin, b)) == [] for b in range(WORLDS))
    assert len(step.run.signatures) == compiled, "nothing is compiled for another kind of array"


def test_seeds():
    a, b = build("LeaderFollow-v0"), build("LeaderFollow-v0")
    a.reset(5)
    b.reset(5)
    first = digest(a)
    assert digest(b) == first
    a.reset(6)
    assert digest(a) != first
    a.reset([5])
    assert digest(a) == first
    a.reset()
    second = digest(a)
    a.reset()
    assert len({first, second, digest(a)}) == 3
    b.reset()
    assert digest(b) == second  # unseeded, the generator goes on from the seed


def test_unseeded_resets_of_given_poses_differ_in_their_noise():
    """Noise comes from an episode key, so that the same start is flown differently."""
    sim = build("rough")
    sim.reset(5)
    poses, keys = sim.poses()[0], set()
    for _ in range(3):
        sim.reset(poses=poses)
        np.testing.assert_array_equal(sim.poses()[0], poses)
        keys.add(int(sim.state.episode["key"][0]))
    assert len(keys) == 3


def test_a_failed_reset_changes_nothing():
    sim = build("LeaderFollow-v0", 2)
    sim.reset(5)
    sim.step(recorded_actions(1, 6, n_worlds=2)[0])
    before, twin = digest(sim), copy.deepcopy(sim)
    for bad in (
        {"seed": -1},
        {"seed": [1, 2, 3]},
        {"poses": np.zeros((6, 4))},
        {"poses": np.zeros((5, 4))},
        {"poses": np.full((6, 4), np.nan)},
        {"mask": np.ones(3, bool)},
    ):
        with pytest.raises(ValueError, match="must"):
            sim.reset(**bad)
        assert digest(sim) == before
    for bad_actions in (np.zeros((2, 6, 3)), np.zeros((6, 4)), np.full((2, 6, 4), np.nan), np.full((2, 6, 4), np.inf)):
        with pytest.raises(ValueError, match=r"must be finite|must have the shape"):
            sim.step(bad_actions)
        assert digest(sim) == before
    sim.reset()
    twin.reset()
    assert digest(sim) == digest(twin)


@pytest.mark.parametrize(
    "clone", [copy.deepcopy, lambda sim: pickle.loads(pickle.dumps(sim))], ids=["deepcopy", "pickle"]
)
@pytest.mark.parametrize("case", CASES)
def test_copies_go_on_identically(case, clone, tiny_slices):
    sim, actions = build(case, WORLDS, n_threads=2), actions_for(case, 30)
    sim.reset(40)
    for action in actions[:10]:
        sim.step(action)
    twin, compiled = clone(sim), len(step.run.signatures)
    assert digest(twin) == digest(sim)
    before = digest(sim)
    twin.step(actions[0])
    assert digest(sim) == before  # nothing is shared
    twin = clone(sim)
    for action in actions[10:]:
        sim.step(action)
        twin.step(action)
        assert digest(twin) == digest(sim)
    sim.reset()
    twin.reset()
    assert digest(twin) == digest(sim)
    assert len(step.run.signatures) == compiled  # a copy's arrays are of the same type: nothing compiles again


def test_copies_of_a_new_simulator_draw_their_own_worlds():
    """World by world: one that was reset goes on with its generator."""
    sim = build("LeaderFollow-v0", 3)
    sim.reset(8, mask=np.array([False, True, False]))
    twin = copy.deepcopy(sim)
    for one in (sim, twin):
        one.reset()
    assert [snapshot(sim, b)["body.x"] == snapshot(twin, b)["body.x"] for b in range(3)] == [False, True, False]
    assert len({snapshot(one, b)["body.x"] for one in (sim, twin) for b in range(3)}) == 5


def test_a_copy_of_a_simulator_keeps_its_views():
    sim = copy.deepcopy(build("LeaderFollow-v0"))
    sim.reset(1)
    sim.state.own_row["vx"][0, 2] = 1.25
    assert (sim.observations[0, 2] == 1.25).any()


PROGRAM = """
from tests.helpers import digest, recorded_actions
from tests.sim.test_batch import WORLDS, build
import sys
sim = build(sys.argv[1], WORLDS, n_threads=int(sys.argv[2]))
sim.reset(50)
for action in recorded_actions(20, 6, n_worlds=WORLDS):
    sim.step(action)
print(digest(sim))
"""


def test_another_process():
    case = "rough"
    here = build(case, WORLDS)
    here.reset(50)
    for action in recorded_actions(20, 6, n_worlds=WORLDS):
        here.step(action)
    command = [sys.executable, "-c", PROGRAM, case, "2"]
    there = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=True)
    assert there.stdout.strip() == digest(here)
