"""Memory asked for before it is read: while one world is stepped, what the step of the next one reads comes nearer."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, config, types
from numba.extending import intrinsic

LINE = 64  # bytes that come at once
_BYTE, _FLAG = ir.IntType(8).as_pointer(), ir.IntType(32)
_KIND = ir.FunctionType(ir.VoidType(), [_BYTE, _FLAG, _FLAG, _FLAG])
_READ, _SECOND_LEVEL, _DATA = _FLAG(0), _FLAG(2), _FLAG(1)


@intrinsic
def _prefetch(typing: Any, memory: Any) -> Any:
    """Ask for the memory of an array or a record; nothing is read or changed."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if isinstance(memory, types.Record):
            start, size = arguments[0], context.get_constant(types.intp, memory.size)
        else:
            array = context.make_array(memory)(context, builder, arguments[0])
            start, size = array.data, builder.mul(array.nitems, array.itemsize)
        start, one = builder.bitcast(start, _BYTE), size.type(1)
        ask = builder.module.declare_intrinsic("llvm.prefetch", [_BYTE], _KIND)
        flags = _READ, _SECOND_LEVEL, _DATA
        with cgutils.for_range_slice(builder, size.type(0), size, size.type(LINE), size.type) as (offset, _):
            builder.call(ask, [builder.gep(start, [offset]), *flags])
        builder.call(ask, [builder.gep(start, [builder.sub(size, one)]), *flags])  # the end is in another line
        return context.get_dummy_value()

    return types.none(memory), generate


def _nothing(memory: Any) -> None:
    """Plain Python asks for nothing."""


prefetch: Any = _nothing if config.DISABLE_JIT else _prefetch
