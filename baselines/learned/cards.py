"""Files of learned policies: NAME.safetensors, the weights, and NAME.json, the card that tells what they are.

safetensors is plain numbers behind a JSON header: to read one runs no code of the file.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

from fovconn_env.baselines.laws.augmented import Augmented
from fovconn_env.baselines.laws.cohesive import Cohesive
from fovconn_env.baselines.laws.expert import Expert
from fovconn_env.baselines.learned import inputs
from fovconn_env.baselines.policy import Policy
from fovconn_env.errors import SettingError, rule
from fovconn_env.files import write_files

SUFFIX = ".safetensors"
FOLDER = Path(__file__).parent / "weights"  # those of this repository
FORMAT = 1
# laws that a network may correct, or imitate: without memory
BASES: dict[str, type[Policy]] = {"expert": Expert, "augmented": Augmented, "cohesive": Cohesive}


@dataclass(frozen=True, kw_only=True)
class Card:
    """What a file of weights is and how it was made."""

    format: int = FORMAT
    network: str  # "set" or "mlp"
    base: str | None = None  # law that the network corrects; None: it acts alone
    bound: float = 0.0  # of a correction, in units of `inputs.gain`
    observation_size: int  # at training; a set network fits any
    columns: Mapping[str, Sequence[str]]  # names of what the numbers are, by table
    inputs: str  # `inputs.fingerprint` of the code that trained
    sha256: str  # of the file of weights
    made: Mapping[str, Any] = field(default_factory=dict)  # algorithm, command, scenarios, seed, steps, time, versions
    scores: Mapping[str, Any] = field(default_factory=dict)  # on the seeds that chose the checkpoint


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

    Raises `ValueError` for a file that is missing, damaged, or made for other observations, naming file and rule.
    """
    card = read_card(file)
    rule(file.is_file(), f"{file}", "a file that exists", str(file), "a card alone does not fly")
    data = file.read_bytes()
    digest = hashlib.sha256(data).hexdigest()
    hint = "truncated or changed since; copy both files again"
    rule(digest == card.sha256, f"sha256 of {file}", f"what its card says ({card.sha256[:12]})", digest[:12], hint)
    try:
        arrays = safetensors.numpy.load(data)
    except Exception as problem:  # SafetensorError and what numpy raises; the library lists none
        raise SettingError(f"{file} must be a safetensors file, got {len(data)} bytes: {problem}") from problem
    wanted, present = set(names[card.network]), set(arrays)
    hint = f"missing {sorted(wanted - present)}, unknown {sorted(present - wanted)}"
    rule(wanted == present, f"arrays of {file}", f"those of a {card.network!r} network", len(present), hint)
    for name, array in arrays.items():
        fine = array.dtype == np.float32 and bool(np.isfinite(array).all())
        rule(fine, f"{name} of {file}", "finite float32 numbers", str(array.dtype), "did the training diverge?")
    check_shapes(file, card, arrays)
    return card, arrays


def check_shapes(file: Path, card: Card, arrays: Mapping[str, np.ndarray]) -> None:
    """Raise `ValueError` unless each layer takes what the one before gives."""
    extra = inputs.ACTION if card.base else 0
    shape = {name: array.shape for name, array in arrays.items()}
    own = inputs.OWN + inputs.EMPHASIS + extra
    if card.network == "set":
        (width,), (spots,) = shape["row_bias"], shape["point_bias"]
        wanted = {"row": (inputs.ROW, width), "own": (own, width), "term": (width, width), "term_bias": (width,)}
        wanted |= {"point": (inputs.POINT, spots), "spot": (spots, spots), "spot_bias": (spots,)}
        features = own + width + spots
    else:
        wanted, features = {}, card.observation_size + extra + inputs.EMPHASIS
    (one,), (two,) = shape["first_bias"], shape["second_bias"]
    wanted |= {"first": (features, one), "second": (one, two), "action": (two, inputs.ACTION)}
    wanted |= {"action_bias": (inputs.ACTION,)}
    for name, size in wanted.items():
        rule(shape[name] == size, f"{name} of {file}", f"of the shape {size}", shape[name], "made by another version?")


def read_card(file: Path) -> Card:
    """The card beside a file of weights. Raises `ValueError` if it is missing, no card, or of other observations."""
    place = file.with_suffix(".json")
    rule(place.is_file(), f"card of {file}", "a file that exists", str(place), "the two belong together")
    try:
        card = Card(**json.loads(place.read_text("utf-8")))
    except (ValueError, TypeError) as problem:
        raise SettingError(
            f"{place} must be the card of a learned policy, got {problem}: is it another file?"
        ) from None
    rule(card.format == FORMAT, f"format of {place}", f"{FORMAT}", card.format, "written by another version")
    rule(card.network in ("set", "mlp"), f"network of {place}", "set or mlp", card.network, "written by hand?")
    known = f"null or one of {', '.join(BASES)}"
    rule(card.base is None or card.base in BASES, f"base of {place}", known, card.base, "written by hand?")
    for table, names in inputs.columns().items():
        stated = list(card.columns.get(table, ()))
        odd = sorted(set(stated) ^ set(names)) or "another order"
        hint = f"trained on another observation layout, which differs in {odd}; train it anew"
        rule(stated == names, f"columns {table!r} of {place}", f"the {len(names)} of this version", len(stated), hint)
    hint = "units, frames or scales are others since; train it anew"
    mine = inputs.fingerprint()
    rule(card.inputs == mine, f"inputs of {place}", f"{mine}, as this version scales them", card.inputs, hint)
    return card
