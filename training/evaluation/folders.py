"""Folders that are written to: by one process at a time, and without what a killed one left behind."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import filelock

from fovconn_env.errors import SettingError

LOCK = ".lock"
_PART = re.compile(r"\.[0-9a-f]{12}\.part(\.\w+)?$")  # see `files.replacing`


@contextmanager
def claimed(folder: Path, option: str = "--out", *, wait: float = 0.0) -> Iterator[None]:
    """Make a folder and keep other processes out of it; one that ends, however, gives it back.

    Raises `SettingError`, at once or after a `wait` (s), if another process, or another thread of this one, has it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with filelock.FileLock(folder / LOCK, is_singleton=True).acquire(timeout=wait):
            remove_parts(folder)
            yield
    except filelock.Timeout:
        hint = "wait for it to end, or name another folder"
        raise SettingError(f"{option} must name a folder that is not in use, got {str(folder)!r}: {hint}") from None


def remove_parts(folder: Path) -> None:
    """Remove the half-written files of a process that was killed."""
    for file in folder.glob("*.part*"):
        if _PART.search(file.name):
            file.unlink(missing_ok=True)
