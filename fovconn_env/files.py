"""Files: the atomic write, JSON, and archives, which hold arrays with a header and a checksum in one .npz.

The first member of an archive is its header, JSON as bytes, named after the kind of the archive. It holds a hash of
everything else, so that damage is noticed. Nothing is pickled: reading an archive runs no code of the file, and takes
no more memory than docs/security.md says.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import stat
import uuid
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from fovconn_env.errors import FovconnError, SettingError
from fovconn_env.npz import check_types, max_bytes, read_arrays, write_arrays
from fovconn_env.text import printable

MAX_HEADER = 8 << 20  # bytes: the sticks of a flight of an hour, twice, or a map of 20,000 corners
MAX_DEPTH = 32  # lists and objects of JSON inside each other; a map in a scenario in a header has 9
_MAGIC = b"PK\x03\x04"  # a zip file's first bytes
_NAME_AT = 30  # byte at which the name of its first member stands
_START, _END = 128, 1 << 16  # bytes at the ends of a file in which it is looked for
_OLD_MEMBER = "told"  # the header of files of version 0.1
_LONG = 400  # letters of a message


class OtherKind(FovconnError, ValueError):
    """The file holds something else."""


class Damaged(FovconnError, ValueError):
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
        with _naming(paths, parts):
            yield parts
            for part in parts:
                with part.open("rb+") as stream:
                    os.fsync(stream.fileno())
            for part, path in zip(parts, paths, strict=True):
                part.replace(path)
    finally:
        for part in parts:
            part.unlink(missing_ok=True)


@contextmanager
def _naming(paths: Sequence[Path], parts: Sequence[Path] = ()) -> Iterator[None]:
    """Names the files in an `OSError`: that of a full disk has no name, and others name a part, which no user knows."""
    try:
        yield
    except OSError as problem:
        if problem.errno is not None and (problem.filename is None or Path(str(problem.filename)) in parts):
            problem.filename = ", ".join(map(str, paths))
        raise


def write_files(contents: Mapping[Path, bytes]) -> None:
    """Write files that belong together: all of them or, after an `OSError`, none."""
    with replacing(*contents) as parts:
        for part, data in zip(parts, contents.values(), strict=True):
            part.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8; a device or a pipe, such as /dev/stdout, gets it as it is. Raises `OSError`."""
    if path.is_char_device() or path.is_fifo():
        with _naming([path]):
            path.write_text(text, "utf-8")
    else:
        write_files({path: text.encode()})


# -------------------------------------------------------------------------------------- reading what may be anything
def one_line(problem: object) -> str:
    """A message's first line, not long, in which a terminal obeys nothing; the name of an error without a message."""
    text = str(problem).partition("\n")[0] or type(problem).__name__
    return printable(text if len(text) <= _LONG else f"{text[:_LONG]}...")


def open_file(path: Path, name: str) -> BinaryIO:
    """A file to read; name: what it should be, such as "recording".

    Raises `OtherKind` for a folder, and for a pipe or a device, which may have no end; and `OSError`.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise OtherKind(f"{printable(str(path))} is no {name}: it is a folder, a pipe or a device, not a file")
    return path.open("rb")


def read_file(path: Path, name: str, limit: int) -> bytes:
    """All of a file of at most `limit` bytes; raises as `open_file`, and `OtherKind` for a longer one."""
    with open_file(path, name) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > limit:
            raise OtherKind(f"{printable(str(path))} is no {name}: it has {size} bytes, more than {limit}")
        return stream.read(size)


def read_json(path: Path, name: str, limit: int, *, nan: bool = False) -> Any:
    """The value of a JSON file; raises as `read_file`, and `Damaged` for what is no JSON, or none of ours."""
    data = read_file(path, name, limit)
    try:
        return parse_json(data, nan=nan)
    except ValueError as problem:
        raise Damaged(f"{printable(str(path))} is no {name}, or damaged: {one_line(problem)}") from problem


def parse_json(data: bytes, *, nan: bool = False) -> Any:
    """The value of JSON in UTF-8, at most `MAX_DEPTH` deep; nan: NaN and infinities are allowed in it.

    Raises `ValueError`.
    """
    deep = f"more than {MAX_DEPTH} lists and objects inside each other"
    try:
        value = json.loads(data.decode(), parse_constant=None if nan else _refuse_constant)
    except RecursionError as problem:
        raise SettingError(deep) from problem
    level, depth = [value], 0
    while level:
        if depth > MAX_DEPTH:
            raise SettingError(deep)
        inner = (item.values() if isinstance(item, dict) else item for item in level if isinstance(item, (dict, list)))
        level = [part for parts in inner for part in parts if isinstance(part, (dict, list))]
        depth += 1
    json.dumps(value, ensure_ascii=False, allow_nan=nan).encode()  # no 1e999, and no half of a surrogate pair
    return value


def _refuse_constant(name: str) -> None:
    raise SettingError(f"{name} is no number")


# ----------------------------------------------------------------------------------------------------------- archives
def write_archive(path: Path, kind: Kind, archive: Archive, *, compress: bool = True) -> None:
    """Write an archive, atomically. Raises `ValueError` unless the path ends in .npz, and `OSError`."""
    if path.suffix != ".npz":
        raise SettingError(f"a {kind.name} must be a file in .npz, got {str(path)!r}: add the ending")
    arrays = {name: np.asanyarray(array) for name, array in archive.arrays.items()}
    check_types(arrays)
    header = archive.header | {"format": kind.format, "sha256": _digest(Archive(archive.header, arrays))}
    text = np.frombuffer(json.dumps(header, allow_nan=False).encode(), np.uint8)
    if len(text) > MAX_HEADER:
        raise SettingError(f"the header of a {kind.name} must be of at most {MAX_HEADER} bytes, got {len(text)}")
    members = {kind.member: text} | arrays
    total = sum(array.nbytes for array in members.values())
    with replacing(path) as (part,):
        with part.open("wb") as stream:
            write_arrays(stream, members, zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED)
        if total > max_bytes(part.stat().st_size):
            with part.open("wb") as stream:
                write_arrays(stream, members, zipfile.ZIP_STORED)


def read_archive(path: Path, kind: Kind) -> Archive:
    """What a file holds, just as it was written.

    Raises `OSError` for a file that cannot be read, `OtherKind` and `Damaged`.
    """
    with open_file(path, kind.name) as stream:
        return parse_archive(stream, kind, printable(str(path)))


def parse_archive(file: BinaryIO, kind: Kind, path: str) -> Archive:
    """What an open file holds; path: its name in errors. Raises as `read_archive`."""
    start = file.read(_START)
    begun = _MAGIC.startswith(start) and path.endswith(".npz")
    named = any(start[_NAME_AT:].startswith(name) for name in _names(kind).values())
    if not start.startswith(_MAGIC) and not begun and not named:
        raise OtherKind(f"{path} is no {kind.name}: {kind.source}")
    try:
        header, arrays = _parse(file, kind)
    except Exception as problem:  # whatever zipfile, zlib, numpy and json say to broken bytes
        named = None if isinstance(problem, OtherKind) else _named(file, start, kind)
        if named is None:
            raise OtherKind(f"{path} is no {kind.name}: an .npz, or another zip file, of something else") from None
        what = "is damaged or not complete" if named == kind.member else f"is no {kind.name}, or a damaged old one"
        raise Damaged(f"{path} {what}: {one_line(problem)}") from problem
    if header.pop("format", None) != kind.format:
        raise OtherKind(f"{path} is a {kind.name} of a format other than {kind.format}: is it of a newer fovconn_env?")
    if header.pop("sha256", None) != _digest(Archive(header, arrays)):
        raise Damaged(f"{path} is damaged: its contents are not those that were written")
    return Archive(header, arrays)


def _names(kind: Kind) -> dict[str, bytes]:
    """What the header of a file of this kind may be called, and the name in the file."""
    return {name: f"{name}.npy".encode() for name in [kind.member] + [_OLD_MEMBER] * bool(kind.old_key)}


def _named(file: BinaryIO, start: bytes, kind: Kind) -> str | None:
    """The header that a file names which cannot be read: where its first member begins, or in its directory."""
    end = file.seek(0, io.SEEK_END)
    file.seek(max(end - _END, 0))
    tail = file.read(_END)
    there = (
        key for key, name in _names(kind).items() if name.startswith(start[_NAME_AT:][: len(name)]) or name in tail
    )
    return next(there, None)


def _parse(file: BinaryIO, kind: Kind) -> Archive:
    """All of a file, its checksum not compared; an exception of any kind for one that is damaged or of another kind."""
    arrays = read_arrays(file)
    if kind.member in arrays or not kind.old_key:
        return Archive(_header(arrays.pop(kind.member)), arrays)
    header = _header(arrays.pop(_OLD_MEMBER))
    if kind.old_key not in header:
        raise OtherKind(kind.old_key)
    header.pop("format", None)
    return Archive(header | {"format": kind.format, "sha256": _digest(Archive(header, arrays))}, arrays)


def _header(text: np.ndarray) -> dict[str, Any]:
    """The header in an array of bytes, or of letters as in version 0.1."""
    if text.size * text.itemsize > MAX_HEADER * (4 if text.dtype.kind == "U" else 1):
        raise SettingError(f"its header has {text.nbytes} bytes, more than {MAX_HEADER}")
    header = parse_json(str(text).encode() if text.dtype.kind == "U" else text.tobytes())
    if not isinstance(header, dict):
        raise SettingError("its header is no object")
    return header


def _digest(archive: Archive) -> str:
    digest = hashlib.sha256(json.dumps(archive.header, sort_keys=True).encode())
    for name, array in sorted(archive.arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        for field in array.dtype.names or (...,):  # what lies between the fields of a record is not kept
            for piece in np.nditer(array[field], ["external_loop", "buffered", "zerosize_ok"], order="C"):
                digest.update(np.asarray(piece).tobytes())
    return digest.hexdigest()
