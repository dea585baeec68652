"""The examples with the libraries they are for: `make test-integrations`. Skipped where the library is missing."""

import importlib.util
import re
import shlex
import subprocess
import sys
import warnings
from pathlib import Path
from types import ModuleType

import numpy as np

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs" / "examples"
RECIPES = sorted((ROOT / "docs" / "recipes").glob("*.md"))
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


def commands_of(title: str, word: str, page: str = "policies") -> list[str]:
    """Calls of fovconn in the shell blocks of a section of a page, those with a word in them."""
    text = (ROOT / "docs" / f"{page}.md").read_text("utf-8")
    section = text.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    blocks = re.findall(r"^```sh\n(.*?)^```$", section, re.DOTALL | re.MULTILINE)
    lines = [line.partition("  #")[0] for block in blocks for line in block.splitlines()]
    return [line for line in lines if line.startswith("fovconn ") and word in line]


def fovconn(line: str, folder: Path) -> subprocess.CompletedProcess:
    """Run a line as typed in a folder, in a process of its own."""
    words = [sys.executable, "-m", "fovconn_env.training.cli", *shlex.split(line)[1:]]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True)
