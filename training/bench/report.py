"""The record of a `fovconn bench` run, with ratios and their bars in JSON types, and tables made from it."""

from __future__ import annotations

import importlib.metadata
import os
import statistics
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:  # docs/tables.py makes its tables from a record, without the environment
    from fovconn_env.training.bench.timing import Result, Timing

PACKAGES = (
    "fovconn-env numpy numba gymnasium pettingzoo torch stable-baselines3 vmas mpe2 gym-pybullet-drones pybullet"
).split()
GIB = 2.0**30
RESTLESS = 1.5  # most / least over the repetitions of the median case; quiet machines stay below 1.2
RESTLESS_PAIR = 1.1  # of a ratio of two trees: they take turns
BUSY = 0.5  # processors
Table = tuple[list[str], list[list[str]]]  # head, rows


class Bar(NamedTuple):
    """A ratio of two cases' agent steps per second, in each repetition, and its bar."""

    text: str
    over: str  # key of a case
    under: tuple[str, ...]  # keys, the fastest one counts; without any it is `over` itself
    bar: float
    at_most: bool = False


def bars(main: int, largest: int, rows: int) -> list[Bar]:
    """The bars, for the sizes of an `Effort`."""
    vector = f"vector {main}"
    vmas = tuple(dict.fromkeys(f"{name} {b}" for name in ("vmas", "vmas-one") for b in (main, largest)))
    costs = ((f"kinematic N={n}", n, bar) for n, bar in ((24, 3.0), (48, 5.0)))
    return [
        Bar(f"vector, B = {main} / VMAS at its best", vector, vmas, 4.5),
        Bar("parallel_env / mpe2", "parallel", ("mpe2",), 14.0),
        Bar("parallel_env / gym-pybullet-drones", "parallel", ("gym-pybullet-drones",), 15.0),
        *(Bar(f"SB3 rows / Simulator.step, B = {b}", f"sb3 {b}", (f"core {b}",), 0.7) for b in sorted({rows, main})),
        Bar("PPO, robot steps/s", "ppo", (), 50_000.0),
        Bar(f"quadrotor / kinematic, B = {main}", "quadrotor", (vector,), 0.25),
        *(Bar(f"time per robot, N = {n} / N = 6", "kinematic N=6", (key,), bar, True) for key, n, bar in costs),
        Bar(f"time of reset / step, B = {rows}", f"core {rows}", ("reset",), 150.0, True),
        Bar("time of reset / step, parallel_env", "parallel", ("reset 1",), 150.0, True),
    ]


def record(result: Result, load: float | None = None) -> dict[str, Any]:
    """The record of a run, in JSON types; load: `load()` of before it."""
    from fovconn_env.scenarios.serialize import scenario_to_json
    from fovconn_env.training.evaluation.record import machine

    todo, memory = result.agenda, result.memory
    effort = todo.effort
    sizes = effort.main, max(effort.batches), effort.rows
    torch = sys.modules.get("torch")
    return {
        "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "machine": machine() | {"load": load} | ({"torch_threads": torch.get_num_threads()} if torch else {}),
        "versions": versions(),
        "scenario": todo.scenario.name,
        "settings": scenario_to_json(todo.scenario),
        "effort": effort._asdict(),
        "missing": todo.missing,
        "cases": [_case(timing) for timing in result.timings],
        "memory": memory._asdict() if memory else None,
        "ratios": [entry for bar in bars(*sizes) if (entry := ratio(bar, result.timings)) is not None],
    }


def _case(timing: Timing) -> dict[str, Any]:
    numbers = {"median": timing.median, "least": min(timing.rates), "most": max(timing.rates)}
    numbers["agent_median"] = timing.median * timing.agents
    return timing._asdict() | numbers


def ratio(bar: Bar, timings: Sequence[Timing]) -> dict[str, Any] | None:
    """The median over the repetitions of a paired ratio, and its bar; None if a case is missing."""
    by_key = {timing.key: timing for timing in timings}
    if bar.over not in by_key or not all(key in by_key for key in bar.under):
        return None
    over = [rate * by_key[bar.over].agents for rate in by_key[bar.over].rates]
    under = [1.0] * len(over)
    if bar.under:
        best = max((by_key[key] for key in bar.under), key=lambda timing: timing.median * timing.agents)
        under = [rate * best.agents for rate in best.rates]
    return judged(bar, [a / b for a, b in zip(over, under, strict=True)])


def judged(bar: Bar, each: Sequence[float]) -> dict[str, Any]:
    """A bar with its ratio in each repetition, their median and range, and whether the median holds it."""
    median = statistics.median(each)
    holds = median <= bar.bar if bar.at_most else median >= bar.bar
    return bar._asdict() | {"each": list(each), "ratio": median, "least": min(each), "most": max(each), "holds": holds}


def versions() -> dict[str, str]:
    """Versions of the installed packages that a benchmark uses."""
    installed = {}
    for name in PACKAGES:
        try:
            installed[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return installed


# ------------------------------------------------------------------------------------------------------------ tables
def rate_table(report: dict[str, Any]) -> Table:
    """Steps a second of every case of a record."""
    head = ["case", "env steps/s", "least–most", "robot steps/s", "ends/1000"]
    rows = [
        [
            case["name"],
            _count(case["median"]),
            f"{_short(case['least'])}–{_short(case['most'])}",
            _count(case["agent_median"]),
            f"{case['ends']:.2f}",
        ]
        for case in report["cases"]
    ]
    return head, rows


def bar_table(report: dict[str, Any]) -> Table:
    """The ratios of a record and their bars, and the peak memory."""
    rows = [
        [
            entry["text"],
            _count(entry["ratio"]),
            f"{_short(entry['least'])}–{_short(entry['most'])}",
            f"{'≤' if entry['at_most'] else '≥'} {_count(entry['bar'])}",
            "yes" if entry["holds"] else "no",
        ]
        for entry in report["ratios"]
    ]
    memory = report["memory"]
    if memory:
        peak, imports = memory["peak"] / GIB, memory["imports"] / GIB
        text = f"peak memory, B = {memory['worlds']}, GiB"
        rows.append([text, f"{peak:.2f}", f"imports {imports:.2f}", "< 1", "yes" if peak < 1.0 else "no"])
    return ["ratio", "median", "least–most", "bar", "holds"], rows


def restless(report: dict[str, Any]) -> str:
    """A sentence if the machine was busy; else "".

    It was if other programs ran in the minute before, or if most / least over the repetitions is RESTLESS or more in
    half of the cases, RESTLESS_PAIR in half of the ratios of two trees.
    """
    load = report["machine"].get("load") or 0.0
    if load >= BUSY:
        return f"The machine was not quiet: other programs kept {load:.1f} processors busy in the minute before."
    what, limit = ("cases", RESTLESS) if "cases" in report else ("ratios", RESTLESS_PAIR)
    spread = statistics.median([entry["most"] / entry["least"] for entry in report[what]] or [1.0])
    if spread < limit:
        return ""
    return f"The machine was not quiet: in half of the {what} the most is {spread:.2g} times the least."


def load() -> float | None:
    """Processors that were busy in the last minute; None if the system does not tell."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def machine_line(report: dict[str, Any]) -> str:
    """The machine and the versions of a record in one line."""
    about = report["machine"]
    parts = [f"{about['cpu']}, cores: {about['cores']}", about["system"], f"Python {about['python']}"]
    parts += [f"{name} {version}" for name, version in report["versions"].items()]
    if "torch_threads" in about:
        parts.append(f"torch threads: {about['torch_threads']}")
    return "; ".join(parts)


def _count(value: float) -> str:
    """A rate with three significant digits."""
    digits = len(str(int(value)))
    return f"{round(value, 3 - digits):,.0f}" if digits >= 3 else f"{value:.3g}"


def _short(value: float) -> str:
    """A rate with three significant digits and a suffix: 285k."""
    scale, letter = (1e6, "M") if value >= 999.5e3 else (1e3, "k") if value >= 999.5 else (1.0, "")
    return f"{value / scale:.3g}{letter}"
