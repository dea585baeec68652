"""Curves of trainings, as `fovconn train` writes them: lines "step,name,value"."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

Curves = dict[str, list[tuple[float, float]]]


def read(file: Path, names: Iterable[str]) -> Curves:
    """Points (step, value) of the curves of these names; the half line that a full disk leaves is none."""
    with file.open(newline="", encoding="utf-8") as stream:
        rows = [(row["name"], row["step"], row["value"]) for row in csv.DictReader(stream)]
    whole = [(name, float(step), float(value)) for name, step, value in rows if value]
    return {chosen: [(step, value) for name, step, value in whole if name == chosen] for chosen in names}
