"""Speed of this tree and of another tree: they take turns, so that a drift of the machine affects both.

Both run the cases of this tree, each on its own code, and make the same calls: equal flights, if the trees are equal.
"""

from __future__ import annotations

import runpy
import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from fovconn_env.training.bench.cases import Effort
from fovconn_env.training.bench.report import Bar, judged, versions
from fovconn_env.training.bench.trees import HERE, Pipes, running
from fovconn_env.training.bench.waits import KEYS, compare_waits, waits
from fovconn_env.training.evaluation.record import machine

LAPS = ("parallel", "vector", "expert", "dynamics", "reset", "density", "train")  # cases that run in older trees, too
PAIRED = (*LAPS, *KEYS)
USUAL = ("parallel", "vector")  # timed where none is named
LAP = 2e-3  # s, at least one call: a short lap is seldom interrupted, so that a median leaves the busy ones out
LEAST = 0.98  # a change that costs more speed than this must say why
FIRST = "0.1.0"  # beside it, these hold
GOALS = {
    "cold": 0.5,
    "cold cpu": 0.58,
    "demo": 0.72,
    "eval": 1.0 / 1.5,
    "suite": 0.6,
    "vector 1024": 4.5 / 3.5,
    "parallel": 1.3,
    "kinematic N=24": 1.0 / 0.75,
    "kinematic N=48": 1.0 / 0.75,
    "ppo set": 1.7,
    "ppo mlp": 1.5,
    "dagger set": 1.3,
}
CASES = Path(__file__).with_name("cases.py")

# `load_policy` and `VectorEnv` come from PRELUDE, which finds them in older trees, too.
TIME = """
import ast, gc, importlib, types

sys.modules.setdefault("fovconn_env.baselines", types.SimpleNamespace(load_policy=load_policy))
sys.modules.setdefault("fovconn_env.envs.vector", types.SimpleNamespace(VectorEnv=VectorEnv))
if "train" in arguments["groups"] and fovconn_env.__version__ == "0.1.0":
    for new, old in ("ppo", "ppo"), ("dagger", "dagger"), ("model", "learning"):
        sys.modules[f"fovconn_env.training.learn.{new}"] = importlib.import_module(f"training.{old}")
names = {"__name__": "cases"}
exec(compile(arguments["source"], "cases.py", "exec"), names)
chosen = scenario(arguments["scenario"], **ast.literal_eval(arguments["settings"]))
effort = names["Effort"](**arguments["effort"])
chosen_plans = [plan for plan in names["plans"](chosen, effort, []) if plan.group in arguments["groups"]]
cases = {plan.key: plan.make() for plan in chosen_plans}
gc.collect()
gc.freeze()
print(json.dumps([[plan.key, plan.name] for plan in chosen_plans]), flush=True)
for line in sys.stdin:
    key, calls = json.loads(line)
    seconds = sum(cases[key].call()[0] for _ in range(calls))
    print(json.dumps([seconds, calls * cases[key].steps]), flush=True)
"""


class Ratio(NamedTuple):
    """Speed of a case relative to the other tree, or with `at_most` time: one value a repetition."""

    key: str
    name: str
    each: list[float]
    at_most: bool = False


def compare_speed(
    baseline: Path,
    base: str,
    settings: dict[str, Any],
    effort: Effort,
    groups: Sequence[str] = USUAL,
    progress: Callable[[str, int, int], None] = lambda name, done, total: None,
) -> list[Ratio]:
    """Time the cases of groups of `LAPS` in this tree and in `baseline`, for a preset `base` with settings changed.

    A ratio is the median over a repetition's pairs of laps.

    `progress` is told the name of what comes next, laps done and laps in all. Raises as `trees.running`.
    """
    arguments = {
        "source": CASES.read_text("utf-8"),
        "scenario": base,
        "settings": repr(settings),
        "effort": effort._asdict(),
        "groups": list(groups),
    }
    with ExitStack() as stack:
        trees = [stack.enter_context(running(tree, TIME, arguments)) for tree in (HERE, baseline)]
        progress("loading (compiles once, 15 s)", 0, 1)
        plans, _ = [tree.read() for tree in trees]
        sizes = {key: _size(trees, key, effort.seconds) for key, _ in plans}
        each: dict[str, list[float]] = {key: [] for key, _ in plans}
        for repetition in range(effort.repetitions):
            for k, (key, name) in enumerate(plans):
                progress(name, repetition * len(plans) + k, effort.repetitions * len(plans))
                pairs, calls = sizes[key]
                each[key].append(statistics.median(_pair(trees, key, calls, n) for n in range(pairs)))
    return [Ratio(key, name, each[key]) for key, name in plans]


def compare_time(
    baseline: Path,
    base: str,
    repetitions: int,
    groups: Sequence[str],
    progress: Callable[[str, int, int], None] = lambda name, done, total: None,
) -> list[Ratio]:
    """Time what a user waits for, groups of `waits.KEYS`, in this tree and in `baseline`: on the clock, and the CPU's.

    Raises as `waits.compare_waits`.
    """
    chosen = [wait for wait in waits(base) if wait.key in groups]
    ratios = []
    for wait, rounds in compare_waits((HERE, baseline), chosen, repetitions, progress):
        ratios.append(Ratio(wait.key, wait.name, [ours.wall / theirs.wall for ours, theirs in rounds], at_most=True))
        if all(theirs.cpu > 0.0 for _, theirs in rounds):  # some systems do not tell
            each = [ours.cpu / theirs.cpu for ours, theirs in rounds]
            ratios.append(Ratio(f"{wait.key} cpu", f"{wait.name}, CPU", each, at_most=True))
    return ratios


def record(
    ratios: Sequence[Ratio], base: str, settings: dict[str, Any], effort: Effort, baseline: Path, load: float | None
) -> dict[str, Any]:
    """The record of a comparison, as `report.record` of the cases of one tree; load: as there."""
    goals = GOALS if version(baseline) == FIRST else {}
    bars = [
        Bar(
            f"{ratio.name}, {'time, ' * ratio.at_most}this tree / baseline",
            ratio.key,
            (),
            goals.get(ratio.key, 1.0 / LEAST if ratio.at_most else LEAST),
            ratio.at_most,
        )
        for ratio in ratios
    ]
    return {
        "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "machine": machine() | {"load": load},
        "versions": versions() | {"baseline": version(baseline)},
        "scenario": base,
        "settings": settings,
        "effort": effort._asdict(),
        "memory": None,
        "ratios": [judged(bar, ratio.each) for bar, ratio in zip(bars, ratios, strict=True)],
    }


def version(tree: Path) -> str:
    """The version that a tree states."""
    return runpy.run_path(str(tree / "fovconn_env" / "version.py"))["__version__"]


def _size(trees: Sequence[Pipes], key: str, seconds: float) -> tuple[int, int]:
    """Pairs of laps in a repetition of so many seconds a tree, at least two, and calls in a lap."""
    calls = 1
    while True:
        spent = min(tree.ask([key, calls])[0] for tree in trees)
        if spent >= LAP:
            return max(2, round(seconds / spent)), calls
        calls *= 2


def _pair(trees: Sequence[Pipes], key: str, calls: int, n: int) -> float:
    """The other tree's time of a step over this tree's, in a lap of each; who begins alternates with `n`."""
    order = (0, 1) if n % 2 == 0 else (1, 0)
    laps = {k: trees[k].ask([key, calls]) for k in order}
    ours, theirs = (seconds / steps for seconds, steps in (laps[0], laps[1]))
    return theirs / ours
