"""Seeds: s + b for an integer of any type, up to a stated bound, and nothing else."""

import array
import ctypes

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fovconn_env import Simulator, scenario
from fovconn_env.sim.seeds import MAX_SEED, world_seeds
from tests.fuzzing import count
from tests.helpers import digest

SHORT = {"warmup": 0.1, "n_agents": 2}
INTEGERS = [np.dtype(code).type for code in np.typecodes["AllInteger"]]


class Index:
    """A whole number of another library."""

    def __init__(self, value):
        self.value = value

    def __index__(self):
        return self.value


@pytest.mark.parametrize("kind", [int, Index, np.array, *INTEGERS])
def test_a_batch_counts_on_beyond_the_end_of_a_type(kind):
    last = 300 if kind in (int, Index, np.array) else np.iinfo(kind).max
    first = min(int(last), MAX_SEED - 5) - 1
    assert world_seeds(kind(first), 6) == list(range(first, first + 6))
    assert {type(seed) for seed in world_seeds(kind(first), 6)} == {int}


@pytest.mark.parametrize("seed", [np.uint8(254), np.int32(2**31 - 2), np.int8(126), np.uint64(2**32)])
def test_a_world_of_a_batch_is_the_single_one(seed):
    batch = Simulator(scenario(**SHORT), 6)
    batch.reset(seed)
    assert batch.seeds == [int(seed) + b for b in range(6)]
    alone = Simulator(scenario(**SHORT))
    for b in (1, 2, 5):
        alone.reset(int(seed) + b)
        np.testing.assert_array_equal(alone.observations[0], batch.observations[b])
    assert len(np.unique(batch.poses()[:, 0, 0])) == 6


SEVERAL = [list, tuple, np.array, lambda seeds: np.array(seeds, np.uint8), lambda seeds: array.array("B", seeds)]


@pytest.mark.parametrize("kind", SEVERAL)
def test_a_seed_for_each_world(kind):
    assert world_seeds(kind([7, 3, 250]), 3) == [7, 3, 250]
    assert world_seeds(range(4, 7), 3) == [4, 5, 6]


def test_a_world_without_a_seed_goes_on_with_its_generator():
    """As in Gymnasium's own batch."""
    one, other = Simulator(scenario(**SHORT), 3), Simulator(scenario(**SHORT), 3)
    for simulator in (one, other):
        simulator.reset(5)
    one.reset([5, None, 9])
    other.reset(mask=np.array([False, True, False]))
    np.testing.assert_array_equal(one.observations[1], other.observations[1])
    assert one.seeds == [5, None, 9]
    assert one.observations[2].tobytes() != other.observations[2].tobytes()


def test_the_greatest_seed_is_the_last_worlds():
    assert world_seeds(MAX_SEED, 1) == [MAX_SEED]
    assert world_seeds(MAX_SEED - 2, 3)[-1] == MAX_SEED == 2**63 - 1
    for seed, n_worlds in ((MAX_SEED, 2), (2**63, 1), ([0, 2**63], 2), (10**400, 3), (np.uint64(2**64 - 1), 1)):
        with pytest.raises(ValueError, match=r"seed must be at most 2\*\*63 - 1"):
            world_seeds(seed, n_worlds)


WRONG = [True, np.True_, [True, 2, 3], 1.0, np.float64(3), np.array([1.0, 2.0, 3.0]), "7", b"abc", "abc", {1, 2, 3}, {}]
WRONG += [..., np.array("7"), -1, np.int8(-1), [1, 2], [1, -2, 3], [], np.zeros((3, 1), int), ctypes.c_int(3), 2j]


@pytest.mark.parametrize("seed", WRONG, ids=repr)
def test_anything_else_is_refused_and_changes_nothing(seed):
    simulator = Simulator(scenario(**SHORT), 3)
    simulator.reset(0)
    before = digest(simulator)
    with pytest.raises(ValueError, match="seed must be a whole number, at least 0, or 3 of them, got "):
        simulator.reset(seed)
    assert digest(simulator) == before


@pytest.mark.fuzz
@settings(max_examples=count(100, 10_000), deadline=None, derandomize=True)
@given(st.integers(0, MAX_SEED), st.sampled_from([int, Index, *INTEGERS]), st.integers(1, 70))
def test_any_integer_of_any_type(value, kind, n_worlds):
    top = MAX_SEED if kind in (int, Index) else min(int(np.iinfo(kind).max), MAX_SEED)
    value = min(value % (top + 1), MAX_SEED - n_worlds + 1)
    assert world_seeds(kind(value), n_worlds) == [value + b for b in range(n_worlds)]
