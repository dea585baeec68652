"""A leader whose stick was recorded. The other leaders are words: "waypoints", "none", "random" and "human"."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fovconn_env.errors import SettingError, as_numbers, rule
from fovconn_env.fields import check_array
from fovconn_env.files import RECORDING, Damaged, one_line, read_archive
from fovconn_env.text import printable

MAX_STICKS = 10_000_000  # rows: a week at 0.05 s a step, 240 MB


@dataclass(frozen=True, eq=False)
class Recorded:
    """Sticks (T, 3), m/s in the leader's yaw frame, one for each step of an episode; after its end the stick is zero.

    Frozen like all settings: the array is a copy that cannot be written to. Raises `ValueError` for another shape, NaN
    and infinity; that no stick is faster than `Scenario.stick_speed` is the scenario's to check.
    """

    sticks: np.ndarray  # (T, 3) m/s

    def __post_init__(self) -> None:
        sticks = as_numbers("Recorded.sticks", self.sticks)
        if sticks.shape == (0,):  # of an empty list
            sticks = sticks.reshape(0, 3)
        if sticks.ndim != 2 or sticks.shape[1] != 3:
            raise SettingError(f"Recorded.sticks must have the shape (T, 3), got {sticks.shape}: m/s, one row a step")
        rule(len(sticks) <= MAX_STICKS, "Recorded.sticks", f"at most {MAX_STICKS} rows", len(sticks), "one row a step")
        if not np.isfinite(sticks).all():
            row = int(np.argwhere(~np.isfinite(sticks))[0, 0])
            raise SettingError(f"Recorded.sticks must be finite, got {sticks[row].tolist()} in row {row}: m/s")
        sticks = sticks.copy()
        sticks.flags.writeable = False
        object.__setattr__(self, "sticks", sticks)

    @classmethod
    def from_file(cls, path: str | Path) -> Recorded:
        """The sticks of a recorded flight. Raises as `fovconn_env.flights.recording.load` does."""
        sticks: Any = read_archive(Path(path), RECORDING).arrays.get("sticks")
        try:
            check_array("sticks", sticks, "f8", (-1, 3))
        except SettingError as problem:
            raise Damaged(f"{printable(str(path))} is damaged: {one_line(problem)}") from problem
        return cls(sticks)

    def __eq__(self, other: object) -> bool:
        return np.array_equal(self.sticks, other.sticks) if isinstance(other, Recorded) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.sticks.tobytes())

    def __repr__(self) -> str:
        return f"<Recorded of {len(self.sticks)} sticks>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Recorded, (self.sticks,)  # numpy's own copies could be written to
