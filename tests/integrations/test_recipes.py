"""docs/recipes: what a page prints runs from top to bottom, with fewer steps; what it trains is a policy."""

import dataclasses
import os
import re
import subprocess
import sys
import warnings
from importlib import util
from pathlib import Path

import pytest

from fovconn_env import PRESETS, scenario
from fovconn_env.baselines import load_policy
from tests.integrations import RECIPES, ROOT

pytest.importorskip("torch")

OURS = {"sb3": "stable_baselines3", "rllib": "ray", "benchmarl": "benchmarl"}  # what rooms of training import
NEEDS = {"rllib_ppo": "ray", "benchmarl_task": "benchmarl", "torchrl_ppo": "torchrl", "skrl_ippo": "skrl"}  # scripts
NEEDS |= {"supersuit_sb3": "supersuit", "fovconn_env.training.benchmarl": "benchmarl"}
FEWER = {  # by page: what stands there, and what is run in its place
    "sb3": {
        "STEPS = 5_000_000": "STEPS = 2_000",
        "OFF_STEPS = 300_000": "OFF_STEPS = 400",
        "buffer_size=300_000, learning_starts=5_000": "buffer_size=500, learning_starts=100",
        "n_worlds=64": "n_worlds=2",
        "FRAMES = 400": "FRAMES = 4",
    },
    "sb3_contrib": {
        "STEPS = 1_000_000": "STEPS = 1",
        "OFF_STEPS = 300_000": "OFF_STEPS = 400",
        "buffer_size=300_000, learning_starts=5_000": "buffer_size=500, learning_starts=100",
        "n_worlds=16": "n_worlds=2",
    },
    "cleanrl": {"--robot-steps 5000000": "--robot-steps 1 --worlds 2"},
    "gymnasium": {"--worlds 64 --steps 3000": "--worlds 2 --steps 50"},
    "torchrl": {"--iterations 50": "--iterations 1 --worlds 1"},
    "skrl": {"--steps 20000": "--steps 600"},
    "supersuit": {"--robot-steps 100000": "--robot-steps 1 --worlds 1"},
    "rllib": {"--iterations 20": "--iterations 1 --steps 96", "--runners 2": "--runners 0"},
    "benchmarl": {
        "--iterations 50": "--iterations 1",
        "experiment.max_n_frames=600_000": "experiment.max_n_frames=600 task.max_cycles=8 "
        "experiment.on_policy_collected_frames_per_batch=300 experiment.on_policy_minibatch_size=300 "
        "experiment.evaluation_interval=300 experiment.evaluation_episodes=1 experiment.on_policy_n_minibatch_iters=1",
    },
    "data": {"50000-50063": "50000", "UPDATES = 20_000": "UPDATES = 5"},
}
FLIGHT = " --seeds 0 --processes 1 --set max_cycles=8 --set warmup=0.1"  # in place of 32 whole ones
PATH = {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def parts(page: Path) -> list[tuple[str, str]]:
    """The code of a page, in order: ("py", a block) and ("sh", a line that runs without another machine)."""
    text = page.read_text("utf-8")
    for stands, fewer in FEWER.get(page.stem, {}).items():
        assert stands in text, f"{page.name} has no {stands!r}"
        text = text.replace(stands, fewer)
    found: list[tuple[str, str]] = []
    for language, block in re.findall(r"^```(py|sh)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        lines = block.replace("\\\n", " ").splitlines() if language == "sh" else [block]
        found += [(language, line) for line in lines if language == "py" or runs_here(line)]
    return found


def runs_here(line: str) -> bool:
    """Whether a line of a shell neither installs nor needs a cluster."""
    return re.match(r"(\w+=\w+ )?(python|fovconn) ", line) is not None and "--address" not in line


def needed(language: str, code: str) -> list[str]:
    """Libraries that a part imports, as far as they may be missing."""
    if language == "sh":
        return [library for name, library in NEEDS.items() if name in code]
    ours = [library for room, library in OURS.items() if f"fovconn_env.training.{room}" in code]
    return [*re.findall(r"^(?:from|import) (\w+)", code, re.M), *ours]


def run(line: str, folder: Path) -> None:
    """A line of a shell, as typed in the folder."""
    done = subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True, env=os.environ | PATH)
    assert done.returncode == 0, f"{line}\n{done.stderr}"


@pytest.mark.parametrize("page", RECIPES, ids=lambda page: page.stem)
def test_a_recipe_runs_from_top_to_bottom(page, tmp_path, monkeypatch):
    for name, preset in PRESETS.items():
        monkeypatch.setitem(PRESETS, name, dataclasses.replace(preset, max_cycles=20, warmup=0.1))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    code = parts(page)
    missing = {name for part in code for name in needed(*part) if util.find_spec(name) is None} - {"torch_geometric"}
    if missing:
        pytest.skip(f"{', '.join(sorted(missing))} is not installed")
    namespace = {"__name__": "example"}
    for language, part in code:
        if language == "sh":
            run(part + (FLIGHT if "eval --suite" in part else ""), tmp_path)
        elif "torch_geometric" not in part or util.find_spec("torch_geometric"):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the libraries' tests say which of theirs are expected
                exec(compile(part, page.name, "exec"), namespace)
    for file in (*tmp_path.glob("*.zip"), *tmp_path.glob("*/*.zip"), *tmp_path.glob("*.pt")):
        load_policy(file, scenario("LeaderFollow-v0"))
    assert not [name for name in os.listdir(ROOT) if name in {"runs", "films", "model.zip"}]


@pytest.mark.parametrize("page", [page for page in RECIPES if page.stem != "curves"], ids=lambda page: page.stem)
def test_every_recipe_ends_with_the_same_two_lines(page):
    """The suite, and a flight of it, whose file the first one writes."""
    last = page.read_text("utf-8").rpartition("\n## ")[2]
    policy = re.search(r"--policy (\S+)", last)[1]
    name = Path(policy).stem
    assert last == (
        "Evaluate it, look at a flight\n\n```sh\n"
        f"fovconn eval --suite quick --only expert --policy {policy} --record flights\n"
        f"fovconn replay flights/{name}@LeaderFollow-v0-0.npz --out flight.html\n```\n"
    )
