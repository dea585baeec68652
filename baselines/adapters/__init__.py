"""What other libraries have trained, as a policy: a module for each library, imported when it is first asked for."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from fovconn_env.errors import missing_package

SUFFIXES = {".zip": "sb3"}  # of files, and the module here that flies them


def from_path(path: Path) -> Any:
    """The policy class of a trained model, by its file's suffix; the file is opened with the first instance.

    Raises `MissingPackage` where the library is not installed.
    """
    module = SUFFIXES[path.suffix]
    try:
        adapter = importlib.import_module(f"{__name__}.{module}")
    except ModuleNotFoundError as problem:
        raise missing_package(f"policy {str(path)!r}", problem) or problem from problem
    return adapter.from_file(path.absolute())
