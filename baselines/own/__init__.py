"""Policies of one's own: modules from a file and what lies beside it, without an entry in `sys.path`.

Each folder is a package of its own, `fovconn_env.baselines.own.FOLDER`, its path quoted as in a URL. So two folders may
both have a `helper.py`, no file shadows anybody else's module, and what is defined in such a file can be pickled:
another process finds the module by its name. In these modules `import helper` means the file beside them, as in a
script, unless Python itself finds the same file.
"""

from __future__ import annotations

import builtins
import importlib
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any
from urllib.parse import quote, unquote

from fovconn_env.baselines.sources import beside, module_file, source_files, stamp

PREFIX = __name__ + "."
_loaded: dict[str, dict[Path, tuple[int, ...]]] = {}  # of a module: the stamps of its files when it was run


def load_file(file: Path) -> ModuleType:
    """The module of a file, run when first asked for, and again after a change of it or of what it imports from beside.

    Raises whatever the file's own code raises.
    """
    file = file.resolve()
    return _load(f"{package(file.parent)}.{_quote(file.stem)}", file)


def load_module(name: str, folder: Path) -> ModuleType:
    """The module of a dotted name: of the folder if it is there, else one that is installed."""
    folder = folder.resolve()
    if not all(part.isidentifier() for part in name.split(".")) or beside(folder, name.partition(".")[0]) is None:
        return importlib.import_module(name)
    file = module_file(folder.joinpath(*name.split(".")))
    if file is None or file.is_dir():
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    return _load(f"{package(folder)}.{name}", file)


def files_of(name: str) -> list[Path]:
    """The files that a loaded module's code comes from, see `source_files`; none of this package, or of typed code."""
    if name.partition(".")[0] == PREFIX.partition(".")[0] and not name.startswith(PREFIX):
        return []
    file = getattr(sys.modules.get(name), "__file__", None)
    return source_files(Path(file), _folder(name)) if file and file.endswith(".py") else []


def package(folder: Path) -> str:
    """The name of the package that stands for a folder."""
    return PREFIX + _quote(folder.as_posix())


def _load(name: str, file: Path) -> ModuleType:
    stamps = {path: stamp(path) for path in source_files(file, _folder(name))}
    if name in sys.modules and _loaded.get(name) == stamps:
        return sys.modules[name]
    for key, value in list(sys.modules.items()):
        if key.startswith(PREFIX) and Path(getattr(value, "__file__", None) or "") in stamps:
            del sys.modules[key]
    importlib.invalidate_caches()
    module = importlib.import_module(name)
    _loaded[name] = stamps
    return module


def _quote(text: str) -> str:
    quoted = quote(text, safe="", errors="surrogateescape")  # paths need not be UTF-8
    return quoted.replace(".", "%2E")  # a dot would part the name of a module


def _unquote(text: str) -> str:
    return unquote(text, errors="surrogateescape")


def _folder(name: str) -> Path | None:
    """The folder of a module's package; None for a module of Python's own."""
    return Path(_unquote(name.removeprefix(PREFIX).partition(".")[0])) if name.startswith(PREFIX) else None


class _Finder(MetaPathFinder):
    """Finds packages of folders, and modules in them."""

    def find_spec(self, fullname: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if not fullname.startswith(PREFIX):
            return None
        folder, *below = fullname.removeprefix(PREFIX).split(".")
        place = Path(_unquote(folder), *map(_unquote, below))
        file = place.with_name(f"{place.name}.py")
        if (place / "__init__.py").is_file() and below:
            file, search = place / "__init__.py", [str(place)]
        elif file.is_file() and below:
            search = None
        elif place.is_dir():
            spec = ModuleSpec(fullname, None, is_package=True)
            spec.submodule_search_locations = [str(place)]
            return spec
        else:
            return None  # a compiled extension perhaps, which Python itself finds
        loader = _Loader(fullname, str(file))
        return spec_from_file_location(fullname, file, loader=loader, submodule_search_locations=search)


class _Loader(SourceFileLoader):
    """Runs a file with an `import` that looks beside it first."""

    def get_code(self, fullname: str) -> CodeType:
        """The code of the file as it is now: stored bytecode would hide an edit within the same second."""
        return self.source_to_code(self.get_data(self.path), self.path)

    def exec_module(self, module: ModuleType) -> None:
        vars(module)["__builtins__"] = {**vars(builtins), "__import__": _import_beside}
        super().exec_module(module)


def _import_beside(
    name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
) -> ModuleType:
    """`import` as a module of this package sees it."""
    folder = _folder(globals.get("__name__", "")) if globals and level == 0 else None
    top = name.partition(".")[0]
    if folder is None or beside(folder, top) is None:
        return builtins.__import__(name, globals, locals, fromlist, level)
    here = package(folder)
    module = builtins.__import__(f"{here}.{name}", globals, locals, fromlist, 0)
    return module if fromlist else sys.modules[f"{here}.{top}"]


sys.meta_path.insert(0, _Finder())
