"""The examples with the libraries they are for: `make test-integrations`. Skipped where the library is missing."""

import importlib.util
import sys
import warnings
from pathlib import Path
from types import ModuleType

import numpy as np

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SHORT = {"warmup": 0.1, "max_cycles": 8}  # settings of a scenario: episodes of 8 steps, ended by time


def example(name: str) -> ModuleType:
    """A script of docs/examples, imported and not run."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)  # there for pickle
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the library says about itself while it is imported
        spec.loader.exec_module(module)
    return module


def weights(module) -> np.ndarray:
    """All parameters of a torch module in one vector, copied."""
    return np.concatenate([part.detach().cpu().numpy().ravel() for part in module.parameters()])


def assert_learned(before: np.ndarray, after: np.ndarray) -> None:
    """The parameters are others than before, and finite."""
    assert before.shape == after.shape
    assert np.isfinite(after).all()
    assert (before != after).mean() > 0.5
