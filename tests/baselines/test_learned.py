"""Learned policies as files and as a kernel: against plain numpy, over sets of any size, bit for bit, and bad files."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fovconn_env import Simulator, layout, scenario
from fovconn_env.baselines import Expert, find_policy, load_policy
from fovconn_env.baselines.laws.augmented import Augmented
from fovconn_env.baselines.learned import cards, inputs
from fovconn_env.baselines.learned.policy import Encoder, Head, Learned, from_file
from fovconn_env.training.evaluation.flights import label
from fovconn_env.training.evaluation.shelf import Cell, fingerprint
from tests.helpers import SETTLED, few, recorded_actions, small

pytestmark = pytest.mark.nojit

ROOT = Path(__file__).parents[2]
KINDS = {"set": {}, "mlp": {"network": "mlp"}, "residual": {"base": "augmented", "bound": 0.3}}


def arrays_of(network="set", base=None, seed=0, size=205, width=12, spots=6, hidden=(16, 10)):
    """Random weights of a small network."""
    rng, extra = np.random.default_rng(seed), inputs.ACTION if base else 0
    own = inputs.OWN + inputs.EMPHASIS + extra
    shapes = {"row": (inputs.ROW, width), "own": (own, width), "term": (width, width)}
    shapes |= {"point": (inputs.POINT, spots), "spot": (spots, spots)}
    shapes = shapes if network == "set" else {}
    features = own + width + spots if network == "set" else size + inputs.EMPHASIS + extra
    shapes |= {"first": (features, hidden[0]), "second": hidden, "action": (hidden[1], 4)}
    arrays = {name: rng.normal(size=shape) / np.sqrt(shape[0]) for name, shape in shapes.items()}
    arrays |= {f"{name}_bias": 0.1 * rng.normal(size=shape[1]) for name, shape in shapes.items() if name != "own"}
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def made(folder, name="mine", network="set", base=None, bound=0.0, **told):
    """A file of random weights."""
    file = folder / f"{name}.safetensors"
    arrays = arrays_of(network, base, **told)
    cards.write(file, arrays, network=network, base=base, bound=bound, observation_size=205)
    return file


@pytest.fixture(scope="module")
def seen():
    """Observations of four robots, some of which see and know nothing."""
    chosen = small(course=SETTLED)
    simulator, kept = Simulator(chosen, 3), []
    simulator.reset(4)
    for action in recorded_actions(few(30, 4), 4, n_worlds=3, size=0.4):
        kept.append(simulator.step(action).copy())
    flat = np.concatenate(kept).reshape(-1, chosen.observation_size)
    flat[::17] = 0.0
    return flat


# ---------------------------------------------------------------------------------------------------- reference
def silu(x):
    return x / (1.0 + np.exp(-x))


def slow_output(file, flat, base):
    """The network's outputs (R, 4) in float64, written with whole arrays."""
    card, arrays = cards.read(file, {"mlp": Head._fields, "set": Encoder._fields + Head._fields})
    a = {name: array.astype(float) for name, array in arrays.items()}
    x = flat.astype(float) / inputs.scales(8, 8)
    low = np.maximum(flat[:, inputs.LAMBDA2].astype(float), 0.0)
    spread = np.stack([0.5 * np.log(low + 0.05), 0.2 / (low + 0.1)], axis=1)
    if card.network == "mlp":
        features = np.concatenate([x, base, spread], axis=1)
    else:
        first = inputs.OWN + 8 * inputs.ROW
        own = np.concatenate([x[:, : inputs.OWN], spread, base], axis=1)
        rows, points = x[:, inputs.OWN : first].reshape(len(x), 8, -1), x[:, first:].reshape(len(x), 8, -1)
        terms = silu(rows @ a["row"] + (own @ a["own"] + a["row_bias"])[:, None])
        terms = silu(terms @ a["term"] + a["term_bias"]) * (rows[..., :1] > 0)
        spots = silu(silu(points @ a["point"] + a["point_bias"]) @ a["spot"] + a["spot_bias"]) * (points[..., :1] > 0)
        features = np.concatenate([own, 0.3 * terms.sum(axis=1), 0.3 * spots.sum(axis=1)], axis=1)
    hidden = silu(silu(features @ a["first"] + a["first_bias"]) @ a["second"] + a["second_bias"])
    return hidden @ a["action"] + a["action_bias"]


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_the_network(kind, seen, tmp_path):
    file = made(tmp_path, **KINDS[kind])
    chosen = small(course=SETTLED)
    got = from_file(file)(chosen).decide(seen)
    if kind == "residual":
        law, led = Augmented(chosen).decide(seen), seen[:, inputs.LEADER, None] > 0
        assert 0.2 < led.mean() < 0.3  # one of four
        correction = 0.3 * np.clip(slow_output(file, seen, law.astype(float)), -1.0, 1.0)
        expected = law + np.where(led, 0.0, correction)
    else:
        expected = slow_output(file, seen, np.zeros((len(seen), 0)))
    np.testing.assert_allclose(got, np.clip(expected, -1.0, 1.0), atol=1e-5)
    assert np.abs(got).max() <= 1.0
    assert got.std() > 0.05


# ----------------------------------------------------------------------------------------------------- property
def shuffled(flat, seed=0):
    """Flat observations with neighbour and range rows in another order."""
    rng, out = np.random.default_rng(seed), flat.copy()
    views = layout.rows(out, 8, 8)
    for r in range(len(flat)):
        views.neighbors[r] = views.neighbors[r][rng.permutation(8)]
        views.ranges[r] = views.ranges[r][rng.permutation(8)]
    return out


@pytest.mark.parametrize("kind", ["set", "residual"])
def test_rows_are_a_set(kind, seen, tmp_path):
    policy = from_file(made(tmp_path, **KINDS[kind]))(small())
    policy._base = None if policy._base is None else Still(small())  # the law breaks off at the first unused row
    np.testing.assert_allclose(policy.decide(shuffled(seen)), policy.decide(seen), atol=2e-6)


class Still(Expert):
    """A base law that does not look at rows."""

    def decide(self, flat):
        return np.zeros((len(flat), 4), np.float32)


def test_unused_rows_count_for_nothing(seen, tmp_path):
    policy, noisy = from_file(made(tmp_path))(small()), seen.copy()
    views = layout.rows(noisy, 8, 8)
    for rows in (views.neighbors, views.ranges):
        unused = rows["present"] == 0
        assert unused.any()
        for name in rows.dtype.names[1:]:
            rows[name][unused] = 3.0
    np.testing.assert_array_equal(policy.decide(noisy), policy.decide(seen))


def test_it_fits_any_team_and_any_number_of_rows(seen, tmp_path):
    kind = from_file(made(tmp_path))
    actions = kind(small()).decide(seen)
    for n in (2, 3, 12, 48):
        np.testing.assert_array_equal(kind(scenario(n_agents=n)).decide(seen), actions)
    fewer, views = scenario(max_neighbors=3, max_ranges=5), layout.rows(seen, 8, 8)
    assert (views.neighbors["present"][:, 3:] == 0).all()
    few_rows = np.concatenate([seen[:, : inputs.OWN + 3 * inputs.ROW], seen[:, inputs.OWN + 8 * inputs.ROW :]], axis=1)
    few_rows = np.ascontiguousarray(few_rows[:, : fewer.observation_size])
    np.testing.assert_array_equal(kind(fewer).decide(few_rows), actions)


def test_an_output_is_a_velocity_in_any_scenario(seen, tmp_path):
    """Another speed limit makes a share of an action another velocity; what is flown stays the same."""
    kind, base = from_file(made(tmp_path)), scenario()
    actions = kind(base).decide(seen)
    for changes in ({"stick_speed": 3.5}, {"speed_limit": 3.5, "yaw_rate_limit": 2.0}):
        other = scenario(**changes)
        flown = kind(other).decide(seen) * inputs.full_scale(other)
        inside = np.abs(actions) < 1.0
        np.testing.assert_allclose(flown[inside], (actions * inputs.full_scale(base))[inside], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("base", cards.BASES)
def test_a_correction_is_bounded_and_zero_is_the_law(base, seen, tmp_path):
    chosen, file = small(), made(tmp_path, base=base, bound=0.2)
    law = cards.BASES[base](chosen).decide(seen)
    far = from_file(file)(chosen).decide(seen)
    assert 0.05 < np.abs(far - law).max() <= 0.2 + 1e-6
    arrays = arrays_of("set", base)
    arrays["action"][:], arrays["action_bias"][:] = 0.0, 0.0
    cards.write(file, arrays, network="set", base=base, bound=0.2, observation_size=205)
    np.testing.assert_array_equal(from_file(file)(chosen).decide(seen), law)


def test_the_leader_is_never_corrected(seen, tmp_path):
    """It flies what the person at the stick and the law want; the same observation is corrected in a follower."""
    chosen, led = small(), seen.copy()
    for is_leader in (1.0, 0.0):
        led[:, inputs.LEADER] = is_leader
        law = cards.BASES["cohesive"](chosen).decide(led)
        moved = from_file(made(tmp_path, base="cohesive", bound=0.2))(chosen).decide(led) != law
        assert moved.any() == (is_leader == 0.0)


# -------------------------------------------------------------------------------------------------------- batch
@pytest.mark.parametrize("kind", KINDS)
def test_the_same_bits_alone_and_in_any_batch(kind, seen, tmp_path):
    policy = from_file(made(tmp_path, **KINDS[kind]))(small())
    actions = policy.decide(seen)
    order = np.random.default_rng(1).permutation(len(seen))
    np.testing.assert_array_equal(policy.decide(seen[order]), actions[order])
    for r in range(len(seen)):
        np.testing.assert_array_equal(policy.decide(seen[r : r + 1])[0], actions[r])


def test_the_same_bits_in_another_process(seen, tmp_path):
    file = made(tmp_path)
    np.save(tmp_path / "seen.npy", seen)
    program = (
        "import sys, numpy; from pathlib import Path; from fovconn_env.baselines.learned.policy import from_file;"
        "from tests.helpers import small; d = Path(sys.argv[1]);"
        "numpy.save(d / 'done.npy', from_file(d / 'mine.safetensors')(small()).decide(numpy.load(d / 'seen.npy')));"
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path)], cwd=ROOT, check=True)
    np.testing.assert_array_equal(np.load(tmp_path / "done.npy"), from_file(file)(small()).decide(seen))


# -------------------------------------------------------------------------------------------------------- files
def test_a_file_gives_back_what_was_written(tmp_path):
    file, arrays = made(tmp_path), arrays_of()
    card, found = cards.read(file, {"set": tuple(arrays)})
    assert found.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
    assert (card.network, card.base, card.format) == ("set", None, 1)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.json", "mine.safetensors"]


def test_a_path_is_a_policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = made(tmp_path)
    for name in ("mine.safetensors", str(file)):
        kind = find_policy(name)
        assert issubclass(kind, Learned)
        assert label(name) == kind.__name__ == "mine"
    assert load_policy("mine.safetensors", small()).card.network == "set"
    assert label("safe:mine.safetensors") == "lambda2-cbf-mine"
    assert label("lambda2-cbf:expert") == label("safe:expert") == "lambda2-cbf-expert"


def test_other_weights_are_another_policy_to_the_evaluation(tmp_path):
    """Episodes kept on disk are not taken for those of a policy that was trained anew."""
    file = made(tmp_path)
    cells = [Cell(name, small()) for name in (str(file), f"safe:{file}")]
    before = [fingerprint(cell) for cell in cells]
    assert [fingerprint(cell) for cell in cells] == before
    made(tmp_path, seed=1)
    assert not set(before) & {fingerprint(cell) for cell in cells}


def test_a_full_disk_leaves_what_was_there(tmp_path, monkeypatch):
    file = made(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        made(tmp_path, seed=1)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert from_file(file)(small()) is not None


# ---------------------------------------------------------------------------------------------------- bad input
def rewritten(file, **changes):
    """Change the card of a file."""
    card = json.loads(file.with_suffix(".json").read_text())
    file.with_suffix(".json").write_text(json.dumps({**card, **changes}))


def other_layout(file):
    columns = {name: list(names) for name, names in inputs.columns().items()}
    columns["self"] = [name for name in columns["self"] if name != "team_share"]
    rewritten(file, columns=columns)


def with_nan(file):
    arrays = arrays_of()
    arrays["term"][1, 2] = np.nan
    cards.write(file, arrays, network="set", observation_size=205)


def flipped(file):
    data = bytearray(file.read_bytes())
    data[-7] ^= 1
    file.write_bytes(bytes(data))


def garbage(file):
    data = b"no tensors"
    file.write_bytes(data)
    rewritten(file, sha256=cards.hashlib.sha256(data).hexdigest())


BROKEN = {
    "no card": (lambda f: f.with_suffix(".json").unlink(), r"card of .*mine.safetensors must be a file that exists"),
    "card of something else": (
        lambda f: f.with_suffix(".json").write_text('{"a": 1}'),
        "must be the card of a learned",
    ),
    "card that is no JSON": (
        lambda f: f.with_suffix(".json").write_text("{"),
        "is no card of a learned policy, or damaged",
    ),
    "no weights": (lambda f: f.unlink(), "mine.safetensors must be a file that exists"),
    "truncated": (lambda f: f.write_bytes(f.read_bytes()[:-100]), "sha256 of .* must be what its card says"),
    "one bit flipped": (flipped, "sha256 of .* must be what its card says .*truncated or changed since"),
    "no safetensors": (garbage, "must be a safetensors file, got 10 bytes"),
    "another layout": (other_layout, r"columns 'self' of .* differs in \['team_share'\]; train it anew"),
    "other scales": (lambda f: rewritten(f, inputs="0" * 16), "inputs of .* must be .* units, frames or scales"),
    "another format": (lambda f: rewritten(f, format=2), "format of .* must be 1, got 2"),
    "unknown base": (
        lambda f: rewritten(f, base="omni"),
        "base of .* must be null or one of expert, augmented, cohesive, got 'omni'",
    ),
    "unknown network": (lambda f: rewritten(f, network="gnn"), "network of .* must be set or mlp, got 'gnn'"),
    "arrays of another": (lambda f: rewritten(f, network="mlp"), "arrays of .* must be those of a 'mlp' network"),
    "nan": (with_nan, "term of .* must be finite float32 numbers"),
    "a base without its inputs": (lambda f: rewritten(f, base="expert"), "own of .* must be of the shape"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_bad_file_is_one_clear_line(what, tmp_path):
    file = made(tmp_path)
    damage, message = BROKEN[what]
    damage(file)
    with pytest.raises(ValueError, match=message) as problem:
        from_file(file)(small())
    assert "\n" not in str(problem.value)


def test_a_plain_network_fits_one_observation(tmp_path):
    kind = from_file(made(tmp_path, network="mlp"))
    with pytest.raises(
        ValueError, match=r"as many inputs as the scenario has columns \(125\), got 205.*a set network any"
    ):
        kind(scenario(max_neighbors=4))


def test_a_file_that_is_not_there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=r"must name a file that exists, got 'mine\.safetensors'"):
        find_policy("mine.safetensors")
    with pytest.raises(ValueError, match="did you mean 'expert'"):
        find_policy("safe:expertt")
    with pytest.raises(ValueError, match="nor a filter of this name: did you mean 'lambda2-cbf'"):
        find_policy("lambda2cbf:expert")


def test_scales_do_not_follow_the_scenario():
    """A network trained with one team size means the same with another."""
    _, high = layout.bounds(layout.SELF, scenario().scales())
    scales = inputs.scales(8, 8)
    assert len(scales) == scenario().observation_size
    assert (scales > 0).all()
    assert (scales[: inputs.OWN] <= high + 1e-6).all()
    np.testing.assert_array_equal(inputs.gain(scenario()), 1.0)
