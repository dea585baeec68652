"""Files of learned policies: NAME.safetensors, the weights, and NAME.json, the card that tells what they are.

safetensors is plain numbers behind a JSON header: to read one runs no code of the file.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

from fovconn_env.baselines.laws.augmented import Augmented
from fovconn_env.baselines.laws.cohesive import Cohesive
from fovconn_env.baselines.laws.expert import Expert
from fovconn_env.baselines.learned import inputs
from fovconn_env.baselines.learned.trail import TRAIL
from fovconn_env.baselines.policy import Policy
from fovconn_env.errors import SettingError
from fovconn_env.files import one_line, printable, read_file, read_json, write_files

SUFFIX = ".safetensors"
FOLDER = Path(__file__).parent / "weights"  # those of this repository
FORMAT = 1
# laws that a network may correct, or imitate: without memory
BASES: dict[str, type[Policy]] = {"expert": Expert, "augmented": Augmented, "cohesive": Cohesive}


MAX_CARD = 1 << 20  # bytes; one has some 5000, of many tasks 250,000
MAX_WEIGHTS = 64 << 20  # bytes; those of this repository have 300,000 at most
MAX_WIDTH = 4096  # numbers of a layer
# With these the network's sums stay below 1e37 for scaled observations up to 1000: no NaN comes of finite weights.
MAX_WEIGHT = 1000.0
MAX_BOUND = 1000.0  # a correction of 10 fills the whole action


@dataclass(frozen=True, kw_only=True)
class Card:
    """What a file of weights is and how it was made."""

    format: int = FORMAT
    network: str  # "set" or "mlp"
    base: str | None = None  # law that the network corrects; None: it acts alone
    bound: float = 0.0  # of a correction, in units of `inputs.gain`
    memory: bool = False  # whether it reads what `trail` remembers
    observation_size: int  # at training; a set network fits any
    columns: Mapping[str, Sequence[str]]  # names of what the numbers are, by table
    inputs: str  # `inputs.fingerprint` of the code that trained
    sha256: str  # of the file of weights
    made: Mapping[str, Any] = field(default_factory=dict)  # algorithm, command, scenarios, seed, steps, time, versions
    scores: Mapping[str, Any] = field(default_factory=dict)  # on the seeds that chose the checkpoint

    @property
    def extra(self) -> int:
        """Columns of the own row behind those of the observation."""
        return inputs.ACTION if self.base else TRAIL if self.memory else 0


FIELDS = dataclasses.fields(Card)
REQUIRED = {part.name for part in FIELDS if part.default is part.default_factory is dataclasses.MISSING}
RULES: dict[str, tuple[Callable[[Any], bool], str, str]] = {  # what each value must be, whatever the others are
    "format": (lambda x: type(x) is int and x == FORMAT, f"{FORMAT}", "written by another version"),
    "network": (lambda x: x in ("set", "mlp"), "set or mlp", "written by hand?"),
    "base": (
        lambda x: x is None or (isinstance(x, str) and x in BASES),
        f"null or one of {', '.join(BASES)}",
        "written by hand?",
    ),
    "bound": (
        lambda x: isinstance(x, (int, float)) and not isinstance(x, bool) and 0 <= x <= MAX_BOUND,
        f"a number in [0, {MAX_BOUND:g}]",
        "did the training diverge?",
    ),
    "memory": (lambda x: isinstance(x, bool), "true or false", "written by hand?"),
    "observation_size": (
        lambda x: type(x) is int and 1 <= x <= MAX_WEIGHTS,
        "a whole number, at least 1",
        "it counts columns",
    ),
    "columns": (lambda x: isinstance(x, dict), "lists of names by table", "written by hand?"),
    "inputs": (lambda x: isinstance(x, str), "a fingerprint, 16 letters", "written by hand?"),
    "sha256": (
        lambda x: isinstance(x, str) and re.fullmatch("[0-9a-f]{64}", x) is not None,
        "a hash, 64 letters",
        "written by hand?",
    ),
    "made": (lambda x: isinstance(x, dict), "an object", "it tells how the policy was made"),
    "scores": (lambda x: isinstance(x, dict), "an object", "it tells how the policy flew"),
}


def write(file: Path, arrays: Mapping[str, np.ndarray], **details: Any) -> Card:
    """Write weights and card, both or, after an `OSError`, none."""
    data = safetensors.numpy.save({name: np.ascontiguousarray(array, np.float32) for name, array in arrays.items()})
    columns, meaning = inputs.columns(), inputs.fingerprint()
    card = Card(columns=columns, inputs=meaning, sha256=hashlib.sha256(data).hexdigest(), **details)
    text = json.dumps(dataclasses.asdict(card), indent=1) + "\n"
    write_files({file: data, file.with_suffix(".json"): text.encode()})
    return card


def read(file: Path, names: Mapping[str, Sequence[str]]) -> tuple[Card, dict[str, np.ndarray]]:
    """Card and weights (float32) of a file; `names` are the arrays of each kind of network.

    Raises `SettingError` for a file that is missing or made for other observations, naming file, field and rule, and
    `Damaged` or `OtherKind` for what is no such file. No more than `MAX_WEIGHTS` bytes are read, whatever is declared.
    """
    card = read_card(file)
    _rule(file.is_file(), f"{file}", "a file that exists", str(file), "a card alone does not fly")
    data = read_file(file, "file of weights", MAX_WEIGHTS)
    digest = hashlib.sha256(data).hexdigest()
    hint = "truncated or changed since; copy both files again"
    _rule(digest == card.sha256, f"sha256 of {file}", f"what its card says ({card.sha256[:12]})", digest[:12], hint)
    try:
        arrays = safetensors.numpy.load(data)
    except Exception as problem:  # SafetensorError and what numpy raises; the library lists none
        where = f"{file} must be a safetensors file, got {len(data)} bytes"
        raise SettingError(f"{printable(where)}: {one_line(problem)}") from problem
    wanted, present = set(names[card.network]), set(arrays)
    hint = f"missing {sorted(wanted - present)}, unknown {_short(sorted(present - wanted))}"
    _rule(wanted == present, f"arrays of {file}", f"those of a {card.network!r} network", len(present), hint)
    for name, array in arrays.items():
        fine = array.dtype == np.float32 and bool(np.isfinite(array).all())
        _rule(fine, f"{name} of {file}", "finite float32 numbers", str(array.dtype), "did the training diverge?")
    check_shapes(file, card, arrays)
    for name, array in arrays.items():
        largest, hint = float(np.abs(array).max()), "beyond it sums may overflow; did the training diverge?"
        _rule(largest <= MAX_WEIGHT, f"{name} of {file}", f"numbers of at most {MAX_WEIGHT:g}", largest, hint)
    return card, arrays


def check_shapes(file: Path, card: Card, arrays: Mapping[str, np.ndarray]) -> None:
    """Raise `SettingError` unless each layer takes what the one before gives."""
    extra = card.extra
    shape = {name: array.shape for name, array in arrays.items()}
    for name in shape:
        if name.endswith("_bias"):
            fine = len(shape[name]) == 1 and 1 <= shape[name][0] <= MAX_WIDTH
            _rule(fine, f"{name} of {file}", f"a row of 1 to {MAX_WIDTH} numbers", shape[name], "is it another's?")
    width = {name.removesuffix("_bias"): sizes[0] for name, sizes in shape.items() if name.endswith("_bias")}
    own = inputs.OWN + inputs.EMPHASIS + extra
    if card.network == "set":
        rows, spots = width["row"], width["point"]
        wanted = {"row": (inputs.ROW, rows), "own": (own, rows), "term": (rows, rows), "term_bias": (rows,)}
        wanted |= {"point": (inputs.POINT, spots), "spot": (spots, spots), "spot_bias": (spots,)}
        features = own + rows + spots
    else:
        wanted, features = {}, card.observation_size + extra + inputs.EMPHASIS
    one, two = width["first"], width["second"]
    wanted |= {"first": (features, one), "second": (one, two), "action": (two, inputs.ACTION)}
    wanted |= {"action_bias": (inputs.ACTION,)}
    for name, size in wanted.items():
        _rule(shape[name] == size, f"{name} of {file}", f"of the shape {size}", shape[name], "made by another version?")


def read_card(file: Path) -> Card:
    """The card beside a file of weights. Raises as `read` if it is missing, no card, or of other observations."""
    place = file.with_suffix(".json")
    _rule(place.is_file(), f"card of {file}", "a file that exists", str(place), "the two belong together")
    told = read_json(place, "card of a learned policy", MAX_CARD, nan=True)  # a score may be NaN
    keys = set(told) if isinstance(told, dict) else set()
    if not REQUIRED <= keys <= {part.name for part in FIELDS}:
        unknown = sorted(keys - {part.name for part in FIELDS})
        got = f"missing {sorted(REQUIRED - keys)}, unknown {_short(unknown)}"
        raise SettingError(f"{printable(str(place))} must be the card of a learned policy, got {got}: is it another?")
    for name, (holds, says, hint) in RULES.items():
        _rule(name not in told or holds(told[name]), f"{name} of {place}", says, told.get(name), hint)
    card = Card(**told)
    both = bool(card.base) and card.memory
    _rule(not both, f"memory of {place}", f"false with a base law ({card.base})", card.memory, "written by hand?")
    _check_columns(place, card.columns)
    hint = "units, frames or scales are others since; train it anew"
    mine = inputs.fingerprint()
    _rule(card.inputs == mine, f"inputs of {place}", f"{mine}, as this version scales them", card.inputs, hint)
    return card


def _check_columns(place: Path, columns: Mapping[str, Sequence[str]]) -> None:
    known = inputs.columns()
    hint = "trained on another observation layout; train it anew"
    _rule(columns.keys() == known.keys(), f"columns of {place}", f"of the tables {', '.join(known)}", [*columns], hint)
    for table, names in known.items():
        stated = columns[table]
        fine = isinstance(stated, list) and all(isinstance(name, str) for name in stated)
        _rule(fine, f"columns {table!r} of {place}", "a list of names", stated, "written by hand?")
        odd = _short(sorted(set(stated) ^ set(names)) or "another order")
        hint = f"trained on another observation layout, which differs in {odd}; train it anew"
        _rule(stated == names, f"columns {table!r} of {place}", f"the {len(names)} of this version", len(stated), hint)


def _rule(holds: bool, field: str, says: str, value: Any, hint: str) -> None:
    """`rule` for values of files, which may be long and have letters that a terminal obeys."""
    if not holds:
        raise SettingError(f"{printable(field)} must be {says}, got {_short(value)}: {hint}")


def _short(value: Any) -> str:
    shortener = reprlib.Repr()
    shortener.maxstring = shortener.maxother = 80
    return printable(shortener.repr(value))
