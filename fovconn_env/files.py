"""Files: the atomic write, and archives, which hold arrays with a header and a checksum in one .npz.

The first member of an archive is its header, JSON as bytes, named after the kind of the archive. It holds a hash of
everything else, so that damage is noticed. Nothing is pickled: reading an archive runs no code of the file.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import uuid
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

_MAGIC = b"PK\x03\x04"  # a zip file's first bytes
_NAME_AT = 30  # byte at which the name of its first member stands


class OtherKind(ValueError):
    """The file holds something else."""


class Damaged(ValueError):
    """The file was of this kind, but not all of it is there or as it was written."""


class Kind(NamedTuple):
    """A kind of archive."""

    member: str  # name of the header in the archive
    name: str  # in messages, such as "recording"
    source: str  # what writes such files, for messages
    format: int | str  # changes with the meaning of header or arrays
    old_key: str = ""  # a key by which to know a header of version 0.1: text without a checksum, in the member "told"


RECORDING = Kind("fovconn_recording", "recording", "fovconn writes them with --record, as .npz", 1)


class Archive(NamedTuple):
    """What a file holds."""

    header: dict[str, Any]  # JSON values
    arrays: dict[str, np.ndarray]


# ------------------------------------------------------------------------------------------------------- atomic write
@contextmanager
def replacing(*paths: Path) -> Iterator[list[Path]]:
    """Paths to write to, beside `paths` and with the same suffixes; the new files replace the old ones together.

    The old files stay until all new ones are complete and on the disk. After an exception nothing has changed.
    """
    parts = [path.with_name(f"{path.stem}.{uuid.uuid4().hex[:12]}.part{path.suffix}") for path in paths]
    try:
        yield parts
        for part in parts:
            with part.open("rb+") as stream:
                os.fsync(stream.fileno())
        for part, path in zip(parts, paths, strict=True):
            part.replace(path)
    finally:
        for part in parts:
            part.unlink(missing_ok=True)


def write_files(contents: Mapping[Path, bytes]) -> None:
    """Write files that belong together: all of them or, after an `OSError`, none."""
    with replacing(*contents) as parts:
        for part, data in zip(parts, contents.values(), strict=True):
            part.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8; a device or a pipe, such as /dev/stdout, gets it as it is. Raises `OSError`."""
    if path.is_char_device() or path.is_fifo():
        path.write_text(text, "utf-8")
    else:
        write_files({path: text.encode()})


# ----------------------------------------------------------------------------------------------------------- archives
def write_archive(path: Path, kind: Kind, archive: Archive, *, compress: bool = True) -> None:
    """Write an archive, atomically. Raises `ValueError` unless the path ends in .npz, and `OSError`."""
    if path.suffix != ".npz":
        raise ValueError(f"a {kind.name} must be a file in .npz, got {str(path)!r}: add the ending")
    header = archive.header | {"format": kind.format, "sha256": _digest(archive)}
    text = np.frombuffer(json.dumps(header, allow_nan=False).encode(), np.uint8)
    method = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    with replacing(path) as (part,), zipfile.ZipFile(part, "w", method) as members:
        for name, array in {kind.member: text, **archive.arrays}.items():
            with members.open(f"{name}.npy", "w", force_zip64=True) as stream:  # its date is always 1980
                np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=False)


def read_archive(path: Path, kind: Kind) -> Archive:
    """What a file holds, just as it was written.

    Raises `OSError` for a file that cannot be read, `OtherKind` and `Damaged`.
    """
    data = path.read_bytes()
    if not data.startswith(_MAGIC) and not (_MAGIC.startswith(data) and path.suffix == ".npz"):
        raise OtherKind(f"{path} is no {kind.name}: {kind.source}")
    try:
        header, arrays = _parse(data, kind)
    except Exception as problem:  # whatever zipfile, zlib, numpy and json say to broken bytes
        if not (kind.member + ".npy").encode().startswith(data[_NAME_AT : _NAME_AT + len(kind.member) + 4]):
            raise OtherKind(f"{path} is no {kind.name}: an .npz, or another zip file, of something else") from None
        raise Damaged(f"{path} is damaged or not complete: {str(problem).partition(chr(10))[0]}") from problem
    if header.pop("format", None) != kind.format:
        raise OtherKind(f"{path} is a {kind.name} of a format other than {kind.format}: is it of a newer fovconn_env?")
    if header.pop("sha256", None) != _digest(Archive(header, arrays)):
        raise Damaged(f"{path} is damaged: its contents are not those that were written")
    return Archive(header, arrays)


def _parse(data: bytes, kind: Kind) -> Archive:
    """All of a file, not checked; `KeyError` for one of another kind."""
    with zipfile.ZipFile(io.BytesIO(data)) as members:  # its reads check each member's checksum
        arrays = {
            name.removesuffix(".npy"): np.lib.format.read_array(io.BytesIO(members.read(name)), allow_pickle=False)
            for name in members.namelist()
        }
    if kind.member in arrays or not kind.old_key:
        return Archive(json.loads(arrays.pop(kind.member).tobytes()), arrays)
    header = json.loads(str(arrays.pop("told")))
    if kind.old_key not in header:
        raise KeyError(kind.old_key)
    header.pop("format", None)
    return Archive(header | {"format": kind.format, "sha256": _digest(Archive(header, arrays))}, arrays)


def _digest(archive: Archive) -> str:
    digest = hashlib.sha256(json.dumps(archive.header, sort_keys=True).encode())
    for name, array in sorted(archive.arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        for field in array.dtype.names or (...,):  # what lies between the fields of a record is not kept
            digest.update(array[field].tobytes())
    return digest.hexdigest()
