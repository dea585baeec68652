"""What a user waits for, as whole processes of this tree and of another one in turn.

The first step with nothing compiled, the demo and the suite in a fresh clone, an evaluation. `make` takes Python and
the package index from this process; a clone holds what is committed.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from fovconn_env.training.bench.trees import check_tree
from fovconn_env.training.evaluation.campaign import SUITES

# Programs find this tree's rooms or those of 0.1.0.
FIRST_STEP = """
import sys
import fovconn_env
try:
    from fovconn_env.baselines import load_policy
except ImportError:
    from baselines import load_policy
env = fovconn_env.parallel_env(sys.argv[1])
policy = load_policy("expert", env)
observations, _ = env.reset(seed=1)
env.step({agent: policy.act(observations[agent]) for agent in env.agents})
"""
COMMAND = """
try:
    from fovconn_env.training.cli import main
except ImportError:
    from training.cli import main
if __name__ == "__main__":
    main()
"""
# The policies that every tree since 0.1.0 has, for an evaluation of which both trees fly the same.
FLOWN = (
    *("zero", "random", "follow", "springs", "omni", "both-look", "expert-no-yaw", "expert", "expert-flooding"),
    *("augmented", "cohesive", "recovery", "oracle", "oracle-all-seeing", "dagger", "ppo", "residual"),
)


class Wait(NamedTuple):
    """A command that somebody waits for.

    words: the command, in the folder it runs in; clone: it runs in a fresh clone, not beside the tree; warm: it runs
    once before it is timed, and what that compiled is kept.
    """

    key: str
    name: str
    words: Sequence[str]
    clone: bool = False
    warm: bool = False


class Spent(NamedTuple):
    """Seconds of a command: on the clock, and of processors, its children's included."""

    wall: float
    cpu: float


KEYS = ("cold", "demo", "eval", "suite")


def waits(base: str) -> list[Wait]:
    """What can be timed, in the order of `KEYS`; base: the preset of the first step."""
    python = [sys.executable, "-P", "-c"]
    scenarios, seeds, _ = SUITES["quick"]
    cells = [("--policy", policy) for policy in FLOWN] + [("--scenario", scenario) for scenario in scenarios]
    words = [*itertools.chain(*cells), "--seeds", f"{seeds[0]}-{seeds[-1]}"]
    evaluate = [*python, COMMAND, "eval", *words, "--out", "out"]
    return [
        Wait("cold", f"first step of {base}, nothing compiled", [*python, FIRST_STEP, base]),
        Wait("demo", "make demo, fresh clone", ["make", "demo", f"PYTHON={sys.executable}"], clone=True),
        Wait("eval", "eval, quick suite of 0.1.0, compiled", evaluate, warm=True),
        Wait("suite", "make test, fresh clone", ["make", "test", f"PYTHON={sys.executable}"], clone=True),
    ]


def compare_waits(
    trees: Sequence[Path],
    chosen: Sequence[Wait],
    repetitions: int,
    progress: Callable[[str, int, int], None] = lambda name, done, total: None,
) -> Iterator[tuple[Wait, list[list[Spent]]]]:
    """Time commands in trees that take turns: with each command, for each repetition a `Spent` for each tree.

    `progress` is told the name of what comes next, the commands done and those in all. Raises `RuntimeError` with the
    end of what a command said if it fails.
    """
    for tree in trees:
        check_tree(tree)
    total = sum((repetitions + wait.warm) * len(trees) for wait in chosen)
    done = 0
    for wait in chosen:
        with tempfile.TemporaryDirectory(prefix="fovconn-bench-") as kept:
            rounds = []
            for repetition in range(-1 if wait.warm else 0, repetitions):
                order = range(len(trees)) if repetition % 2 == 0 else reversed(range(len(trees)))
                spent = {}
                for k in order:
                    progress(f"{wait.name}: {trees[k].name}", done, total)
                    spent[k] = _time(wait, trees[k], Path(kept) / str(k) if wait.warm else None)
                    done += 1
                if repetition >= 0:
                    rounds.append([spent[k] for k in range(len(trees))])
        yield wait, rounds


def _time(wait: Wait, tree: Path, compiled: Path | None) -> Spent:
    """Run a command once, in an empty folder or a clone; `compiled`: where compiled code is kept, None for nowhere."""
    with tempfile.TemporaryDirectory(prefix="fovconn-bench-") as name:
        folder, inside = Path(name), Path(name) / "work"
        variables = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "MAKEFLAGS")}
        variables["NUMBA_CACHE_DIR"] = str(compiled or folder / "compiled")
        if wait.clone:
            _run(["git", "clone", "--quiet", str(tree.resolve()), str(inside)], folder, variables)
        else:
            inside.mkdir()
            variables["PYTHONPATH"] = str(tree.resolve())
        began, before = time.perf_counter(), os.times()
        _run(wait.words, inside, variables)
        after = os.times()
        cpu = after.children_user + after.children_system - before.children_user - before.children_system
        return Spent(time.perf_counter() - began, cpu)


def _run(words: Sequence[str], folder: Path, variables: Mapping[str, str]) -> None:
    """Run a command to its end, its output kept for the case that it fails."""
    task = subprocess.run(words, cwd=folder, env=variables, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if task.returncode:
        said = task.stdout.decode("utf-8", "replace")[-2000:]
        raise RuntimeError(f"{' '.join(words[:2])} ... failed:\n{said}")
