"""What only compiled code calls is compiled as a part of its caller; where numba cannot, in numba's own way."""

import contextlib
import copy
import gc
import logging
import math
from typing import Any

import numba
import numpy as np
import pytest
from llvmlite import ir
from numba.core.registry import cpu_target

from fovconn_env.kernel import compiler
from fovconn_env.kernel.jit import formula, kernel, stage
from tests.helpers import JIT

pytestmark = pytest.mark.skipif(not JIT, reason="nothing is compiled")
VALUES = np.array([3.0, 4.0])


def chain():
    """A function for Python that calls others, directly and through each other; the functions that it calls."""

    @kernel
    def norm(x, y):
        return math.sqrt(x * x + y * y)

    @kernel
    def total(values):
        result = 0.0
        for k in range(len(values)):
            result += norm(values[k], 1.0)
        return result

    @stage
    def scale(values, factor):
        factor /= total(values)
        for k in range(len(values)):
            values[k] *= factor

    @formula
    def run(values):
        scale(values, 2.0)
        return norm(values[0], values[1]) + total(values)

    return run, (norm, total, scale)


def plain(values):
    scaled = values * 2.0 / np.hypot(values, 1.0).sum()
    return np.hypot(*scaled) + np.hypot(scaled, 1.0).sum()


def libraries(functions):
    return [overload.library for function in functions for overload in function.overloads.values()]


def test_parts_have_no_machine_code_of_their_own():
    run, called = chain()
    assert run(VALUES.copy()) == pytest.approx(plain(VALUES), rel=1e-14)
    assert len(libraries(called)) == 3
    assert all(isinstance(library, compiler._Part) for library in libraries(called))
    assert not any(isinstance(library, compiler._Part) for library in libraries([run]))


def test_numbas_own_way_gives_the_same_bits(monkeypatch):
    expected = chain()[0](VALUES.copy())
    monkeypatch.setattr(compiler, "is_supported", lambda: False)
    run, called = chain()
    assert run(VALUES.copy()) == expected
    assert not any(isinstance(library, compiler._Part) for library in libraries(called))


def test_a_function_of_others_may_call_parts():
    _, (norm, total, _) = chain()
    value = numba.njit(lambda values: total(values) + norm(3.0, 4.0))(VALUES)
    assert value == pytest.approx(np.hypot(VALUES, 1.0).sum() + 5.0, rel=1e-14)


def test_a_field_has_the_type_of_its_record():
    field = kernel(lambda record: record.x)
    both = formula(lambda a, b: (field(a[0]), field(b[0]), a[0].x, b[0].x))
    arrays = [np.array([(value,)], [("x", kind)]) for value, kind in ((1.5, np.float64), (7, np.int32))]
    assert both(*arrays) == (1.5, 7, 1.5, 7)
    assert numba.typeof(both(*arrays)) == numba.typeof((1.5, 7, 1.5, 7))


def test_sizes_in_memory_are_numbas():
    numbas: Any = cpu_target.target_context
    ours = copy.copy(numbas)
    ours.__class__ = compiler._Target
    number = ir.IntType(64)
    kinds = [ir.IntType(8), number, ir.ArrayType(number, 3), ir.LiteralStructType([ir.IntType(8), number])]
    for _ in range(2):
        assert [ours.get_abi_sizeof(kind) for kind in kinds] == [1, 8, 24, 16]
    assert [numbas.get_abi_sizeof(kind) for kind in kinds] == [1, 8, 24, 16]


@pytest.mark.parametrize("collects", [True, False])
@pytest.mark.parametrize("fails", [True, False])
def test_garbage_is_collected_again_after_long_code(fails, collects, monkeypatch):
    seen = []

    def compile_extra(*_):
        seen.append(gc.isenabled())
        return 1 / (not fails)

    monkeypatch.setattr(compiler.CompilerBase, "compile_extra", compile_extra)
    large = object.__new__(compiler._LargeCompiler)
    try:
        (gc.enable if collects else gc.disable)()
        with pytest.raises(ZeroDivisionError) if fails else contextlib.nullcontext():
            large.compile_extra(None)
        assert seen == [False]
        assert gc.isenabled() == collects
    finally:
        gc.enable()


def test_the_versions_tested_are_supported():
    assert compiler.is_supported()


@pytest.mark.parametrize("name", ["NativeLowering", "_LEFT_OUT", "_Large", "_Part", "_Target", "_Typing"])
def test_other_internals_are_noticed(name, monkeypatch, caplog):
    users = {"_Large": compiler._LargeCompiler, "_Part": compiler._PartCompiler}
    monkeypatch.setattr(users.get(name, compiler), "library_class" if name in users else name, object)
    with caplog.at_level(logging.DEBUG, "fovconn_env"):
        assert not compiler.is_supported.__wrapped__()
    assert "numba's own way" in caplog.text
