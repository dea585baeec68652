"""Arrays in a zip file: what is written is read, and what a file declares is checked before memory is taken for it."""

import io
import tracemalloc
import zipfile

import numpy as np
import pytest

from fovconn_env.files import RECORDING, Damaged, parse_archive
from fovconn_env.npz import MAX_MEMBERS, max_bytes, read_arrays, write_arrays

RECORD = np.dtype([("x", "f8"), ("on", "b1"), ("k", "i8")], align=True)


def npy(descr, shape, data=b""):
    """A member in numpy's words, which may lie."""
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data


def archive(members, method=zipfile.ZIP_DEFLATED, header=b"{}"):
    """A zip file of these members behind a header."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as out:
        out.writestr("fovconn_recording.npy", npy("'|u1'", f"({len(header)},)", header))
        for name, data in members:
            out.writestr(name, data)
    return stream.getvalue()


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.array(7),
        np.zeros((0, 4), np.float32),
        np.array(["", "ä\n"]),
        np.zeros((2, 2), RECORD),
        np.array([True, False]),
        np.arange(3, dtype=">i4"),
    ],
    ids=lambda array: f"{array.dtype.str} {array.shape}",
)
def test_arrays_are_what_was_written(array):
    stream = io.BytesIO()
    write_arrays(stream, {"one": array, "a/b": np.zeros(1)}, zipfile.ZIP_STORED)
    found = read_arrays(stream)
    assert list(found) == ["one", "a/b"]
    np.testing.assert_array_equal(found["one"], array)
    assert found["one"].dtype.fields == array.dtype.fields


LIES = {
    "bomb": ([("a.npy", npy("'|u1'", f"({200 << 20},)", bytes(200 << 20)))], "declare arrays of"),
    "many small": ([(f"{k}.npy", b"") for k in range(MAX_MEMBERS + 1)], "more than 4096"),
    "long directory": ([(f"{k:0400}.npy", b"") for k in range(2500)], "its directory perhaps, is longer"),
    "more than there is": ([("a.npy", npy("'<f8'", "(1000000000,)", bytes(8)))], "holds 8 bytes, not float64"),
    "less than there is": ([("a.npy", npy("'<f8'", "(1,)", bytes(16)))], "holds 16 bytes, not float64"),
    "empty and huge": ([("a.npy", npy("'<f8'", f"(0, {2**62})"))], "damaged"),
    "too many digits": ([("a.npy", npy("'<f8'", f"({'9' * 5000},)", bytes(8)))], "damaged"),
    "negative": ([("a.npy", npy("'<f8'", "(-1,)", bytes(8)))], "numpy does not write"),
    "dimensions": ([("a.npy", npy("'<f8'", f"({'1, ' * 200})", bytes(8)))], "damaged"),
    "objects": ([("a.npy", npy("'|O'", "(1,)", bytes(8)))], "Object arrays cannot be loaded"),
    "an object in a record": ([("a.npy", npy("[('x', '|O')]", "(1,)", bytes(8)))], "damaged"),
    "complex": ([("a.npy", npy("'<c16'", "(1,)", bytes(16)))], "not complex128"),
    "dates": ([("a.npy", npy("'<M8[s]'", "(1,)", bytes(8)))], "numpy does not write"),
    "bytes": ([("a.npy", npy("'|S4'", "(1,)", bytes(4)))], "holds 4 bytes"),
    "nothing": ([("a.npy", npy("'<U0'", "(5,)"))], "holds 0 bytes"),
    "inner arrays": ([("a.npy", npy("[('x', '<f8', (9,))]", "(1,)", bytes(72)))], "numpy's words"),
    "code": ([("a.npy", npy("__import__('os').getcwd()", "(1,)", bytes(8)))], "numpy does not write"),
    "long header": ([("a.npy", b"\x93NUMPY\x02\x00" + (9 << 20).to_bytes(4, "little") + bytes(9 << 20))], "numpy does"),
    "no array": ([("a.txt", b"text")], "is no array"),
    "path": ([("../a.npy\x1b[2J", npy("'<f8'", "(1,)", bytes(7)))], r"\.\./a"),
}


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("case", LIES)
def test_what_lies_is_refused_and_costs_nothing(case):
    members, message = LIES[case]
    refused(archive(members), message)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_other_zip_files_are_refused():
    array = npy("'<f8'", "(1,)", bytes(8))
    refused(archive([("a.npy", array), ("a.npy", array)]), "have the same name")
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        refused(archive([("a.npy", array)], method), "packed in another way")
    locked = bytearray(archive([("a.npy", array)]))
    locked[locked.index(b"PK\x01\x02") + 8] |= 1
    refused(bytes(locked), "packed in another way")


HEADERS = {
    "lists": (b'{"a": ' + b"[" * 900 + b"]" * 900 + b"}", "more than 32 lists and objects"),
    "brackets": (b"[" * 1_000_000, "more than 32 lists and objects"),
    "digits": (b'{"a": ' + b"9" * 1_000_000 + b"}", "digits"),
    "NaN": (b'{"a": NaN}', "NaN is no number"),
    "half a letter": (b'{"a": "\\ud800"}', "surrogates"),
    "other text": (b'{"a": "\xff"}', "utf-8"),
    "list": (b"[]", "no object"),
    "long": (b'{"a": "' + b"a" * (8 << 20) + b'"}', "its header has .* more than 8388608"),
}


@pytest.mark.parametrize("case", HEADERS)
def test_headers_have_limits(case):
    header, message = HEADERS[case]
    refused(archive([], header=header), message, limit=50e6)


def refused(data, message, limit=5e6):
    """A `Damaged` of one line, after at most `limit` bytes of memory."""
    stream = io.BytesIO(data)
    tracemalloc.start()
    try:
        with pytest.raises(Damaged, match=message) as problem:
            parse_archive(stream, RECORDING, "f.npz")
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()
    assert str(problem.value).isprintable()
    assert len(str(problem.value)) < 400


def test_a_file_of_5_megabytes_holds_less_than_300():
    assert max_bytes(5_000_000) < 300e6
