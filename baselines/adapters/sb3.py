"""Models of Stable-Baselines3 and of what builds on it (sb3-contrib): `model.save(file)` wrote them.

To open one unpickles what stands in it: code of whoever wrote it. Needs torch and stable_baselines3.
"""

from __future__ import annotations

import inspect
import json
import pickle
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.vec_env import VecNormalize

from fovconn_env.baselines.adapters.model import ROWS, Model, Observed, Shared, check_size, in_blocks, opened
from fovconn_env.baselines.learned.inputs import ACTION, LEADER, gain, input_size
from fovconn_env.baselines.learned.networks import Encoder
from fovconn_env.errors import SettingError, rule
from fovconn_env.files import one_line, open_file
from fovconn_env.scenarios.scenario import Scenario

OBSERVATION = "observation"  # a robot's own, in a `Dict` for asymmetric critics
NEEDED = ("policy_class", "policy_kwargs", "observation_space", "action_space")
OPENED = (*NEEDED, "use_sde", "_last_obs")  # of a model's fields; the others stay closed
STATISTICS = ("vecnormalize.pkl", "vec_normalize.pkl")  # names that SB3's zoo and manual use


class Sb3Policy(Model):
    """A model of Stable-Baselines3, without exploration, as trained on `make_vec_env` or by `fovconn train`."""

    has_memory = False  # unless the network is a recurrent one, or sees several steps at once
    _memory: tuple[np.ndarray, ...] = ()  # (R, ...) each
    _past: np.ndarray | None = None  # (R, (frames - 1) D), what robots have seen in the steps before

    def __init__(self, scenario: Scenario) -> None:
        """Raises `SettingError` for what is no such model, cannot be opened here, or was made for other spaces."""
        super().__init__(scenario)
        file, data, weights = self.file, *read(self.file)
        extra = extra_columns(data)
        self._gain = np.ones(ACTION, np.float32) if extra is None else gain(scenario)
        self._observed = Observed(scenario, built_in=extra is not None)
        self._size = self._observed.size if extra is None else input_size(scenario)
        self._frames = frames(data["observation_space"], self._size)
        self._check_spaces(data, extra)
        self._as_dict = isinstance(data["observation_space"], spaces.Dict)
        self._mean, self._deviation, self._bound = self._statistics(data)
        self._network = Shared(build(file, data, weights))
        self._blank = self._start()
        self.has_memory = bool(self._blank) or self._frames > 1

    @classmethod
    def files(cls) -> list[Path]:
        """The model, and beside it the statistics of `VecNormalize`, if there are any."""
        return [cls.file, *statistics(cls.file)[:1]]

    def reset(self, mask: npt.ArrayLike | None = None) -> None:
        """Forget the states of a recurrent network, and what was seen in the steps before."""
        if mask is None:
            self._memory, self._past = (), None
        for part in (*self._memory, *([] if self._past is None else [self._past])):
            part[np.ravel(np.asarray(mask, bool))] = 0.0

    def decide(self, flat: np.ndarray) -> np.ndarray:
        """Actions (R, 4) for flat observations (R, D)."""
        rows = self._observed(flat)[:, : self._size]
        one_by_one = len(self._mean) == self._size  # VecFrameStack around VecNormalize, not the other way round
        rows = self._stacked(self._normal(rows)) if one_by_one else self._normal(self._stacked(rows))
        if self._blank and not self._memory:
            self._memory = tuple(np.repeat(part, len(flat), axis=0) for part in self._blank)
        actions, *memory = in_blocks(self._predict, ROWS, rows, *self._memory)
        self._memory = tuple(memory)
        return np.clip(actions * self._gain, -1.0, 1.0)

    def _normal(self, rows: np.ndarray) -> np.ndarray:
        """The rows as `VecNormalize` makes them."""
        rows = np.clip((rows - self._mean) / self._deviation, -self._bound, self._bound)
        return rows.astype(np.float32)

    def _stacked(self, rows: np.ndarray) -> np.ndarray:
        """The rows behind those of the steps before, the last one last; zeros before the first, as `VecFrameStack`."""
        if self._frames == 1:
            return rows
        if self._past is None:
            self._past = np.zeros((len(rows), (self._frames - 1) * self._size), np.float32)
        whole = np.concatenate([self._past, rows], axis=1)
        self._past = whole[:, self._size :].copy()
        return whole

    def _predict(self, rows: np.ndarray, *memory: np.ndarray) -> tuple[np.ndarray, ...]:
        """Actions and states of some robots; SB3 has the robots of a state in its second axis."""
        state = tuple(part.swapaxes(0, 1) for part in memory) or None
        seen = {OBSERVATION: rows} if self._as_dict else rows
        actions, after = self._network.held.predict(seen, state, deterministic=True)
        return actions, *(part.swapaxes(0, 1) for part in after or ())

    def _start(self) -> tuple[np.ndarray, ...]:
        """The state of one robot before its first step, () without one. `SettingError` if the network needs more."""
        try:
            _, *states = self._predict(np.zeros((ROWS, self._frames * self._size), np.float32))
        except KeyError as problem:
            got = f"{self.file} must fly by {OBSERVATION!r} alone, got a need for {problem}: its actor sees more, which"
            raise SettingError(f"{got} fovconn_env.training.sb3.AsymmetricPolicy shows the critic alone") from problem
        return tuple(np.zeros_like(part[:1]) for part in states)

    def _check_spaces(self, data: Mapping[str, Any], extra: int | None) -> None:
        """`SettingError` for a model of other observations or actions than the scenario's."""
        seen, actions = data["observation_space"], data["action_space"]
        if isinstance(seen, spaces.Dict):
            hint = "make_vec_env has flat observations, with state=True a Dict of them and the true state"
            rule(OBSERVATION in seen.spaces, f"observations of {self.file}", "flat", list(seen.spaces), hint)
            seen = seen[OBSERVATION]
        hint = "fly the NAME.safetensors beside it, which is the same network with its law or memory"
        rule(not extra, f"{self.file}", "a model that acts alone", f"{extra} columns of a law or a memory", hint)
        check_size(self.file, seen.shape, self._frames * self._size)
        box = isinstance(actions, spaces.Box) and actions.shape == (ACTION,)
        shares = box and (extra is not None or bool((actions.low == -1.0).all() and (actions.high == 1.0).all()))
        hint = "vx, vy, vz and yaw rate as shares, as in make_vec_env"
        rule(shares, f"actions of {self.file}", f"Box(-1, 1, ({ACTION},))", str(actions), hint)

    def _statistics(self, data: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray, float]:
        """Mean and deviation that observations are normalised by, and the bound of what comes out.

        A model does not say that it was trained with `VecNormalize`. The last observations that it saw do, as
        `is_leader` is 0 or 1 in others.
        """
        last, files = data.get("_last_obs"), statistics(self.file)
        last = last.get(OBSERVATION) if isinstance(last, dict) else last
        normal = None
        leader = (self._frames - 1) * self._size + LEADER  # in the last of the frames
        if isinstance(last, np.ndarray) and last.ndim == 2 and last.shape[1] > leader:
            normal = not np.isin(last[:, leader], (0.0, 1.0)).all()
        hint = f"save VecNormalize's statistics beside it, as {' or '.join(STATISTICS)}"
        rule(not normal or bool(files), f"{self.file}", "a model of observations as they are", "normalised ones", hint)
        if normal is False or not files:
            return np.zeros(1, np.float32), np.ones(1, np.float32), np.inf
        with files[0].open("rb") as stream:
            loaded = opened(files[0], lambda: pickle.load(stream))
        rule(isinstance(loaded, VecNormalize), f"{files[0]}", "statistics of VecNormalize", type(loaded).__name__, hint)
        moments: Any = loaded.obs_rms[OBSERVATION] if isinstance(loaded.obs_rms, dict) else loaded.obs_rms
        whole = moments.mean.shape == (self._frames * self._size,)
        check_size(files[0], moments.mean.shape, self._size * (self._frames if whole else 1))
        return moments.mean, np.sqrt(moments.var + loaded.epsilon), loaded.clip_obs


def extra_columns(data: Mapping[str, Any]) -> int | None:
    """How many numbers a model that `fovconn train` made reads of a base law, 0 without one; None for any other model.

    Ours act in a network's units (`learn.rows.Rows`), others in shares. Only ours say this number.
    """
    options = data["policy_kwargs"]
    kind, words = options.get("features_extractor_class"), options.get("features_extractor_kwargs") or {}
    return words.get("extra") if isinstance(kind, type) and issubclass(kind, Encoder) else None


def frames(space: spaces.Space, size: int) -> int:
    """How many observations of `size` columns a model sees at once, 1 for one that was trained without `VecFrameStack`.

    It puts them side by side, and repeats each bound as often, which tells them from longer observations.
    """
    space = space[OBSERVATION] if isinstance(space, spaces.Dict) and OBSERVATION in space.spaces else space
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        return 1
    count, rest = divmod(space.shape[0], size)
    grids = [bound.reshape(-1, count) for bound in (space.low, space.high)] if count > 1 and not rest else []
    return count if grids and all((grid == grid[:, :1]).all() for grid in grids) else 1


def statistics(file: Path) -> list[Path]:
    """Statistics of `VecNormalize` beside a model, the likeliest first.

    SB3's CheckpointCallback writes x_vecnormalize_100_steps.pkl beside x_100_steps.zip, its zoo NAME/vecnormalize.pkl.
    """
    own = re.sub(r"_(\d+)_steps$", r"_vecnormalize_\1_steps", file.stem)
    names = [f"{own}.pkl"] if own != file.stem else [*STATISTICS, f"{file.stem}/{STATISTICS[0]}"]
    return [place for place in map(file.parent.joinpath, names) if place.is_file()]


def read(file: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The fields of a model that are needed to fly it, and its weights; raises as `Sb3Policy`."""
    where = "model of Stable-Baselines3"
    with open_file(file, where) as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                fields = json.loads(archive.read("data"))
        except (zipfile.BadZipFile, KeyError, ValueError) as problem:
            got = f"{file} must be a {where}, got {one_line(problem)}"
            raise SettingError(f"{got}: model.save(file) writes one") from problem
    closed = dict.fromkeys(set(fields) - set(OPENED))
    data, weights, _ = opened(file, lambda: load_from_zip_file(file, device="cpu", custom_objects=closed))
    missing = [name for name in NEEDED if data.get(name) is None] + ["policy"] * ("policy" not in weights)
    rule(not missing, f"{file}", f"a {where}", f"none of {', '.join(missing)}", "saved by another version?")
    return data, weights


def build(file: Path, data: Mapping[str, Any], weights: Mapping[str, Any]) -> Any:
    """The network of a model, as its algorithm makes it."""
    options = {name: value for name, value in data["policy_kwargs"].items() if name != "device"}
    if data.get("use_sde"):
        options["use_sde"] = True
    spaces_of, kind = (data["observation_space"], data["action_space"]), data["policy_class"]
    words = inspect.signature(kind).parameters.values()
    learns = any(word.name == "lr_schedule" or word.kind is word.VAR_POSITIONAL for word in words)  # ARS has no rate
    rate = (lambda _: 0.0,) if learns else ()
    network = opened(file, lambda: kind(*spaces_of, *rate, **options))
    opened(file, lambda: network.load_state_dict(weights["policy"]))
    network.set_training_mode(False)
    return network
