"""Write the generated parts of README.md and docs: `python docs/tables.py` (`--check` only looks).

Beside each record docs/results/NAME.json, which `make results` writes, a page docs/results/NAME.md has all its tables.
In README.md and docs/*.md a table stands between `<!-- KIND:NAME -->` and `<!-- end -->`; KIND is

- `results`: a record and one of its tables by the heading it has in the record's page, `results:full LeaderFollow-v0`,
  `results:learned teams`; or `run`, its seeds, date and versions in a line, `results:full run`
- `five`: five measures of three policies on a scenario, from docs/results/full.json
- `bench`: `rates`, `bars` or `machine` of docs/benchmark.json, which `fovconn bench --json` writes; `speed`: `bars` or
  `machine` of docs/speed.json, with `--baseline`
- `quickstart`: `spread`, a table, or `line`, a sentence in docs/quickstart.ipynb, of docs/quickstart.json, which
  docs/quickstart_spread.py writes
- `learning`: `end`, a table of docs/results/curves/libraries.json, or `made`, a line; docs/learning_curves.py writes it
- `training`: `ablations`, a table of docs/training_ablations.json, or `made`, a line, by docs/training_ablations.py
- `fidelity`: `flights` or `causes` of docs/fidelity.json, which docs/fidelity.py writes
- `tasks`: the tasks of a suite, `tasks:hard-v1`
- `layout`: a table of `fovconn_env.layout`, or `scales`, what the named bounds are
- `settings`: fields of a settings class, with their bounds
- `keys`: one group of the keys of `fovconn play`, `mouse` or `gamepad`
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import math
import re
import sys
from pathlib import Path
from statistics import mean

sys.path.insert(0, str(Path(__file__).parents[1]))  # runs from a clone without an install, too

from fovconn_env import HARD, Corridor, Forest, Scenario, layout, scenario
from fovconn_env.baselines import Gains
from fovconn_env.bounds import default_of, words_of
from fovconn_env.files import write_text
from fovconn_env.layout import Column
from fovconn_env.scenarios import settings
from fovconn_env.scenarios.hard import TASKS
from fovconn_env.training.bench.report import bar_table, machine_line, rate_table, restless
from fovconn_env.training.evaluation import tables
from fovconn_env.training.evaluation.campaign import SUITES
from fovconn_env.training.evaluation.record import Record, load
from fovconn_env.training.evaluation.text import Table, markdown, settings_in_words
from fovconn_env.training.play import gamepad, keyboard

ROOT = Path(__file__).parents[1]
RESULTS, NOTEBOOK = ROOT / "docs" / "results", ROOT / "docs" / "quickstart.ipynb"
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "recipes").glob("*.md")))
LEFT_OUT = ("Corridor-v0 3", "NarrowCamera-v0 3", "LossyRadio-v0 4")  # of one way to train the generalist
# What the named bounds of the layout are, as expressions in the settings of a Scenario.
SCALES = {
    "speed": "2 * speed_limit",
    "turn": "2 * yaw_rate_limit",
    "stick": "stick_speed",
    "distance": "camera.d_max",
    "range": "rangefinder.range_max",
    "lambda2": "n_agents",
    "age": "radio.memory + radio.delay * clock.tick / clock.rounds",
    "detection": "camera.d_max",
    "followed": "10",
    "world": "1000",
}
FIVE = (  # of the README, as in `tables.CARD`
    ("teams never disconnected (*kept*)", ("never_disconnected",), ".1%"),
    ("flights that reach the goal, connected and without collision", ("success",), ".1%"),
    ("leader's speed, as a share of what the operator asks for", ("progress",), ".2f"),
    ("error of a robot's own lambda2, median", ("lambda2_error_median",), ".2%"),
    ("bytes that a robot sends in a second", ("bytes_per_second",), ",.0f"),
)
FLIGHTS = (  # of docs/fidelity.json
    ("1 m/s forward: rise from 10 to 90 %, s", "velocity", "rise", ".2f"),
    ("overshoot", "velocity", "overshoot", ".0%"),
    ("within 5 % after, s", "velocity", "settle", ".2f"),
    ("peak tilt, °", "velocity", "tilt", ".1f"),
    ("tilt after 3 s, °", "velocity", "held", ".1f"),
    ("1 rad/s in yaw: rise from 10 to 90 %, s", "yaw", "rise", ".2f"),
    ("overshoot", "yaw", "overshoot", ".0%"),
    ("within 5 % after, s", "yaw", "settle", ".2f"),
    ("change of height, cm", "yaw", "climb", ".1f"),
    ("gust of 4 m/s for 3 s: displacement, cm", "gust", "displacement", ".1f"),
    ("peak tilt, °", "gust", "tilt", ".1f"),
    ("hover for 20 s, random force of 0.2 N: horizontal displacement, rms, cm", "hover", "rms", ".1f"),
)
FLIERS = {
    "ours": "`fovconn_env`",
    "plant": "its controller, rotorpy's body",
    "drag": "the same with drag",
    "se3": "rotorpy: `SE3Control`, drag",
}
_STEP, _GUST = "overshoot, step of 1 m/s", "displacement by the gust, cm"
_TURN = "overshoot, step in yaw rate"
CAUSES = (
    ("`SE3Control` follows our reference", _STEP, ".0%", ("velocity se3 overshoot", "velocity shaped overshoot")),
    ("and gets its body rate", _STEP, ".0%", ("velocity shaped overshoot", "velocity fed overshoot")),
    ("our controller gets none (no drag)", _STEP, ".0%", ("velocity plant overshoot", "unfed")),
    ("`SE3Control` is asked for 0.1, not 1 rad/s", _TURN, ".0%", ("yaw se3 overshoot", "small yaw")),
    ("and the rotors lag by 5, not 20 ms", _TURN, ".0%", ("small yaw", "quick rotors")),
    ("`SE3Control` has our `kp` and `kv`", _GUST, ".1f", ("gust se3 displacement", "our gains")),
)
_MARKED = re.compile(r"(<!-- (\w+):([\w -]+?) -->\n).*?(<!-- end -->)", re.DOTALL)


def rendered(text: str) -> str:
    """A page with its generated tables made anew."""
    kinds = {"layout": layout_table, "settings": settings_table, "keys": keys_table, "fidelity": fidelity_table}
    kinds |= {"quickstart": quickstart_table, "results": results_table, "five": five_table, "tasks": tasks_table}
    kinds["learning"], kinds["training"] = learning_table, training_table
    for kind, file in (("bench", "benchmark.json"), ("speed", "speed.json")):
        kinds[kind] = functools.partial(bench_table, file)
    return _MARKED.sub(lambda place: f"{place[1]}\n{kinds[place[2]](place[3])}\n\n{place[4]}", text)


def pages() -> dict[Path, str]:
    """All pages with generated tables, as they should be."""
    whole = {file.with_suffix(".md"): tables.page(file, load(file)) for file in sorted(RESULTS.glob("*.json"))}
    return {page: rendered(page.read_text("utf-8")) for page in PAGES} | whole | {NOTEBOOK: notebook()}


def notebook() -> str:
    """The notebook with the generated parts of its text made anew."""
    book = json.loads(NOTEBOOK.read_text("utf-8"))
    for cell in book["cells"]:
        if cell["cell_type"] == "markdown":
            cell["source"] = rendered("".join(cell["source"])).splitlines(keepends=True)
    return json.dumps(book, indent=1, ensure_ascii=False) + "\n"


def keys_table(name: str) -> str:
    """The Markdown table of a group of keys of `fovconn play`."""
    pad = [*gamepad.AXES, *((button.name, button.description) for button in gamepad.BUTTONS)]
    rows = {"mouse": keyboard.MOUSE, "gamepad": pad}.get(name) or keyboard.rows(name)
    return markdown(([name, "does"], [[f"`{keys}`", words] for keys, words in rows]))


def layout_table(name: str) -> str:
    """The Markdown table of a layout table; the columns of one vector share a row."""
    if name == "scales":
        values = Scenario().scales()
        rows = [[f"`{scale}`", f"`{rule}`", f"{values[scale]:g}"] for scale, rule in SCALES.items()]
        return markdown((["bound", "setting", "by default"], rows))
    if name == "LOST_LINK":
        return markdown((["code", "cause"], [[str(k), cause] for k, cause in enumerate(layout.LOST_LINK)]))
    rows, first = [], 0
    for _, group in itertools.groupby(getattr(layout, name), _vector):
        columns = list(group)
        last = first + len(columns) - 1
        index = f"{first}" if first == last else f"{first}-{last}"
        names = " ".join(f"`{column.name}`" for column in columns)
        column = columns[0]
        meaning = column.meaning if first == last else re.sub(r", [xyz]$", "", column.meaning)
        rows.append([index, names, column.unit, column.frame, _interval(column), _literal(meaning)])
        first = last + 1
    return markdown((["#", "column", "unit", "frame", "bounds", "meaning"], rows))


def settings_table(name: str) -> str:
    """The Markdown table of a settings class: field, default, bounds, unit and meaning, reason for the bounds."""
    kinds = {"Gains": Gains, "Scenario": Scenario, "Forest": Forest, "Corridor": Corridor}
    kind, rows = kinds.get(name) or getattr(settings, name), []
    for field in dataclasses.fields(kind):
        bounds, default = field.metadata.get("bounds"), default_of(field)
        words = " or ".join(f"`{word}`" for word in words_of(kind, field))
        words = "; ".join(filter(None, [words, field.metadata.get("meaning")]))
        words = words or (f"see {default.removesuffix('()')} below" if default.endswith("()") else "")
        limits = [f"`{bounds}`", bounds.why] if bounds else ["", ""]
        rows.append([f"`{field.name}`", f"`{default}`", limits[0], _literal(words), limits[1]])
    return markdown((["setting", "default", "bounds", "unit and meaning", "why these bounds"], rows))


def tasks_table(name: str) -> str:
    """The Markdown table of the tasks of a suite: each with its base, its level, and the settings changed there."""
    rows = []
    for task in SUITES[name].scenarios:
        base, level, _, summary = TASKS[task]
        changed = settings_in_words(scenario(task), scenario(base, level=level))
        words = " ".join(f"`{setting}={value}`" for setting, value in changed.items()) or "-"
        rows.append([f"`{task}`", summary, base, f"{level}", words])
    return markdown((["task", "what is hard", "preset", "level", "settings changed there"], rows))


def quickstart_table(name: str) -> str:
    """What the notebook's training ends with, from some seeds: "spread", a Markdown table, or "line", a sentence."""
    trained = json.loads((ROOT / "docs" / "quickstart.json").read_text("utf-8"))["trained"]
    if name == "line":
        seeds = _listed([str(each["seed"]) for each in trained])
        shares = _listed([f"{each['64']['success']:.0%}" for each in trained])
        return f"Trained from the seeds {seeds} it had success in {shares} of the flights that `show` flies."
    rows = [[str(each["seed"]), *(_percents(each[flights]) for flights in ("64", "320"))] for each in trained]
    return markdown((["seed", "kept, success, progress in 64 flights", "in 320 flights"], rows))


def learning_table(name: str) -> str:
    """What other libraries reach with equal steps: "end", a Markdown table, or "made", a line."""
    files = (RESULTS / "curves" / f"{file}.json" for file in ("libraries", "libraries_made"))
    curves, made = (json.loads(file.read_text("utf-8")) for file in files)
    (methods,) = curves["fovconn"].values()
    if name == "made":
        runs = [run for seeds in methods.values() for run in seeds.values()]
        steps = max(part.get("step_count", 0) for run in runs for part in run.values())
        changes = [f"`{key}={value}`" for key, value in made["task"].items() if key != "scenario"]
        versions = ", ".join(f"{library} {number}" for library, number in made["versions"].items())
        about = f"{steps:,} robot steps, one thread each, {made['finished']}; {versions}; {made['machine']['cpu']}"
        return f"`{made['task']['scenario']}` with {', '.join(changes)}; {about}."
    head = ["algorithm", "library", "return", "never disconnected", "success", "processor minutes"]
    forms = {"return": ".1f", "never_disconnected": ".0%", "success": ".0%"}
    rows = []
    for method, seeds in methods.items():
        last = [run["absolute_metrics"] for run in seeds.values()]
        ends = [", ".join(f"{mean(flown[key]):{form}}" for flown in last) for key, form in forms.items()]
        minutes = [f"{made['minutes'][method][seed]:.2f}" for seed in seeds]
        rows.append([method, made["libraries"][method], *ends, ", ".join(minutes)])
    for law, flown in made["laws"].items():
        rows.append([f"`{law}`", "a law", *(f"{mean(flown[key]):{form}}" for key, form in forms.items()), ""])
    return markdown((head, rows))


def training_table(name: str) -> str:
    """What each way to train the generalist is worth: "ablations", a Markdown table, or "made", a line."""
    record = json.loads((ROOT / "docs" / "training_ablations.json").read_text("utf-8"))
    run = record["run"]
    if name == "made":
        about = f"{run['steps']:,} robot steps, {run['flights']} flights of a task from seed 0, fewer of large teams"
        return f"{about}; one thread, {run['finished']}; {run['machine']['cpu']}."
    head = ["trained", "29 levels, %", "hard-v1, %", *(f"{label}, %" for label in LEFT_OUT), "minutes"]
    rows = []
    for variant, runs in record["found"].items():
        flown = [found["success"] for found in runs]
        groups = [[task for task in flown[0] if (task in HARD) == hard] for hard in (False, True)]
        means = [[mean(100.0 * worth[task] for task in group) for worth in flown] for group in groups]
        shown = [", ".join(f"{value:.1f}" for value in values) for values in means]
        shown += [", ".join(f"{100.0 * worth[label]:.0f}" for worth in flown) for label in LEFT_OUT]
        rows.append([record["about"][variant], *shown, ", ".join(f"{found['minutes']:.0f}" for found in runs)])
    return markdown((head, rows))


def fidelity_table(name: str) -> str:
    """Of docs/fidelity.json: "flights", what each flier did, or "causes", what a change made of a measure."""
    record = json.loads((ROOT / "docs" / "fidelity.json").read_text("utf-8"))
    values = dict(record["causes"])
    for scene, fliers in record["measures"].items():
        values |= {f"{scene} {flier} {key}": value for flier, found in fliers.items() for key, value in found.items()}
    if name == "causes":
        rows = [[*words, *(f"{values[key]:{form}}" for key in keys)] for *words, form, keys in CAUSES]
        return markdown((["change", "measure", "before", "after"], rows))
    rows = [
        [label, *(f"{values[f'{scene} {flier} {key}']:{form}}" for flier in FLIERS)]
        for label, scene, key, form in FLIGHTS
    ]
    return markdown((["", *FLIERS.values()], rows))


def _listed(words: list[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _percents(found: dict[str, float]) -> str:
    return f"{found['kept']:.1%}, {found['success']:.1%}, {found['progress']:.2f}"


def bench_table(file: str, name: str) -> str:
    """A Markdown table of a committed benchmark: "rates" or "bars"; or "machine", a line of text."""
    report = json.loads((ROOT / "docs" / file).read_text("utf-8"))
    if name == "machine":
        return f"Measured {report['finished'][:10]} on {machine_line(report)}. {restless(report)}".rstrip()
    return markdown({"rates": rate_table, "bars": bar_table}[name](report))


def results_table(name: str) -> str:
    """A table of a record in docs/results, with its footnotes; name: record and table, "run" for a line of text."""
    name, _, title = name.partition(" ")
    record, by_title = _record(name)
    if title == "run":
        return tables.run_line(record)
    table = by_title[title]
    return "\n\n".join([markdown(table), *tables.footnotes(table)])


def five_table(name: str) -> str:
    """The Markdown table of `FIVE` on a scenario."""
    record, _ = _record("full")
    results = {f"`{policy}`": record.find(policy, name) for policy in ("expert", "cohesive", "residual")}
    return markdown(tables.card(results, FIVE))


@functools.cache
def _record(name: str) -> tuple[Record, dict[str, Table]]:
    """A record of docs/results and its tables."""
    record = load(RESULTS / f"{name}.json")
    return record, tables.tables(record)


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


def _literal(text: str) -> str:
    """A text with f*_ij in it; Markdown would take two of its stars for emphasis."""
    return text.replace("f*_", r"f\*_")


def _number(value: float) -> str:
    return "π" if value == math.pi else f"{value:g}"


def main() -> int:
    """Write the pages that are out of date, or with --check name them; the exit status then is 1."""
    stale = {page: text for page, text in pages().items() if not page.exists() or page.read_text("utf-8") != text}
    for page, text in stale.items():
        print(f"{'out of date' if '--check' in sys.argv else 'wrote'}: {page.relative_to(ROOT)}")
        if "--check" not in sys.argv:
            write_text(page, text)
    return int(bool(stale) and "--check" in sys.argv)


if __name__ == "__main__":
    sys.exit(main())
