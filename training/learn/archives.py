"""Arrays and a JSON text in one .npz file; to read one runs no code of the file."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fovconn_env.baselines.learned.cards import replace


def save(file: Path, arrays: Mapping[str, np.ndarray], told: Mapping[str, Any], *, compressed: bool = False) -> None:
    """Write in one go; raises `OSError` and leaves what was there where that fails."""
    stream = io.BytesIO()
    entries: dict[str, Any] = {**arrays, "told": np.array(json.dumps(told))}
    (np.savez_compressed if compressed else np.savez)(stream, allow_pickle=False, **entries)
    replace({file: stream.getvalue()})


def load(file: Path, what: str, hint: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and text of a file; `ValueError` for one that is missing, damaged, or no `what`."""
    if not file.is_file():
        raise ValueError(f"{what} must be a file that exists, got {str(file)!r}: {hint}")
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in kept.files}
        return arrays, json.loads(str(arrays.pop("told")))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as problem:
        line = str(problem).partition("\n")[0]
        raise ValueError(f"{file} must be a {what}, got another or a damaged file ({line}): {hint}") from None
