"""Recordings as files: a header and some arrays in one compressed .npz, without pickle. The format: docs/recording.md.

The first member is the header, JSON as bytes; it holds a hash of all there is, so that damage is noticed. What the
header says is `recording`'s to read.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

VERSION = 1
HEADER = "fovconn_recording"
ARRAYS = ("sticks", "actions", "poses")
_MAGIC = b"PK\x03\x04"  # a zip file's first bytes
_NAME_AT = 30  # byte at which the name of its first member stands


class NotARecording(ValueError):
    """The file is something else."""


class Damaged(ValueError):
    """The file was a recording, but not all of it is there or as it was written."""


class Contents(NamedTuple):
    """What a file holds."""

    header: dict[str, Any]
    arrays: dict[str, np.ndarray]  # float64, by the names in ARRAYS


def write_contents(path: Path, contents: Contents) -> None:
    """Write a file; one that is there stays until the new one is whole. `ValueError` unless it ends in .npz."""
    if path.suffix != ".npz":
        raise ValueError(f"a recording must be a file in .npz, got {str(path)!r}: add the ending")
    header = contents.header | {"format": VERSION, "sha256": _digest(contents)}
    text = json.dumps(header, allow_nan=False).encode()
    aside = path.with_name(f"{path.stem}.{os.getpid()}.part.npz")
    members: dict[str, Any] = {HEADER: np.frombuffer(text, np.uint8), **contents.arrays}
    try:
        np.savez_compressed(aside, **members)
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)


def read_contents(path: Path) -> Contents:
    """What a file holds, just as it was written.

    Raises `OSError` for a file that cannot be read, `NotARecording` and `Damaged`.
    """
    data = path.read_bytes()
    if not data.startswith(_MAGIC) and not (_MAGIC.startswith(data) and path.suffix == ".npz"):
        raise NotARecording(f"{path} is no recording: fovconn writes them with --record, as .npz")
    try:
        header, arrays = _members(data)
    except Exception as problem:  # whatever zipfile, zlib, numpy and json say to broken bytes
        if not (HEADER + ".npy").encode().startswith(data[_NAME_AT : _NAME_AT + len(HEADER) + 4]):
            raise NotARecording(f"{path} is no recording: an .npz, or another zip file, of something else") from None
        raise Damaged(f"{path} is damaged or not complete: {problem}") from problem
    if header.pop("format", None) != VERSION:
        raise NotARecording(f"{path} is a recording of a format other than {VERSION}: is it of a newer fovconn_env?")
    if header.pop("sha256", None) != _digest(Contents(header, arrays)):
        raise Damaged(f"{path} is damaged: its contents are not those that were written")
    return Contents(header, arrays)


def _members(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:  # its reads check each member's checksum

        def member(name: str) -> np.ndarray:
            return np.lib.format.read_array(io.BytesIO(archive.read(f"{name}.npy")), allow_pickle=False)

        header = json.loads(member(HEADER).tobytes())
        names = [name.removesuffix(".npy") for name in archive.namelist()]
        return header, {name: member(name) for name in ARRAYS if name in names}


def _digest(contents: Contents) -> str:
    digest = hashlib.sha256(json.dumps(contents.header, sort_keys=True).encode())
    for name, array in sorted(contents.arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
