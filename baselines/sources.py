"""Which files a policy's code comes from, read from its `import` statements; nothing is run."""

from __future__ import annotations

import ast
import functools
import importlib.util
import site
import sysconfig
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from pathlib import Path

_ROOM = __name__.partition(".")[0]


def source_files(file: Path, folder: Path | None) -> list[Path]:
    """A file and all those that it imports, directly or through others, in the order in which they are named.

    folder: where `import` looks first, None for a module that Python itself has found. What is installed is left out
    (the standard library, site-packages), and so is this package. A module that is imported by a computed name is not
    found.
    """
    found: dict[Path, Path | None] = {}
    waiting = [(file.resolve(), folder)]
    while waiting:
        path, base = waiting.pop(0)
        if path not in found:
            found[path] = base
            waiting += [each for name in _imports(path, stamp(path)) for each in _resolve(name, path, base)]
    return list(found)


def beside(folder: Path, top: str) -> Path | None:
    """The file or folder of the top-level module `top` in a folder; None if Python itself finds that or another.

    Another is found by Python itself only where the folder has nothing but a plain folder of that name.
    """
    place = module_file(folder / top)
    if top == _ROOM or place is None:
        return None
    spec = _spec(top)
    if spec is None:
        return place
    same = spec.origin is not None and spec.has_location and Path(spec.origin).resolve() == place.resolve()
    return None if same or place.is_dir() else place


def module_file(place: Path) -> Path | None:
    """The file of the module at a place without its ending; the folder itself where it is a plain one."""
    for file in (place / "__init__.py", place.with_name(f"{place.name}.py")):
        if file.is_file():
            return file
    return place if place.is_dir() else None


def _spec(top: str) -> ModuleSpec | None:
    try:
        return importlib.util.find_spec(top)
    except (ImportError, ValueError):  # ValueError: it has none, such as `__main__`
        return None


def stamp(file: Path) -> tuple[int, ...]:
    """What changes with a file: its times (ns) and its size."""
    status = file.stat()
    return status.st_mtime_ns, status.st_ctime_ns, status.st_size


@functools.lru_cache(maxsize=1024)
def _imports(file: Path, _: tuple[int, ...]) -> list[tuple[int, str]]:
    """Level and dotted name of each module that a file, with this stamp, may import, also within functions."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):
        return []  # it does not load either
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [(0, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            below = [f"{node.module or ''}.{alias.name}".strip(".") for alias in node.names]
            names += [(node.level, dotted) for dotted in (node.module or "", *below)]
    return names


def _resolve(name: tuple[int, str], file: Path, folder: Path | None) -> Iterator[tuple[Path, Path | None]]:
    """Files of a dotted name and of the packages above it, as `file` imports it."""
    level, dotted = name
    parts = dotted.split(".") if dotted else []
    if level:
        root = file.parents[level - 1]
    elif parts and folder is not None and beside(folder, parts[0]) is not None:
        root = folder
    else:
        folder, spec = None, _spec(parts[0]) if parts[0] != _ROOM else None
        if spec is None or not (spec.has_location or spec.submodule_search_locations):
            return
        root = Path(spec.origin or next(iter(spec.submodule_search_locations or ()))).parent
        root = root.parent if spec.submodule_search_locations and spec.origin else root
    places = [root.joinpath(*parts[:end]) for end in range(1, len(parts) + 1)]
    for found in (root / "__init__.py" if level else None, *map(module_file, places)):
        if found is not None and found.is_file() and not _is_installed(found.resolve()):
            yield found.resolve(), folder


def _is_installed(file: Path) -> bool:
    return any(root in file.parents for root in _installed_roots())


@functools.cache
def _installed_roots() -> tuple[Path, ...]:
    paths = [sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    return tuple(Path(path).resolve() for path in (*paths, *site.getsitepackages(), site.getusersitepackages()))
