"""How numba compiles the kernels: each function once, as a part of what Python calls.

numba optimises each function together with all that it calls, and makes machine code of it, before its caller takes it
in and does so again: a chain of calls is compiled at each of its links. Here a function stays LLVM code by itself. Its
caller links it with all that it calls, and what Python calls is optimised once, as a whole. The bits are the same.

This needs internals of numba. Where they differ, all is compiled in numba's own way, more slowly.
"""

from __future__ import annotations

import functools
import gc
import logging
from types import SimpleNamespace
from typing import Any

import llvmlite.binding as llvm
import numba
from numba import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.cpu import CPUContext
from numba.core.typed_passes import NativeLowering
from numba.extending import models, register_model

_LOG = logging.getLogger("fovconn_env")


def part_compiler(*args: Any) -> CompilerBase:
    """A compiler of what only compiled code calls."""
    return _PartCompiler(*args) if is_supported() else Compiler(*args)


def disjoint_compiler(*args: Any) -> CompilerBase:
    """As `part_compiler`, of what writes no array that overlaps another of its arguments."""
    return _DisjointCompiler(*args) if is_supported() else Compiler(*args)


def large_compiler(*args: Any) -> CompilerBase:
    """A compiler of long code that Python calls."""
    return _LargeCompiler(*args) if is_supported() else Compiler(*args)


@functools.cache
def is_supported() -> bool:
    """Whether this numba has the internals needed: decided once, by compiling a chain of calls."""
    options: dict[str, Any] = {"_nrt": False}
    inner = {**options, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    try:
        square: Any = numba.njit(lambda x: x * x, pipeline_class=_DisjointCompiler, **inner)
        shifted: Any = numba.njit(lambda x: square(x) + 1.0, pipeline_class=_PartCompiler, **inner)
        both: Any = numba.njit(lambda x: shifted(x) + square(x), pipeline_class=_LargeCompiler, **options)
        return both(3.0) == 19.0
    except Exception as problem:  # internals that differ may fail in any way
        _LOG.debug("kernels are compiled in numba's own way, more slowly: %r", problem)
        return False


# ------------------------------------------------------------------------------------------------------ LLVM's share
class _Part(JITCodeLibrary):
    """The LLVM code of one function: neither linked, nor optimised as a whole, nor made machine code of."""

    @property
    def codegen(self) -> Any:
        """What writes into the machine code: there is none."""
        return SimpleNamespace(set_env=lambda *_: None)

    def _optimize_functions(self, _: Any) -> None:
        """All that it calls is optimised in the library that it becomes a part of."""

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


class _Large(JITCodeLibrary):
    """Long code: no loop is unrolled, which takes a third of LLVM's time and brings nothing."""

    def _optimize_final_module(self) -> None:
        options = llvm.create_pipeline_tuning_options(speed_level=3)
        options.loop_unrolling = options.slp_vectorization = False
        options.loop_vectorization = True  # brings an eighth of a step of 48 robots
        builder = llvm.create_pass_builder(self._codegen._tm, options)
        builder.getModulePassManager().run(self._final_module, builder)


# ----------------------------------------------------------------------------------------------------- numba's share
class _Function(types.Function):
    """An operator or builtin function that remembers its signatures: numba tries all that there are, at each call."""

    def __init__(self, templates: Any) -> None:
        super().__init__(templates)
        self._signatures: dict[tuple[Any, ...], Any] = {}

    def get_call_type(self, context: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        context = getattr(context, "numbas", context)
        if kws:
            return super().get_call_type(context, args, kws)
        if args not in self._signatures:
            self._signatures[args] = super().get_call_type(context, args, kws)
        return self._signatures[args]


register_model(_Function)(models.OpaqueModel)
_function = functools.cache(_Function)  # by templates; numba forgets a type that nothing refers to
_attributes: dict[tuple[types.Record, str], Any] = {}  # types of the fields of records


class _Typing:
    """numba's typing context, with `_Function`."""

    def __init__(self, context: Any) -> None:
        self.numbas = context

    def __getattr__(self, name: str) -> Any:
        return getattr(self.numbas, name)

    def resolve_value_type(self, value: Any) -> Any:
        resolved = self.numbas.resolve_value_type(value)
        return _function(resolved.templates) if type(resolved) is types.Function else resolved

    def resolve_function_type(self, function: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        if not isinstance(function, types.Type):  # what Python calls, such as operator.getitem
            kind = self.numbas._lookup_global(function)
            function = _function(kind.templates) if type(kind) is types.Function else function
        if isinstance(function, (types.Function, types.Dispatcher)):  # they have no attribute `__call__` to look for
            return function.get_call_type(self.numbas, args, kws)
        return self.numbas.resolve_function_type(function, args, kws)

    def resolve_getattr(self, typ: Any, attr: str) -> Any:
        if not isinstance(typ, types.Record):
            return self.numbas.resolve_getattr(typ, attr)
        key = typ, attr
        if key not in _attributes:
            _attributes[key] = self.numbas.resolve_getattr(typ, attr)
        return _attributes[key]


# numba's passes over what a kernel has none of: closures, literals of other types in one loop, arrays made, references
# counted (IRLegalization marks where each variable is used last); and those that only check or describe.
_LEFT_OUT = (
    "AnnotateTypes",
    "DumpParforDiagnostics",
    "FindLiterallyCalls",
    "InlineClosureLikes",
    "IRLegalization",
    "LiteralPropagationSubPipelinePass",
    "LiteralUnroll",
    "MakeFunctionToJitFunction",
    "NoPythonSupportedFeatureValidation",
    "NopythonRewrites",
    "RewriteDynamicRaises",
    "WithLifting",
)


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    _name = "lowering_of_fovconn_env"

    def run_pass(self, state: Any) -> bool:
        state.library = state.pipeline.library_class(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().run_pass(state)


class _Target(CPUContext):
    """numba's target context without what it does again for each array and each variable."""

    def get_abi_sizeof(self, ty: Any) -> int:
        """Remembered: LLVM reads a module for each."""
        key = str(ty)
        if key not in _sizes:
            _sizes[key] = super().get_abi_sizeof(ty)
        return _sizes[key]

    def get_function(self, fn: Any, sig: Any, _firstcall: bool = True) -> Any:
        """Not searched twice for what makes an array of an array, which no array has, and each is asked for."""
        return super().get_function(fn, sig, _firstcall and fn != "__array__")


_sizes: dict[str, int] = {}  # bytes


class _Compiler(CompilerBase):
    """numba's compiler, with a library of another class, and without the passes that kernels do not need."""

    library_class: type[JITCodeLibrary]

    def __init__(self, typingctx: Any, *args: Any) -> None:
        super().__init__(typingctx, *args)
        self.state.typingctx = self.state.targetctx.typing_context = _Typing(typingctx)
        self.state.targetctx.__class__ = _Target  # it is a copy for this compiler

    def define_pipelines(self) -> list[PassManager]:
        pipeline = DefaultPassBuilder.define_nopython_pipeline(self.state, "fovconn_env")
        if NativeLowering not in dict(pipeline.passes):
            raise LookupError("numba's pipeline has other passes")
        passes = [(step, text) for step, text in pipeline.passes if step.__name__ not in _LEFT_OUT]
        pipeline.passes = [(_Lowering if step is NativeLowering else step, text) for step, text in passes]
        pipeline.finalize()
        return [pipeline]


class _PartCompiler(_Compiler):
    library_class = _Part


class _DisjointCompiler(_PartCompiler):
    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.state.flags.noalias = True  # or each loop over arrays begins with a test whether they overlap


class _LargeCompiler(_Compiler):
    library_class = _Large

    def compile_extra(self, func: Any) -> Any:
        """Compile without collecting garbage: that would take an eighth of the time, and free 0.1 GiB."""
        collects = gc.isenabled()
        gc.disable()
        try:
            return super().compile_extra(func)
        finally:
            if collects:
                gc.enable()
