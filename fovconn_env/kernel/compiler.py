"""How functions that only compiled code calls are compiled: once, as a part of the entry that calls them.

numba optimises each function together with all that it calls, and makes machine code of it, before its caller takes it
in and does so again: a chain of calls is compiled at each of its links. Here a function stays LLVM code by itself. Its
caller links it with all that it calls, and what Python calls is optimised once, as a whole. The bits are the same.

This needs internals of numba. Where they differ, all is compiled in numba's own way, more slowly.
"""

from __future__ import annotations

import functools
import logging
from types import SimpleNamespace
from typing import Any

import numba
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import NativeLowering

_LOG = logging.getLogger("fovconn_env")


class _Part(JITCodeLibrary):
    """The LLVM code of one function: neither linked, nor optimised as a whole, nor made machine code of."""

    @property
    def codegen(self) -> Any:
        """What writes into the machine code: there is none."""
        return SimpleNamespace(set_env=lambda *_: None)

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0

    def finalize(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"  # others may bring it along, too
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        self._ensure_finalized()
        if self._shared_module is None:
            self._shared_module = self._final_module.clone()
            for library in list(self._callees({self: None}))[1:]:
                part = isinstance(library, _Part)
                module = library._final_module if part else library._get_module_for_linking()
                self._shared_module.link_in(module, preserve=True)
        return self._shared_module

    def _callees(self, found: dict[Any, None]) -> dict[Any, None]:
        """Add all that it calls, directly or not, to those found."""
        for library in self._linking_libraries:
            if library not in found:
                found[library] = None
                if isinstance(library, _Part):
                    library._callees(found)
        return found


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    _name = "lowering_to_a_part"

    def run_pass(self, state: Any) -> bool:
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().run_pass(state)


class PartCompiler(CompilerBase):
    """numba's compiler, with `_Part` for a library where this numba knows how."""

    def define_pipelines(self) -> list[PassManager]:
        return [
            _part_pipeline(self.state) if is_supported() else DefaultPassBuilder.define_nopython_pipeline(self.state)
        ]


class _UncheckedCompiler(CompilerBase):
    def define_pipelines(self) -> list[PassManager]:
        return [_part_pipeline(self.state)]


def _part_pipeline(state: Any) -> PassManager:
    pipeline = DefaultPassBuilder.define_nopython_pipeline(state, "part")
    lowering = [(_PartLowering if step is NativeLowering else step, text) for step, text in pipeline.passes]
    if lowering == pipeline.passes:
        raise LookupError("numba's pipeline has no NativeLowering")
    pipeline.passes = lowering
    pipeline.finalize()
    return pipeline


@functools.cache
def is_supported() -> bool:
    """Whether this numba has the internals needed: decided once, by compiling a chain of calls."""
    options: dict[str, Any] = {"_nrt": False}
    inner = {**options, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": _UncheckedCompiler}
    try:
        square: Any = numba.njit(lambda x: x * x, **inner)
        shifted: Any = numba.njit(lambda x: square(x) + 1.0, **inner)
        both: Any = numba.njit(lambda x: shifted(x) + square(x), **options)
        return both(3.0) == 19.0
    except Exception as problem:  # internals that differ may fail in any way
        _LOG.debug("kernels are compiled in numba's own way, more slowly: %r", problem)
        return False
