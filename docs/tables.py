"""Write the generated tables of README.md and docs/*.md: `python docs/tables.py` (`--check` only looks).

A table stands between `<!-- KIND:NAME -->` and `<!-- end -->`. KIND is `layout` (a table of `fovconn_env.layout`, or
`layout:scales`, what the named bounds are), `settings` (fields of a settings class, with the comment beside each),
`bench` (rates, bars or machine of docs/benchmark.json, which `fovconn bench --json` writes), `results`
(a table of a record in docs/results, which `make results` writes), `levels` (of one scenario, from
docs/results/levels.json, which training/evaluation/levels.py writes), `learned` (a table of
docs/results/learned.json, which training/evaluation/learned_study.py writes) or `keys` (of `fovconn play`, one group of
its key table, `mouse` or `gamepad`).
"""

from __future__ import annotations

import ast
import inspect
import itertools
import json
import math
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

from fovconn_env import Scenario, layout
from fovconn_env.baselines import Gains, find_policy
from fovconn_env.layout import Column
from fovconn_env.scenarios import settings
from fovconn_env.training.bench.report import bar_table, machine_line, rate_table, restless
from fovconn_env.training.play import gamepad, keyboard

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
# What the named bounds of the layout are, as expressions in the settings of a Scenario.
SCALES = {
    "speed": "2 * speed_limit",
    "turn": "2 * yaw_rate_limit",
    "stick": "stick_speed",
    "distance": "camera.d_max",
    "range": "rangefinder.range_max",
    "lambda2": "n_agents",
    "age": "radio.memory + radio.delay * clock.tick / clock.rounds",
    "world": "1000",
}
_MARKED = re.compile(r"(<!-- (\w+):([\w -]+?) -->\n).*?(<!-- end -->)", re.DOTALL)
_FIELD = re.compile(r"^    (\w+): (.+?) = (.+?)(?:  # (.*))?$", re.MULTILINE)


def rendered(text: str) -> str:
    """A page with its generated tables made anew."""
    kinds = {"layout": layout_table, "settings": settings_table, "bench": bench_table}
    kinds |= {"results": results_table, "levels": levels_table, "learned": learned_table, "keys": keys_table}
    return _MARKED.sub(lambda found: f"{found[1]}\n{kinds[found[2]](found[3])}\n\n{found[4]}", text)


def keys_table(name: str) -> str:
    """The Markdown table of a group of keys of `fovconn play`."""
    pad = [*gamepad.AXES, *((button.name, button.words) for button in gamepad.BUTTONS)]
    rows = {"mouse": keyboard.MOUSE, "gamepad": pad}.get(name) or keyboard.rows(name)
    return _markdown([name, "does"], [[f"`{keys}`", words] for keys, words in rows])


def layout_table(name: str) -> str:
    """The Markdown table of a layout table; the columns of one vector share a row."""
    if name == "scales":
        values = Scenario().scales()
        rows = [[f"`{scale}`", f"`{rule}`", f"{values[scale]:g}"] for scale, rule in SCALES.items()]
        return _markdown(["bound", "setting", "by default"], rows)
    if name == "LOST_LINK":
        return _markdown(["code", "cause"], [[str(k), cause] for k, cause in enumerate(layout.LOST_LINK)])
    rows, first = [], 0
    for _, group in itertools.groupby(getattr(layout, name), _vector):
        columns = list(group)
        last = first + len(columns) - 1
        index = f"{first}" if first == last else f"{first}-{last}"
        names = " ".join(f"`{column.name}`" for column in columns)
        column = columns[0]
        meaning = column.meaning if first == last else re.sub(r", [xyz]$", "", column.meaning)
        rows.append([index, names, column.unit, column.frame, _interval(column), meaning])
        first = last + 1
    return _markdown(["#", "column", "unit", "frame", "bounds", "meaning"], rows)


def settings_table(name: str) -> str:
    """The Markdown table of a settings class, from its source: field, default, choices or comment."""
    kind = {"Gains": Gains, "Scenario": Scenario}.get(name) or getattr(settings, name)
    rows = []
    for field, annotation, default, comment in _FIELD.findall(inspect.getsource(kind)):
        factory = re.fullmatch(r"field\(default_factory=(\w+)\)", default)
        default = re.sub(r"^(positive|non_negative|fraction)\((.*?)(, infinite=True)?\)$", r"\2", default)
        choices = re.fullmatch(r"Literal\[(.*)\](?: \| (\w+))?", annotation)
        words = [f'`"{word}"`' for word in ast.literal_eval(f"({choices[1]},)")] if choices else []
        words = " or ".join(words + ([f"a `{choices[2]}`"] if choices and choices[2] else []))
        meaning = "; ".join(filter(None, [words, comment])) or (f"see {factory[1]} below" if factory else "")
        rows.append([f"`{field}`", f"`{factory[1]}()`" if factory else f"`{default}`", meaning])
    return _markdown(["setting", "default", "unit and meaning"], rows)


def bench_table(name: str) -> str:
    """A Markdown table of the committed benchmark: "rates" or "bars"; or "machine", a line of text."""
    report = json.loads((ROOT / "docs" / "benchmark.json").read_text("utf-8"))
    if name == "machine":
        return f"Measured {report['finished'][:10]} on {machine_line(report)}. {restless(report)}".rstrip()
    return _markdown(*{"rates": rate_table, "bars": bar_table}[name](report))


def results_table(name: str) -> str:
    """A table of a record in docs/results, with its footnotes; name: record and table, "run" for a line of text."""
    record, _, table = name.partition(" ")
    report = json.loads((ROOT / "docs" / "results" / f"{record}.json").read_text("utf-8"))
    if table == "run":
        return _run_line(report)
    found = report["tables"][table] if table else report
    notes = [note for note in report.get("footnotes", ()) if any(note[0] in row[0] for row in found["rows"])]
    return "\n\n".join([_markdown(found["head"], found["rows"]), *notes])


def levels_table(name: str) -> str:
    """The Markdown table of a scenario's levels: settings, and what each policy keeps and finishes.

    name: "run" for a line of text instead, a scenario, or a scenario and "lambda2" for what its estimates are worth and
    what their messages weigh, by power iteration and by flooding.
    """
    report = json.loads((ROOT / "docs" / "results" / "levels.json").read_text("utf-8"))
    if name == "run":
        return _run_line(report)
    name, _, what = name.partition(" ")
    rows, levels = [], report["levels"][name]
    policies = ["expert", "expert-flooding"] if what else list(levels[0]["policies"])
    for number, level in enumerate(levels, start=1):
        settings = " ".join(f"`{setting}={value}`" for setting, value in level["changes"].items()) or "-"
        found = [level["policies"][policy] for policy in policies]
        if what:
            cells = [f"{each['bytes_per_second']:,.0f}" for each in found]
            errors = [100 * each["lambda2_error_median"] for each in found]
            cells += [f"{error:.0f} %" if error >= 10 else f"{error:.2g} %" for error in errors]
        else:
            cells = [f"{100 * each['never_disconnected']:.0f} / {100 * each['success']:.0f}" for each in found]
        rows.append([f"{number}", settings, f"{level['episodes']}", *cells])
    head = [f"{policy} †" if find_policy(policy).oracle else policy for policy in policies]
    head = [f"{quantity}, {policy}" for quantity in ("B/s", "error") for policy in head] if what else head
    return _markdown(["level", "settings", "episodes", *head], rows)


def learned_table(name: str) -> str:
    """A Markdown table of what learned policies are worth beside others on the same seeds; "run" for a line of text."""
    report = json.loads((ROOT / "docs" / "results" / "learned.json").read_text("utf-8"))
    if name == "run":
        return _run_line(report)
    rows = []
    for row in report["tables"][name]:
        task = " ".join([row["scenario"], *(f"`{setting}={value}`" for setting, value in row["changes"].items())])
        shares = [_percent(row[key]) for key in ("kept", "success")]
        signed = [_percent(row[f"{key}_difference"], "+") for key in ("kept", "success")]
        progress = [row["progress"], row["progress_against"]]
        forward = ["-" if value is None else f"{value:.2f}" for value in progress]
        rows.append([row["policy"], task, *shares, forward[0], row["against"], *signed, forward[1]])
    head = ["policy", "flown on", "kept %", "success %", "progress"]
    return _markdown([*head, "against", "kept, difference", "success, difference", "its progress"], rows)


def _percent(estimate: list[float], sign: str = "") -> str:
    value, low, high = (100 * number for number in estimate)
    return f"{value:{sign}.1f} [{low:{sign}.1f}, {high:{sign}.1f}]"


def _run_line(report: dict) -> str:
    seeds, run = report["seeds"], report["run"]
    names = ("python", "numpy", "numba")
    versions = ", ".join([f"fovconn_env {report['fovconn_env']}", *(f"{name} {run[name]}" for name in names)])
    took = f"{run['seconds']:.0f} s on {run['cores']} cores"
    return f"Seeds {seeds[0]} to {seeds[-1]}, {run['finished'][:10]}, {versions}; {took}."


def _vector(column: Column) -> tuple:
    """What the columns of one vector have in common; any other column has only itself."""
    stem, _, axis = column.meaning.rpartition(", ")
    return (stem, column.unit, column.low, column.high) if axis in {"x", "y", "z"} else (column.name,)


def _interval(column: Column) -> str:
    scales = Scenario().scales()
    low, high = (
        scales[bound.removeprefix("-")] * (-1 if bound.startswith("-") else 1) if isinstance(bound, str) else bound
        for bound in (column.low, column.high)
    )
    shown = f"±{_number(high)}" if low == -high else f"{_number(low)} to {_number(high)}"
    scale = str(column.high)
    return f"{shown} (`{scale}`)" if scale in SCALES else shown


def _number(value: float) -> str:
    return "π" if value == math.pi else f"{value:g}"


def _markdown(head: list[str], rows: list[list[str]]) -> str:
    table = [[cell.replace("|", r"\|").replace("f*_", r"f\*_") for cell in row] for row in [head, *rows]]
    lines = ["| " + " | ".join(row) + " |" for row in table]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def main() -> int:
    """Write the pages that are out of date, or with --check name them; the exit status then is 1."""
    stale = [page for page in PAGES if rendered(page.read_text("utf-8")) != page.read_text("utf-8")]
    for page in stale:
        print(f"{'out of date' if '--check' in sys.argv else 'wrote'}: {page.relative_to(ROOT)}")
        if "--check" not in sys.argv:
            page.write_text(rendered(page.read_text("utf-8")), "utf-8")
    return int(bool(stale) and "--check" in sys.argv)


if __name__ == "__main__":
    sys.exit(main())
