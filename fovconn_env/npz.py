"""Arrays in a zip file, an .npz, from whomever it is: what it declares is checked before memory is taken for it.

Read is what `write_arrays` writes, and nothing else: members NAME.npy, stored or deflated, of plain numbers, texts or
records of them. Nothing is unpickled or evaluated.
"""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections.abc import Mapping, Sequence
from typing import IO, BinaryIO, cast

import numpy as np

MAX_MEMBERS = 4096  # the checkpoint of a training on ten scenarios has some 400
# Bytes of all arrays together. Flights shrink to a half or a tenth; robots that stand still shrink a thousandfold, and
# such a file is written without compression. 5 MB are at most 271 MiB.
ALWAYS, RATIO = 128 << 20, 30
_PIECE = 1 << 20  # bytes that are read at once; the directory of MAX_MEMBERS has less
_MAGIC = b"\x93NUMPY\x01\x00"  # of version 1.0 of the format, whose header is at most 64 KiB long
_HEADER = re.compile(
    r"\{'descr': (?:'([<>|]\w\d{0,9})'|(\[\(.*\)\])), 'fortran_order': (True|False), 'shape': \(([\d, ]*)\), \} *\n"
)
_FIELD = re.compile(r"\('(\w*)', '([<>|]\w\d{1,9})'\)(?:, )?")
_KINDS = "biufU"  # of numpy's types: no object, nothing that is unpickled


class _Pieces:
    """A file of which nothing long is read at once: zipfile reads a directory as long as the file says it is."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1) -> bytes:
        if size > _PIECE:
            raise ValueError(f"a part of {size} bytes, its directory perhaps, is longer than {_PIECE}")
        return self._file.read(_PIECE if size < 0 else size)


def max_bytes(size: int) -> int:
    """Bytes of all arrays that a file of `size` bytes may hold."""
    return ALWAYS + RATIO * size


def check_types(arrays: Mapping[str, np.ndarray]) -> None:
    """`ValueError` for arrays that `write_arrays` does not write."""
    if len(arrays) >= MAX_MEMBERS:
        raise ValueError(f"arrays must be fewer than {MAX_MEMBERS}, got {len(arrays)}")
    for name, array in arrays.items():
        if not _is_plain(array.dtype):
            raise ValueError(f"array {name!r} must be of plain numbers, texts or records, got {array.dtype}")


def write_arrays(file: IO[bytes], arrays: Mapping[str, np.ndarray], method: int) -> None:
    """Write arrays, in their order; method: `zipfile.ZIP_DEFLATED` or `ZIP_STORED`."""
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:  # its date is always 1980
                np.lib.format.write_array(stream, array, version=(1, 0), allow_pickle=False)


def read_arrays(file: BinaryIO) -> dict[str, np.ndarray]:
    """All arrays by name, in the file's order; an exception of any kind for a file that does not hold them."""
    size = file.seek(0, io.SEEK_END)
    with zipfile.ZipFile(cast(IO[bytes], _Pieces(file))) as archive:  # its reads check each member's checksum
        members = archive.infolist()
        _check_directory(members, size)
        return {member.filename.removesuffix(".npy"): _read_array(archive, member) for member in members}


def _check_directory(members: Sequence[zipfile.ZipInfo], size: int) -> None:
    """`ValueError` for more than a file of `size` bytes may hold, and for what `write_arrays` does not write."""
    if len(members) > MAX_MEMBERS:
        raise ValueError(f"it has {len(members)} arrays, more than {MAX_MEMBERS}")
    if len({member.filename for member in members}) < len(members):
        raise ValueError("two of its arrays have the same name")
    for member in members:
        name, method, encrypted = member.filename, member.compress_type, member.flag_bits & 1
        if not name.endswith(".npy") or method not in (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED) or encrypted:
            raise ValueError(f"{name!r} in it is no array, or packed in another way")
    total = sum(member.file_size for member in members)
    if total > max_bytes(size):
        raise ValueError(f"{size} bytes that declare arrays of {total} bytes, more than {max_bytes(size)}")


def _read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """One array; its header, too, must say that it is as long as the directory says."""
    with cast(io.BufferedIOBase, archive.open(member)) as stream:
        start = stream.read(len(_MAGIC) + 2)
        header = stream.read(int.from_bytes(start[-2:], "little"))
        match = _HEADER.fullmatch(header.decode("latin1"))
        if not start.startswith(_MAGIC) or match is None:
            raise ValueError(f"{member.filename!r} has a header that numpy does not write")
        dtype = _dtype(match[1], match[2])
        if dtype.hasobject:
            raise ValueError("Object arrays cannot be loaded: they are pickled, and may run any code")
        shape = [int(size) for size in match[4].replace(",", " ").split()]
        n_bytes = member.file_size - len(start) - len(header)
        if not _is_plain(dtype) or math.prod(shape) * dtype.itemsize != n_bytes:
            raise ValueError(f"{member.filename!r} holds {n_bytes} bytes, not {dtype} of the shape {tuple(shape)}")
        data = bytearray(n_bytes)
        for first in range(0, n_bytes, _PIECE):
            piece = memoryview(data)[first : first + _PIECE]
            if stream.readinto(piece) < len(piece):
                raise ValueError(f"{member.filename!r} is cut off")
    return np.ndarray(shape, dtype, data, order="F" if match[3] == "True" else "C")


def _dtype(plain: str | None, fields: str | None) -> np.dtype:
    """The type of a header: a plain one, or the fields of a record, in numpy's words."""
    if fields is None:
        return np.dtype(plain)
    pairs = _FIELD.findall(fields)
    if len(fields) != 2 + sum(len(match[0]) for match in _FIELD.finditer(fields)):
        raise ValueError("a record's fields are not in numpy's words")
    return np.lib.format.descr_to_dtype(pairs)  # which leaves out what lies between the fields


def _is_plain(dtype: np.dtype) -> bool:
    """True for numbers, texts and records of them."""
    parts = [dtype[name] for name in dtype.names] if dtype.names else [dtype]
    return all(part.kind in _KINDS and part.itemsize > 0 for part in parts)
