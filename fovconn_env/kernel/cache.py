"""Compiled code on disk: a cache that never decides whether, or what, runs.

numba's own has an index and no checksums: damage is an error or another program, two processes that write at once may
mix up their entries, and where its folder cannot be written it falls back to one that does not notice an edit in
another file. Here each compiled function and signature is a file of its own, written atomically, with a checksum.
"""

# pyright: reportAttributeAccessIssue=false
# (numba.core.config fills itself from the environment)
from __future__ import annotations

import contextlib
import getpass
import hashlib
import multiprocessing
import os
import pickle
import platform
import stat
import sys
import tempfile
import time
import uuid
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import llvmlite
import numba
import numpy as np
import platformdirs
from numba.core import config
from numba.core.caching import Cache, CompileResultCacheImpl
from numba.core.serialize import dumps

try:
    import fcntl
except ImportError:  # on Windows; processes do not wait for each other there
    fcntl = None

_VERSIONS = (sys.implementation.cache_tag, platform.system(), numba.__version__, llvmlite.__version__, np.__version__)
_DIGEST = hashlib.sha256().digest_size  # bytes at the start of a file
LONGEST = 120.0  # s that one process waits for another
_warned = False


class _Code(CompileResultCacheImpl):
    """How numba turns compiled code into data and back."""

    def __init__(self, function: Callable[..., Any], source: Path) -> None:
        self._locator, self._lineno = SimpleNamespace(_py_file=str(source)), function.__code__.co_firstlineno


class DiskCache(Cache):
    """The compiled code of one function.

    place: what tells the function from others of the same code, such as its file; key: a name that changes with all
    source code that the compiled code depends on.
    """

    def __init__(self, function: Callable[..., Any], source: Path, place: str, key: str) -> None:
        self._py_func, self._key = function, key
        self._impl = _Code(function, source)
        self._name = f"{function.__name__}-{function.__code__.co_firstlineno}"
        self._identity = (*_VERSIONS, place, function.__module__, function.__qualname__)
        self.enable()

    @property
    def cache_path(self) -> str | None:
        """The folder that is looked into first."""
        folder = next(cache_folders(), None)
        return str(folder / self._key) if folder else None

    @contextlib.contextmanager
    def turn(self, sig: Any, target_context: Any) -> Iterator[None]:
        """Hold this to compile a signature: of processes that miss it, one compiles and the others wait to load it."""
        identity = self._identify(sig, target_context.codegen())
        files = [self._file(folder, identity) for folder in cache_folders()]
        with contextlib.ExitStack() as held:
            if self._enabled and not any(file.exists() for file in files):
                for file in files[:1]:
                    _lock(file, held)
            yield

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled code for a signature, None if there is none, or none that is whole."""
        target_context.refresh()
        identity = self._identify(sig, target_context.codegen())
        for folder in cache_folders() if self._enabled else ():
            data = _read(self._file(folder, identity))
            if data is not None and data[0] == identity:
                return self._impl.rebuild(target_context, data[1])
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the compiled code for a signature into the first folder that takes it; a warning if none does."""
        if not self._enabled or not self._impl.check_cachable(data):
            return
        identity, problems = self._identify(sig, data.codegen), []
        content = dumps((identity, self._impl.reduce(data)))
        for folder in cache_folders(make=True):
            try:
                return _write(self._file(folder, identity), hashlib.sha256(content).digest() + content)
            except OSError as problem:
                problems.append(f"{folder}: {problem.strerror}")
        _warn("; ".join(problems) or "there is neither a home nor a temporary folder")

    def flush(self) -> None:
        """Forget what is on disk of this function."""
        for folder in cache_folders():
            for file in (folder / self._key).glob(f"{self._name}.*.nbc"):
                file.unlink(missing_ok=True)

    def _identify(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        """All that compiled code depends on beside the source code: versions, processor, types, closure."""
        return (*self._identity, self._index_key(sig, codegen))

    def _file(self, folder: Path, identity: tuple[Any, ...]) -> Path:
        """Types of one name may differ, so a file's own identity is compared, too."""
        return folder / self._key / f"{self._name}.{hashlib.sha256(repr(identity).encode()).hexdigest()[:24]}.nbc"


def cache_folders(*, make: bool = False) -> Iterator[Path]:
    """Folders for compiled code: `NUMBA_CACHE_DIR` or the user's cache folder, then a temporary one, if it is there.

    make: make the temporary one.
    """
    best = Path(config.CACHE_DIR) if config.CACHE_DIR else _user_folder()
    if best is not None:
        yield best
    if (folder := _temporary_folder(make)) is not None:
        yield folder


def _user_folder() -> Path | None:
    """The user's cache folder; None for a user without a home."""
    try:
        folder = Path(platformdirs.user_cache_dir("fovconn_env"))
    except (RuntimeError, KeyError):  # the user is not in the system's list
        return None
    return folder if folder.is_absolute() else None


def _temporary_folder(make: bool) -> Path | None:
    """A folder below the system's temporary one that nobody else can write to; None if there is none."""
    try:
        user = getattr(os, "getuid", getpass.getuser)()
        folder = Path(tempfile.gettempdir()) / f"fovconn_env-{user}"
        if make:
            folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return None
    private = not hasattr(os, "getuid") or (status.st_uid == user and not status.st_mode & 0o077)
    return folder if stat.S_ISDIR(status.st_mode) and private else None


def _read(file: Path) -> tuple[Any, Any] | None:
    """(identity, code) in a file; None if it is not there, not whole, or not readable here."""
    try:
        data = file.read_bytes()
    except OSError:
        return None
    if hashlib.sha256(data[_DIGEST:]).digest() != data[:_DIGEST]:
        return None
    try:
        return pickle.loads(data[_DIGEST:])
    except Exception:  # a class that it needs is gone; pickle lists no errors
        return None


def _write(file: Path, data: bytes) -> None:
    """Write a file so that others find all of it or none. Raises `OSError`, and leaves nothing then."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f"{file.name}.{uuid.uuid4().hex[:12]}.part")
    try:
        part.write_bytes(data)
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)


def _lock(file: Path, held: contextlib.ExitStack) -> None:
    """Wait until a file is there, or until no other process makes it; it is locked then, as long as `held`.

    A process that is killed gives the lock back; after `LONGEST`, and where nothing can be locked, all may make it.
    """
    end, lock = time.monotonic() + LONGEST, file.with_suffix(".lock")
    if fcntl is None:
        return
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        handle = held.enter_context(lock.open("ab"))
        held.callback(lock.unlink, missing_ok=True)
        while not file.exists() and time.monotonic() < end:
            try:
                return fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(0.05)


def _warn(why: str) -> None:
    """Say once, and not in each process of a pool, that nothing is kept."""
    global _warned
    if not _warned and multiprocessing.parent_process() is None:
        hint = "every program compiles again, for 15 s; set NUMBA_CACHE_DIR to a folder that can be written"
        warnings.warn(f"compiled code cannot be kept ({why}): {hint}", RuntimeWarning, stacklevel=2)
    _warned = True
