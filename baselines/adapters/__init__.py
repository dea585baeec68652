"""What other libraries have trained, as a policy: a module for each library, imported when it is first asked for."""

from __future__ import annotations

import functools
import importlib
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from fovconn_env.baselines.policy import make_class
from fovconn_env.errors import MissingPackage

if TYPE_CHECKING:
    from fovconn_env.baselines.adapters.model import Model


class Kind(NamedTuple):
    """A kind of trained models."""

    module: str  # here
    policy: str  # the class in it
    package: str  # to install


KINDS = {  # by a file's suffix
    ".zip": Kind("sb3", "Sb3Policy", "fovconn-env[learn]"),
    ".onnx": Kind("onnx", "OnnxPolicy", "fovconn-env[onnx]"),
    **dict.fromkeys((".pt", ".pth"), Kind("torchrl", "TorchPolicy", "fovconn-env[learn]")),
}
CHECKPOINT = Kind("rllib", "ModulePolicy", "ray[rllib]")  # a folder


def is_model(path: Path) -> bool:
    """Whether a path is that of a trained model: by its suffix, or as a folder with a checkpoint of RLlib."""
    return path.suffix in KINDS or mark(path).is_file()


def mark(folder: Path) -> Path:
    """The file by which a folder is a checkpoint of RLlib's."""
    return folder / "class_and_ctor_args.pkl"


def from_path(path: Path) -> type[Model]:
    """The policy class of a trained model, which is opened by the first instance.

    Raises `MissingPackage` where the library is not installed.
    """
    return _from_path(path.absolute())


@functools.cache  # one class, also for what was pickled
def _from_path(path: Path) -> type[Model]:
    kind, field = (CHECKPOINT, "checkpoint") if path.is_dir() else (KINDS[path.suffix], "file")
    try:
        policy: type[Model] = getattr(importlib.import_module(f"{__name__}.{kind.module}"), kind.policy)
    except ModuleNotFoundError as problem:
        needed = f'needs {problem.name}: pip install "{kind.package}"'
        raise MissingPackage(f"policy {str(path)!r} {needed}") from problem
    name = path.name if path.is_dir() else path.stem
    return make_class(name, policy, {field: path, "__doc__": policy.__doc__}, _from_path, path)
