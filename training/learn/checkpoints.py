"""What a checkpoint must hold for the training that it is restored into. Raises `SettingError`.

A simulator's arrays go to compiled code, which checks no index: every number in them that is one is checked here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from fovconn_env.errors import SettingError, rule
from fovconn_env.fields import check_array, check_keys
from fovconn_env.files import parse_json
from fovconn_env.kernel.records import State, World

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # of Adam, for a parameter
_MOST = 2.0**53  # steps that a float counts


def below(arrays: Mapping[str, np.ndarray], name: str) -> dict[str, np.ndarray]:
    """The arrays whose names begin with "name/", without that prefix."""
    return {key.removeprefix(f"{name}/"): array for key, array in arrays.items() if key.startswith(f"{name}/")}


def check_like(name: str, array: Any, mine: np.ndarray, *, finite: bool = True) -> None:
    """The array must be of the type and shape of one of the training's own."""
    check_array(name, array, mine.dtype, mine.shape, finite=finite)


def check_tensors(name: str, arrays: Mapping[str, np.ndarray], tensors: Mapping[str, torch.Tensor]) -> None:
    """The arrays below "name/" must be those of a module's `state_dict`."""
    stored = below(arrays, name)
    check_keys(f"{name} of the checkpoint", stored, tuple(tensors))
    for key, tensor in tensors.items():
        check_like(f"{name}/{key}", stored[key], tensor.numpy())


def optimizer_state(
    arrays: Mapping[str, np.ndarray], parameters: Sequence[torch.Tensor]
) -> dict[int, dict[str, torch.Tensor]]:
    """The state of Adam from the arrays below "optimizer/", by the number of a parameter; some may have none yet."""
    states: dict[int, dict[str, np.ndarray]] = {}
    for key, array in below(arrays, "optimizer").items():
        k, _, name = key.partition("/")
        known = k.isascii() and k.isdecimal() and len(k) < 9 and int(k) < len(parameters)
        rule(known, "optimizer of the checkpoint", f"of {len(parameters)} parameters", key, "made by other settings")
        states.setdefault(int(k), {})[name] = array
    for k, state in states.items():
        check_keys(f"optimizer/{k}", state, _MOMENTS)
        for name in _MOMENTS:
            check_array(f"optimizer/{k}/{name}", state[name], "f4", () if name == "step" else parameters[k].shape)
    return {k: {name: torch.tensor(array) for name, array in state.items()} for k, state in states.items()}


def counters(arrays: Mapping[str, np.ndarray]) -> tuple[int, int, float]:
    """Steps, iterations and seconds of the training so far."""
    check_array("counters", arrays.get("counters"), "f8", (3,))
    steps, iteration, seconds = arrays["counters"].tolist()
    fine = 0 <= min(steps, iteration, seconds) and max(steps, iteration, seconds) <= _MOST
    rule(fine, "counters", "at least 0", [steps, iteration, seconds], "steps, iterations and seconds")
    return int(steps), int(iteration), seconds


# -------------------------------------------------------------------------------------------------------- simulators
def check_state(stored: Mapping[str, np.ndarray], state: State, n_agents: int) -> None:
    """The arrays "state/..." must have shapes and fields of `state`, and indices within its bounds."""
    for name, mine in state.arrays().items():
        array = stored.get(f"state/{name}")
        rule(isinstance(array, np.ndarray), f"state/{name}", "an array", type(array).__name__, "made by other code")
        assert array is not None
        hint = "made by other settings"
        rule(array.shape == mine.shape, f"state/{name}", f"of the shape {mine.shape}", array.shape, hint)
        for field in mine.dtype.names or ():
            fits = array.dtype.names is not None and field in array.dtype.names
            fits = fits and array.dtype[field] == mine.dtype[field]
            rule(fits, f"state/{name}", f"records with {field} ({mine.dtype[field]})", array.dtype.names, hint)
        plain = mine.dtype.names is not None or array.dtype == mine.dtype
        rule(plain, f"state/{name}", f"of the type {mine.dtype}", str(array.dtype), hint)
    episode = stored["state/episode"]
    _check_index("leader", episode["leader"], n_agents)
    blob = stored["state/blob"]
    if blob.size:
        _check_index("name", blob["name"] + 1, n_agents + 1)  # -1: unknown
        _check_index("code", blob["code"], n_agents)
    for field in ("waypoint", "step", "n_rounds", "max_steps"):
        _check_index(field, episode[field], 2**62)


def check_world(stored: Mapping[str, np.ndarray], world: World, n_agents: int) -> None:
    """The arrays "world/..." must be of the types of `world`, for any map, and indices within its bounds."""
    for name, mine in world._asdict().items():
        shape = mine.shape if name not in ("piece", "vertex") else (len(mine), -1, *mine.shape[2:])
        check_array(f"world/{name}", stored.get(f"world/{name}"), mine.dtype, shape, finite=False)
    piece, n_vertices = stored["world/piece"], stored["world/vertex"].shape[1]
    for field in ("first", "count"):
        _check_index(f"piece.{field}", piece[field], n_vertices + 1)
    _check_index("piece.first + count", piece["first"] + piece["count"], n_vertices + 1)
    _check_index("n_waypoints", stored["world/n_waypoints"], world.waypoint.shape[1] + 1)
    _check_index("fault.robot", stored["world/fault"]["robot"], n_agents)


def generators(texts: Any, count: int) -> list[np.random.Generator | None]:
    """Generators from the JSON of their states, "" for none."""
    fits = isinstance(texts, np.ndarray) and texts.dtype.kind == "U" and texts.shape == (count,)
    rule(fits, "generators", f"{count} texts", type(texts).__name__, "made by other settings")
    result: list[np.random.Generator | None] = []
    for text in texts.tolist():
        rng = np.random.default_rng(0)
        try:
            rng.bit_generator.state = parse_json(text.encode()) if text else rng.bit_generator.state
        except (ValueError, TypeError, KeyError, OverflowError) as problem:
            raise SettingError(f"generators must be states of numpy's, got {text[:80]!r}: {problem}") from problem
        result.append(rng if text else None)
    return result


def _check_index(name: str, values: np.ndarray, size: int) -> None:
    bad = values[(values < 0) | (values >= size)]
    rule(not bad.size, f"{name} of the checkpoint", f"in 0..{size - 1}", bad[:1].tolist(), "it counts from 0")
