"""Files of strangers: cards and weights that are wrong in any way are refused by name, or fly finite actions."""

import copy
import hashlib
import json
import struct

import numpy as np
import pytest

from fovconn_env.baselines.learned import cards
from fovconn_env.baselines.learned.policy import from_file
from fovconn_env.errors import FovconnError
from tests.baselines.test_learned import made, rewritten
from tests.fuzzing import count
from tests.helpers import small

SCENARIO = small()
SEEN = np.random.default_rng(0).uniform(-1.0, 1.0, (4, SCENARIO.observation_size)).astype(np.float32)


def fly(file):
    return from_file(file)(SCENARIO).decide(SEEN)


def resigned(file, data):
    """Other weights, and their hash on the card, so that what is behind the hash is tried."""
    file.write_bytes(data)
    rewritten(file, sha256=hashlib.sha256(data).hexdigest())


def with_arrays(file, change):
    """Weights with some arrays changed."""
    arrays = {name: array.copy() for name, array in cards.safetensors.numpy.load(file.read_bytes()).items()}
    change(arrays)
    resigned(file, cards.safetensors.numpy.save(arrays))


def with_header(file, change):
    """Weights with another header in front of the same numbers."""
    data = file.read_bytes()
    (size,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + size])
    text = change(header)
    text = json.dumps(header).encode() if text is None else text
    resigned(file, struct.pack("<Q", len(text)) + text + data[8 + size :])


def put(name, value):
    return lambda arrays: arrays.update({name: np.asarray(value)})


def filled(value):
    return lambda arrays: arrays["term"].fill(value)


CARDS = {
    "base list": ({"base": [1]}, r"base of .*mine\.json must be null or one of .*, got \[1\]"),
    "columns null": ({"columns": None}, r"columns of .*mine\.json must be lists of names by table, got None"),
    "columns list": ({"columns": []}, "columns of .* must be lists of names by table"),
    "columns without a table": ({"columns": {}}, "columns of .* must be of the tables self, neighbor"),
    "columns of numbers": ({"columns": {"self": 7, "neighbor": [], "range": [], "action": []}}, "columns 'self' of"),
    "columns mixed": ({"columns": {"self": [7], "neighbor": [], "range": [], "action": []}}, "columns 'self' of"),
    "bound NaN": ({"bound": float("nan")}, r"bound of .* must be a number in \[0, 1000\], got nan"),
    "bound infinite": ({"bound": float("inf")}, "bound of .* must be a number"),
    "bound huge": ({"bound": 10**400}, "bound of .* must be a number"),
    "bound negative": ({"bound": -1}, "bound of .* must be a number"),
    "bound words": ({"bound": "0.3"}, "bound of .* must be a number"),
    "bound true": ({"bound": True}, "bound of .* must be a number"),
    "format true": ({"format": True}, "format of .* must be 1, got True"),
    "format float": ({"format": 1.0}, "format of .* must be 1, got 1.0"),
    "network list": ({"network": ["set"]}, "network of .* must be set or mlp"),
    "size float": ({"observation_size": 205.0}, "observation_size of .* must be a whole number"),
    "size negative": ({"observation_size": -1}, "observation_size of .* must be a whole number"),
    "size huge": ({"observation_size": 10**30}, "observation_size of .* must be a whole number"),
    "hash null": ({"sha256": None}, "sha256 of .* must be a hash, 64 letters"),
    "hash short": ({"sha256": "\x1b[31m"}, r"sha256 of .* got '\\x1b\[31m'"),
    "inputs null": ({"inputs": None}, "inputs of .* must be a fingerprint"),
    "made list": ({"made": []}, "made of .* must be an object"),
    "scores words": ({"scores": "good"}, "scores of .* must be an object"),
    "unknown key": ({"[red]x\n": 1}, r"must be the card of a learned policy, got missing \[\], unknown \['\[red\]x"),
}
TEXTS = {
    "brackets": "[" * 100_000,
    "deep": '{"made": ' + "[" * 900 + "]" * 900 + "}",
    "long": " " * (2 << 20),
    "list": "[1]",
    "null": "null",
    "half a pair": '{"made": "\\ud800"}',
    "digits": '{"bound": ' + "9" * 5000 + "}",
}
WEIGHTS = {
    "NaN": (lambda f: with_arrays(f, filled(np.nan)), "term of .* must be finite float32 numbers"),
    "infinite": (lambda f: with_arrays(f, filled(np.inf)), "term of .* must be finite float32 numbers"),
    "huge numbers": (lambda f: with_arrays(f, filled(3e38)), "term of .* must be numbers of at most 1000"),
    "float64": (lambda f: with_arrays(f, put("term", np.zeros((12, 12)))), "term of .* must be finite float32"),
    "other shape": (lambda f: with_arrays(f, put("term", np.zeros((12, 3), "f4"))), "term of .* of the shape"),
    "bias of two axes": (lambda f: with_arrays(f, put("row_bias", np.zeros((1, 12), "f4"))), "row_bias of .* a row"),
    "no axes": (lambda f: with_arrays(f, put("first_bias", np.float32(1))), "first_bias of .* a row"),
    "empty": (lambda f: with_arrays(f, put("point_bias", np.zeros(0, "f4"))), "point_bias of .* a row of 1 to 4096"),
    "wide": (lambda f: with_arrays(f, put("row_bias", np.zeros(5000, "f4"))), "row_bias of .* a row of 1 to 4096"),
    "huge header": (lambda f: resigned(f, struct.pack("<Q", 2**62) + b"{}"), "must be a safetensors file"),
    "huge shape": (
        lambda f: with_header(f, lambda h: h["term"].update(shape=[2**40, 2**40])),
        "must be a safetensors file",
    ),
    "brackets": (lambda f: with_header(f, lambda h: b"[" * 100_000), "must be a safetensors file"),
}


@pytest.mark.parametrize("what", CARDS)
def test_a_wrong_value_on_a_card_is_named(what, tmp_path):
    file, (changes, message) = made(tmp_path, base="augmented", bound=0.3), CARDS[what]
    rewritten(file, **changes)
    with pytest.raises(FovconnError, match=message):
        fly(file)


@pytest.mark.parametrize("what", TEXTS)
def test_what_is_no_card_is_named(what, tmp_path):
    file = made(tmp_path)
    file.with_suffix(".json").write_text(TEXTS[what])
    with pytest.raises(FovconnError, match=r"mine\.json (is no|must be the) card of a learned policy"):
        fly(file)


@pytest.mark.parametrize("what", WEIGHTS)
def test_wrong_weights_are_named(what, tmp_path):
    file, (damage, message) = made(tmp_path), WEIGHTS[what]
    damage(file)
    with pytest.raises(FovconnError, match=message):
        fly(file)


def test_scores_may_be_nan(tmp_path):
    file = made(tmp_path)
    rewritten(file, scores={"progress": float("nan")})
    assert np.isfinite(fly(file)).all()


def test_the_largest_weights_fly_finite_actions(tmp_path):
    file = made(tmp_path, base="augmented", bound=1000.0)
    with_arrays(file, lambda arrays: [array.__imul__(0).__iadd__(cards.MAX_WEIGHT) for array in arrays.values()])
    assert np.isfinite(fly(file)).all()


# ----------------------------------------------------------------------------------------------------------- fuzz
JUNK = [
    None,
    True,
    0,
    -1,
    1,
    2**70,
    0.5,
    -0.0,
    1e308,
    float("nan"),
    float("inf"),
    "",
    "set",
    "mlp",
    "expert",
    "\x1b[2J",
]
JUNK += ["\ud800", "x" * 10_000, [], {}, [1], [None], {"self": None}, {"": []}, [[[]]], ["expert"], {"a": {"b": [{}]}}]
NUMBERS = [np.nan, np.inf, -np.inf, 3e38, -3e38, 1e4, 999.0, 1e-45, 0.0]


def wrong_card(file, rng):
    """One to three values of the card replaced, removed or added, also inside its tables; or its text damaged."""
    place = file.with_suffix(".json")
    card = json.loads(place.read_text())
    for _ in range(rng.integers(1, 4)):
        part = card["columns"] if rng.random() < 0.2 and isinstance(card.get("columns"), dict) else card
        key, value = rng.choice([*part, "new"]) if part else "new", copy.deepcopy(JUNK[rng.integers(len(JUNK))])
        if rng.random() < 0.2:
            part.pop(str(key), None)
        elif isinstance(part.get(key), list) and part[key] and rng.random() < 0.5:
            part[key][rng.integers(len(part[key]))] = value
        else:
            part[str(key)] = value
    place.write_text(json.dumps(card))


def wrong_text(file, rng):
    place = file.with_suffix(".json")
    place.write_bytes(spoiled(place.read_bytes(), rng))


def wrong_header(file, rng):
    """One value of the safetensors header replaced."""

    def change(header):
        entry = header[rng.choice(list(header))]
        key = rng.choice(["dtype", "shape", "data_offsets", "new"])
        values = [*JUNK, "F32", "F64", "BF16", "I8", [2**63, 2**63], [0], [-1], [0, 2**64], [4, 0], [1] * 200]
        entry[key] = values[rng.integers(len(values))]

    with_header(file, change)


def wrong_bytes(file, rng):
    resigned(file, spoiled(file.read_bytes(), rng))


def wrong_numbers(file, rng):
    """Numbers that cannot be flown with, and arrays of other shapes and types."""

    def change(arrays):
        name = rng.choice(list(arrays))
        shape, kind = tuple(rng.integers(0, 20, rng.integers(0, 4))), rng.choice(["f4", "f8", "f2", "i4", "?"])
        if rng.random() < 0.5:
            arrays[name].flat[rng.integers(arrays[name].size)] = NUMBERS[rng.integers(len(NUMBERS))]
        else:
            arrays[name] = np.ones(shape, kind)

    with_arrays(file, change)


def spoiled(data, rng):
    """Bytes flipped, cut off, repeated, or with brackets in the middle."""
    at, way = int(rng.integers(len(data))), rng.integers(4)
    if way == 0:
        return data[:at] + bytes([data[at] ^ (1 << rng.integers(8))]) + data[at + 1 :]
    if way == 1:
        return data[:at]
    return data[:at] + (data[at : at + 40] * 3 if way == 2 else b"[{" * int(rng.integers(1, 3000))) + data[at:]


MUTATIONS = [wrong_card, wrong_card, wrong_card, wrong_text, wrong_header, wrong_bytes, wrong_numbers]


@pytest.mark.fuzz
def test_no_file_of_a_stranger_breaks_anything(tmp_path):
    """Each is refused in one line that names the file, or flies finite actions; both happen."""
    flown = refused = 0
    files = [made(tmp_path, "set"), made(tmp_path, "both", base="cohesive", bound=0.3), made(tmp_path, "mlp", "mlp")]
    kept = {path: path.read_bytes() for file in files for path in (file, file.with_suffix(".json"))}
    for k in range(count(250, 10_000)):
        rng, file = np.random.default_rng(k), files[k % len(files)]
        for path, data in kept.items():
            if path.stem == file.stem:
                path.write_bytes(data)
        mutate = MUTATIONS[k % len(MUTATIONS)]
        mutate(file, rng)
        try:
            actions = fly(file)
        except FovconnError as problem:
            refused, message = refused + 1, str(problem)
            if not (str(tmp_path) in message and message.isprintable() and len(message) < 2000):
                pytest.fail(f"{mutate.__name__}, seed {k}: {message[:3000]!r}")
        else:
            flown += 1
            assert np.isfinite(actions).all(), (k, mutate.__name__)
    assert refused > flown > 0
