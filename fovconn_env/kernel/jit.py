"""The decorators of compiled code, and the key by which its cache notices an edit in any kernel file.

`kernel`, `disjoint`, `stage` and `view` mark functions called from compiled code, `entry` one called from Python,
`formula` one called from both. With `NUMBA_DISABLE_JIT=1` they leave plain Python behind.
"""

# pyright: reportAttributeAccessIssue=false
# (numba.core.config fills itself from the environment)
from __future__ import annotations

import functools
import hashlib
import inspect
import logging
import re
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba import types
from numba.core import config, event
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher

from fovconn_env.kernel.cache import DiskCache
from fovconn_env.kernel.compiler import disjoint_compiler, large_compiler, part_compiler

P = ParamSpec("P")
R = TypeVar("R")
# No array is made by a kernel, so references need not be counted; counting them takes a twelfth of a step.
_OPTIONS: dict[str, Any] = {"fastmath": False, "_nrt": False}
# Of what only compiled code calls: wrappers for calls from Python and C would be compiled for nothing.
_INNER: dict[str, Any] = {
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": part_compiler,
    **_OPTIONS,
}
_PACKAGE = Path(__file__).parents[1]
if not _PACKAGE.is_dir():  # in a zip file, where neither the sources nor the weights can be read
    raise ImportError(
        "fovconn_env must be installed, and cannot be imported from a wheel as it is: pip install FILE.whl"
    )
# Stands in every file that holds compiled code.
_MARK = re.compile(
    rb"^from fovconn_env\.kernel\.jit import .*\b(?:disjoint|entry|formula|kernel|large_entry|stage|view)\b",
    re.MULTILINE,
)
_LOG = logging.getLogger("fovconn_env")  # to standard error, unless the application has set up logging
PATIENCE = 1.0  # s


class Announcement(event.Listener):
    """One log line if this package's code still compiles after `PATIENCE`; numba itself says nothing.

    What is found in the cache is not compiled, and causes no event. Compilations hold numba's global lock.
    """

    def __init__(self) -> None:
        self._depth, self._said = 0, False
        self.timer: threading.Timer | None = None

    def on_start(self, event: event.Event) -> None:
        self._depth += 1  # what a function calls is compiled within it
        module = cast("dict[str, Any]", event.data)["dispatcher"].py_func.__module__
        if self._depth == 1 and not self._said and module.startswith("fovconn_env."):
            self.timer = threading.Timer(PATIENCE, self._say, [module])
            self.timer.daemon = True
            self.timer.start()

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0 and self.timer is not None:
            self.timer.cancel()

    def _say(self, module: str) -> None:
        self._said = True
        text = "compiling %s: about 15 s on a free core, once on this machine and for each version"
        _LOG.warning(text, module)


ANNOUNCEMENT = Announcement()
event.register("numba:compile", ANNOUNCEMENT)


class _Inner(CPUDispatcher):
    """A compiled function without the wrapper that a call from Python would go through."""

    def __call__(self, *args: object, **kwargs: object) -> None:
        raise TypeError(f"{self.py_func.__qualname__} is called from compiled code only: call it in an `entry`")

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Not compiled once more for each literal among the arguments: LLVM inlines what that would gain."""
        return super().get_call_template(tuple(map(types.unliteral, args)), kws)


def _inner(dispatcher: Any) -> Any:
    if isinstance(dispatcher, CPUDispatcher):  # not with NUMBA_DISABLE_JIT=1
        dispatcher.__class__ = _Inner
    return dispatcher


class _Entry(CPUDispatcher):
    """A compiled function that Python calls; of several processes, one compiles it and the others wait for it."""

    def compile(self, sig: Any) -> Any:
        with global_compiler_lock, self._cache.turn(sig, self.targetctx):  # threads first, or two wait for each other
            return super().compile(sig)


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function that only compiled code calls. It makes no array."""
    return _inner(numba.njit(function, **_INNER))


def disjoint(function: Callable[P, R]) -> Callable[P, R]:
    """As `kernel`, for a function that writes no array that overlaps another of its arguments: its loops are faster."""
    options: dict[str, Any] = {**_INNER, "pipeline_class": disjoint_compiler}
    return _inner(numba.njit(function, **options))


def formula(function: Callable[P, R]) -> Callable[P, R]:
    """As `kernel`, for a function of numbers that Python calls as well."""
    return cast("Callable[P, R]", numba.njit(function, **_OPTIONS))


def stage(function: Callable[P, R]) -> Callable[P, R]:
    """As `kernel`, compiled into its caller: for a function that takes many arrays and is called in one place.

    Handing the arrays over would take longer than the work on them.
    """
    return _inner(numba.njit(function, forceinline=True, **_INNER))


def view(function: Callable[P, R]) -> Callable[P, R]:
    """As `kernel`, for a function that returns a part of its arguments: the caller's code holds the expression itself.

    A compiled function can return neither a record nor, here, an array.
    """
    return cast("Callable[P, R]", numba.njit(function, inline="always", **_OPTIONS))


def entry(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function that Python calls: cached on disk, without the GIL, so that threads can share the worlds."""
    return _entry(function)


def large_entry(function: Callable[P, R]) -> Callable[P, R]:
    """As `entry`, for one that calls so much that its loops are not unrolled."""
    return _entry(function, pipeline_class=large_compiler)


def _entry(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    if config.DISABLE_JIT:

        @functools.wraps(function)
        def plain(*args: P.args, **kwargs: P.kwargs) -> R:
            with np.errstate(over="ignore"):  # the counter hash wraps around on purpose
                return function(*args, **kwargs)

        return plain
    dispatcher = numba.njit(function, nogil=True, **options, **_OPTIONS)
    source = Path(inspect.getfile(function))
    if source.is_file():  # not what is typed in a notebook
        # numba looks only at the file of the function itself; this name makes an edit elsewhere visible.
        key = source_hash(compiled_files(source))
        dispatcher.__class__, dispatcher._cache = _Entry, DiskCache(function, source, _place(source), key)
    return cast("Callable[P, R]", dispatcher)


def code_of(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> Callable[P, R]:
    """The machine code with which an entry was called with these arguments, for more calls with such.

    numba looks at each argument of a call to choose the code, which takes ten times as long as the call where they are
    many arrays. This looks at none: arguments of other types are read as if they were of those. It is the entry itself
    before a call with such arguments, and with NUMBA_DISABLE_JIT=1.
    """
    if not isinstance(function, CPUDispatcher):
        return function
    result = function.overloads.get(tuple(map(function.typeof_pyval, args)))
    return function if result is None else result.entry_point


def source_hash(beside: Iterable[Path] = ()) -> str:
    """Sixteen letters that change with the layout, with any file of the kernel, and with the files `beside` them."""
    digest = hashlib.sha256()
    for file in (_PACKAGE / "layout.py", *_python_files(_PACKAGE / "kernel"), *beside):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _place(source: Path) -> str:
    """A file's name in the cache: in this package the same for all of its copies."""
    inside = _PACKAGE in source.parents
    return source.relative_to(_PACKAGE).as_posix() if inside else str(source.resolve())


def compiled_files(source: Path) -> list[Path]:
    """Files above the kernel that the compiled code of the file `source` is made of.

    In this package those of its wing (`baselines`, `flights`, ...), for no wing calls compiled code of another; for a
    file from elsewhere those of all wings, and its own folder.
    """
    if _PACKAGE in source.parents:
        return list(_folders_of_compiled_code(_PACKAGE / source.relative_to(_PACKAGE).parts[0]))
    wings = sorted(path for path in _PACKAGE.iterdir() if path.is_dir())
    return [*sorted(source.parent.glob("*.py")), *(file for wing in wings for file in _folders_of_compiled_code(wing))]


@functools.cache
def _folders_of_compiled_code(wing: Path) -> tuple[Path, ...]:
    """All .py files of the folders that hold compiled code: it takes constants from the files beside it."""
    folders = {file.parent for file in _python_files(wing) if _MARK.search(file.read_bytes())}
    return tuple(sorted(file for folder in folders for file in folder.glob("*.py")))


def _python_files(folder: Path) -> list[Path]:
    """All .py files below a folder, which may itself be a link."""
    return sorted(folder.rglob("*.py"))
