"""What the episodes of a policy come from: the files that its code was made of and read, as they were then.

A process that flies policies notes, by an audit hook, every file that Python opens and every folder that it lists. A
file counts for the policy that flies, and for each of the user's modules that are being run, so that what a shared
module reads once counts for every policy that uses it. Left out are the package itself, whose code is hashed as a
whole, the standard library and what is installed, compiled code of numba, and what the process has written itself.
A library that reads in C opens files without Python: so those that a text in the code names count as well. What is
named elsewhere and read in C is not noticed: `Policy.tag` is for that.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import os
import shutil
import site
import stat
import subprocess
import sys
import sysconfig
import threading
from collections.abc import Iterable, Mapping
from importlib.util import source_from_cache
from pathlib import Path
from types import FrameType
from typing import Any

import fovconn_env
from fovconn_env.baselines import Pilot
from fovconn_env.baselines.registry import source_files

Files = dict[str, str]  # path: hash of what it held, "" if there was nothing
_WRITES = os.O_WRONLY | os.O_TRUNC | os.O_APPEND  # flags of which a file that is read has none
_COMPILED = (".nbi", ".nbc")
_CHANGED = "changed"  # in the place of a hash: of a file that was read twice and was not the same


def sources(kind: type[Pilot]) -> list[Path]:
    """Files of the user's modules that a policy class is made of."""
    return [file for file in source_files(kind) if _is_users(str(file))]


def named(files: Iterable[Path]) -> list[str]:
    """Files that a text in the code of the given ones names: from the current folder, from theirs, or from a named one.

    So "w.onnx" does, and so do the two texts of `HERE / "weights" / "w.onnx"`.
    """
    found = set[str]()
    for file in (file for file in files if file.suffix == ".py"):  # weights and their card name nothing
        texts = _texts(str(file), digest(str(file)))
        folders = [os.path.realpath("."), str(file.parent)]
        for _ in range(2):
            paths = {os.path.realpath(os.path.join(folder, text)) for folder in folders for text in texts}
            found |= {path for path in paths if os.path.isfile(path) and _is_users(path)}
            folders = [path for path in paths if os.path.isdir(path)]
    return sorted(found)


@functools.lru_cache(maxsize=256)
def _texts(file: str, _: str) -> frozenset[str]:
    """Texts in the code of a file with this hash that could name something."""
    with open(file, "rb") as stream:
        nodes = ast.walk(ast.parse(stream.read()))
    texts = (node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str))
    return frozenset(text for text in texts if text.strip("./") and len(text) < 256 and "\0" not in text)


def packages(files: Iterable[Path]) -> dict[str, str]:
    """Versions of the installed packages that modules of these files use, by what they have imported."""
    wanted, names = {str(file) for file in files}, set[str]()
    for module in list(sys.modules.values()):
        if getattr(module, "__file__", None) in wanted:
            for value in vars(module).values():
                name = getattr(value, "__module__", None) or getattr(value, "__name__", "")
                names.add(str(name).partition(".")[0])
    versions = {name: getattr(sys.modules.get(name), "__version__", None) for name in sorted(names)}
    return {name: version for name, version in versions.items() if isinstance(version, str)}


def digest(path: str) -> str:
    """Hash of a file, or of the names of the files in a folder; "" for what is neither or not there."""
    try:
        about = os.stat(path)
    except (OSError, ValueError):
        return ""
    if not (stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode)):
        return ""
    return _digest(path, about.st_mtime_ns, about.st_ctime_ns, about.st_size, about.st_ino)


@functools.lru_cache(maxsize=4096)
def _digest(path: str, *state: int) -> str:
    """Once for each state of a file."""
    try:
        if os.path.isdir(path):
            names = sorted(entry.name for entry in os.scandir(path) if not entry.is_dir())
            return hashlib.sha256("/".join(names).encode("utf-8", "surrogateescape")).hexdigest()
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""


def changed(files: Mapping[str, str]) -> list[str]:
    """Those of the files that are not as they were, by name."""
    return [seen_from_here(path) for path, was in files.items() if digest(path) != was]


def merge(files: Files, more: Mapping[str, str]) -> Files:
    """Both together; a file of which they disagree is marked, so that `changed` and `torn` name it."""
    both = {**files, **more}
    return both | {path: _CHANGED for path in files.keys() & more.keys() if files[path] != more[path]}


def torn(files: Mapping[str, str]) -> list[str]:
    """Files that changed while they were read, by name."""
    return [seen_from_here(path) for path, was in files.items() if was == _CHANGED]


def seen_from_here(path: str) -> str:
    """A path as a user in the current folder would write it."""
    return path.removeprefix(os.path.join(os.path.realpath("."), ""))


def commit() -> str:
    """The commit of the source, "" outside a git repository, and where there is no git."""
    if shutil.which("git") is None:
        return ""
    here = Path(__file__).parent
    task = subprocess.run(["git", "rev-parse", "--short=12", "HEAD"], cwd=here, capture_output=True, text=True)
    return task.stdout.strip()


# --------------------------------------------------------------------------------------------- in a process that flies
class Reads:
    """The audit hook, and what it has seen. It cannot be taken off: only processes of a campaign have it."""

    def __init__(self) -> None:
        self._seen: dict[str, Files] = {}  # by the policy that flew, or the file of a module that ran
        self._first: Files = {}  # a module is loaded once: what its file held first is what runs
        self._written: set[str] = set()
        self._within = threading.local()  # the hook itself opens files
        self.policy = ""  # that flies
        sys.addaudithook(self._hook)

    def of(self, policy: str, kind: type[Pilot]) -> Files:
        """What a policy of this name and class consists of and has read in this process."""
        own = sources(kind)
        files = {path: self._first.setdefault(path, digest(path)) for path in map(str, own)}
        read: Files = {}
        for owner in (policy, *files):
            read = merge(read, self._seen.get(owner, {}))
        unread = {path: self._first.setdefault(path, digest(path)) for path in named(own)}
        files = {**unread, **read, **files}
        return {path: was for path, was in sorted(files.items()) if path not in self._written}

    def _hook(self, event: str, args: tuple) -> None:
        if event not in ("open", "os.listdir", "os.scandir", "sqlite3.connect") or not self.policy:
            return
        if getattr(self._within, "hook", False):
            return
        self._within.hook = True
        try:
            self._note(event, *args)
        except (OSError, ValueError, TypeError):  # no path: a descriptor, or what `open` itself refuses
            pass
        finally:
            self._within.hook = False

    def _note(self, event: str, path: Any, mode: Any = None, flags: int = 0) -> None:
        if isinstance(path, int):
            return
        path = os.path.realpath(os.fsdecode("." if path is None else path))
        if flags & _WRITES:
            self._written.add(path)
            return
        if path in self._written or path in sys.path or not _is_users(path):
            return
        owners, importing = _running(sys._getframe(2))
        if event in ("os.listdir", "os.scandir") and (importing or not owners):  # Python looks for modules
            return
        if path.endswith(".pyc"):
            path = source_from_cache(path)
        now = digest(path)
        self._first.setdefault(path, now)
        for owner in (self.policy, *owners):
            files = self._seen.setdefault(owner, {})
            files[path] = now if files.get(path, now) == now else _CHANGED


def _running(frame: FrameType | None) -> tuple[set[str], bool]:
    """Files of the user's code on the way to a frame, and whether Python's import stands behind the innermost one."""
    owners, importing = set[str](), False
    while frame is not None:
        name = frame.f_code.co_filename
        if not name.startswith("<") and _is_users(name := os.path.realpath(name)):
            owners.add(name)
        elif not owners and "importlib" in name:
            importing = True
        frame = frame.f_back
    return owners, importing


@functools.lru_cache(maxsize=4096)
def _is_users(path: str) -> bool:
    return not path.endswith(_COMPILED) and not any(path == root or path.startswith(root + os.sep) for root in _roots())


@functools.cache
def _roots() -> tuple[str, ...]:
    """Folders of what is not the user's own: the package, Python, what is installed, and what the system makes up."""
    package = Path(fovconn_env.__file__).parent
    ours = [package, package / "baselines", package / "training"]
    python = [sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    return tuple(
        {os.path.realpath(root) for root in (*ours, *python, site.getusersitepackages(), "/proc", "/sys", "/dev")}
    )
