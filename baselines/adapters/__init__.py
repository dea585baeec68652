"""What other libraries have trained, as a policy: a module for each library, imported when it is first asked for."""

from __future__ import annotations

import functools
import importlib
from pathlib import Path
from typing import TYPE_CHECKING

from fovconn_env.baselines.policy import make_class
from fovconn_env.errors import missing_package

if TYPE_CHECKING:
    from fovconn_env.baselines.adapters.model import Model

# Of files, by suffix: the module here that flies them, and its class
KINDS = {".zip": ("sb3", "Sb3Policy"), ".onnx": ("onnx", "OnnxPolicy")}


def from_path(path: Path) -> type[Model]:
    """The policy class of a trained model, by its file's suffix; the file is opened by the first instance.

    Raises `MissingPackage` where the library is not installed.
    """
    return _from_path(path.absolute())


@functools.cache  # one class, also for what was pickled
def _from_path(path: Path) -> type[Model]:
    module, name = KINDS[path.suffix]
    try:
        kind: type[Model] = getattr(importlib.import_module(f"{__name__}.{module}"), name)
    except ModuleNotFoundError as problem:
        raise missing_package(f"policy {str(path)!r}", problem) or problem from problem
    return make_class(path.stem, kind, {"file": path, "__doc__": kind.__doc__}, _from_path, path)
