"""`fovconn scenarios` and `fovconn policies`: what there is, a line each."""

from __future__ import annotations

import inspect
from collections.abc import Sequence

from fovconn_env import LEVELS, PRESETS
from fovconn_env.baselines import ORACLES, POLICIES, find_pilot
from fovconn_env.baselines.learned.cards import read_card
from fovconn_env.baselines.learned.policy import Learned
from fovconn_env.scenarios.hard import TASKS
from fovconn_env.scenarios.own import REGISTERED, load_entry_points
from fovconn_env.scenarios.presets import SUMMARIES
from fovconn_env.training.commands.screen import out
from fovconn_env.training.evaluation.campaign import SUITES

_GROUPS = {tuple(PRESETS): "all scenarios", tuple(TASKS): "all hard tasks"}


def scenarios() -> None:
    """List the scenarios with their levels, the hard tasks, and the suites of `fovconn eval`."""
    levels = {name: f"levels 1-{len(LEVELS[name]) + 1}" if name in LEVELS else "" for name in PRESETS}
    _say("scenarios", [(name, levels[name], SUMMARIES[name]) for name in PRESETS])
    load_entry_points()
    mine = [(name, made.own.plugin if made.own else "") for name, made in REGISTERED.items()]
    if mine:
        _say("your own, by plugin", mine)
    _say("hard tasks", [(name, "", task.summary) for name, task in TASKS.items()])
    suites = []
    for name, (chosen, seeds, _) in SUITES.items():
        which = _GROUPS.get(chosen) or ", ".join(chosen)
        suites.append((name, "", f"all policies on {which}, {len(seeds)} seeds each"))
    _say("suites", suites)
    out.print("a level or a setting: --set level=2, --set n_agents=4")


def policies() -> None:
    """List the policies: laws, learned ones, and oracles, which know more than a robot can."""
    _say("policies", [(name, "oracle" * kind.oracle, _purpose(name)) for name, kind in (POLICIES | ORACLES).items()])
    out.print("your own: --policy file.py:Class; what you trained: dagger.safetensors, model.zip, model.onnx")


def _purpose(name: str) -> str:
    kind = find_pilot(name)
    if not (issubclass(kind, Learned) and hasattr(kind, "file")):
        return inspect.cleandoc(kind.__doc__ or "").partition("\n\n")[0].replace("\n", " ")
    card = read_card(kind.file)
    what = f"A learned correction of {card.base}" if card.base else "A learned policy"
    return f"{what}, from `fovconn train {card.made['algorithm']}`."


def _say(title: str, rows: Sequence[Sequence[str]]) -> None:
    """One line a row, in columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    out.print(title, style="bold")
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True) if width]
        out.print("  " + "  ".join(cells).rstrip(), soft_wrap=True)
    out.print()
