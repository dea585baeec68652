"""The report on a set of evaluations: `report.md` with its pictures, and `report.html` in one file."""

from __future__ import annotations

import base64
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from fovconn_env.files import write_files
from fovconn_env.layout import LOST_PAIR
from fovconn_env.text import printable
from fovconn_env.training.evaluation.comparison import EXPERT, Comparison
from fovconn_env.training.evaluation.pictures import Picture, draw
from fovconn_env.training.evaluation.record import Record, Result
from fovconn_env.training.evaluation.tables import (
    difference_table,
    estimator_table,
    footnotes,
    marked,
    overall_table,
    scenario_table,
)
from fovconn_env.training.evaluation.text import Table, escape, figures, markdown, number

TITLE = "fovconn benchmark"
PLOTS = "plots"  # folder of the pictures
ROOT = Path(__file__).resolve().parents[2]
METRICS = ROOT / "docs" / "metrics.md"
MOST_LOST = 20  # lost episodes listed

TERMS = (  # what a column's name says, in its unit
    (
        "kept",
        "share of episodes in which the team was never disconnected (true lambda2 > lambda2_min in every step), %",
    ),
    ("success", "share of episodes that reached the scenario's goal, connected and without a collision, %"),
    ("collided", "number of episodes that ended by a collision"),
    ("ended by", "share of episodes that a termination of the scenario's own ended, by its name, %"),
    ("connected", "share of time with lambda2 > lambda2_min, mean over episodes, %"),
    ("progress", "leader's speed along the stick over the speed asked for, mean over episodes; none without a stick"),
    (
        "score IQM",
        "interquartile mean of (x - random's) / (expert's - random's), by their means, not clipped; x is success "
        "weighted by completion time (`sct`). The expert's mean is 1, its interquartile mean near 1",
    ),
    ("> expert", "probability that an episode's x is above that of one of the expert's, ties count half, %"),
    ("mean lambda2", "true lambda2, clipped at lambda2_max, mean over steps and episodes; it has no unit"),
    ("lambda2 error", "|lambda2_hat - lambda2| / lambda2 while connected, over all robots and steps, a ratio"),
    ("yaw rms", "root mean square of sin(error / 2) of relative yaws, by who sees whom"),
    ("B/s", "bytes a robot sends in a second"),
    ("[a, b]", "95 % interval: Wilson for shares, Bonett-Price for differences of shares, bootstrap for the others"),
)


class Grid(NamedTuple):
    """A table with its title, and lines below it."""

    title: str
    head: list[str]
    rows: list[list[str]]
    notes: Sequence[str] = ()


class Section(NamedTuple):
    """A part of the report under a heading."""

    title: str
    lines: Sequence[str] = ()
    terms: Sequence[tuple[str, str]] = ()
    link: tuple[str, str] | None = None  # words and address; "" where there is nothing to link to
    tables: Sequence[Grid] = ()
    pictures: Sequence[Picture] = ()


def write_report(comparison: Comparison, record: Record, folder: Path, head: Mapping[str, str]) -> list[Path]:
    """Write report.md, report.html and plots/*.png into a folder, which must be there; returns the files.

    Arguments as of `make_report`. The same arguments write the same bytes.
    """
    texts, pictures = make_report(comparison, record, folder, head)
    write_files({file: text.encode() for file, text in texts.items()})
    return [*texts, *pictures]


def make_report(
    comparison: Comparison,
    record: Record,
    folder: Path,
    head: Mapping[str, str],
    drawn: Mapping[str, Sequence[Picture]] = {},
) -> tuple[dict[Path, str], list[Path]]:
    """The texts of report.md and report.html, and the pictures that were written for them.

    record: the numbers of the comparison; head: what was run, by name, for the top: seeds, versions, date, settings;
    drawn: pictures that there are, by scenario; the others are drawn now.
    """
    plots, record = folder / PLOTS, by_success(record)
    plots.mkdir(exist_ok=True)
    sections = [_overview(record)]
    for name in comparison.scenarios:
        pictures = drawn[name] if name in drawn else draw(comparison, names_on(comparison, record, name), name, plots)
        sections.append(_scenario(comparison, record, name)._replace(pictures=pictures))
    write_files({picture.path: picture.png for section in sections for picture in section.pictures})
    address = _link(folder)
    words = "docs/metrics.md" if address else "docs/metrics.md of the project's sources"
    sections.append(Section("Definitions", terms=TERMS, link=(words, address)))
    texts = {folder / "report.md": in_markdown(head, sections, folder), folder / "report.html": in_html(head, sections)}
    return texts, [picture.path for section in sections for picture in section.pictures]


def by_success(record: Record) -> Record:
    """The record with its results in the order of success, the best first; of equal ones as they were."""

    def best_first(results: Sequence[Result]) -> list[Result]:
        return sorted(results, key=lambda result: -result.measures["success"].value)

    return record._replace(results=best_first(record.results), overall=best_first(record.overall))


def names_on(comparison: Comparison, record: Record, scenario: str) -> dict[str, str]:
    """What the policies on a scenario are called in pictures."""
    return {policy: marked(record, policy) for policy in comparison.on(scenario)}


def in_markdown(head: Mapping[str, str], sections: Sequence[Section], folder: Path) -> str:
    """The report as Markdown; pictures are named relative to the folder."""
    parts = [f"# {TITLE}", "\n".join(f"- {name}: {escape(str(value))}" for name, value in head.items())]
    for section in sections:
        parts += [f"## {escape(section.title)}", *section.lines]
        if section.terms:
            parts.append("\n".join(f"- {escape(name)}: {escape(text)}" for name, text in section.terms))
        if section.link:
            words, address = section.link
            parts.append(f"More in {f'[{words}]({address})' if address else words}.")
        for table in section.tables:
            parts += [f"### {table.title}", markdown((table.head, table.rows), literal=True), *table.notes]
        for picture in section.pictures:
            where = picture.path.relative_to(folder).as_posix()
            parts += [
                f"### {picture.title}",
                f"![{escape(section.title)}: {picture.title}]({where})",
                escape(picture.text),
            ]
    return "\n\n".join(part for part in parts if part) + "\n"


def in_html(head: Mapping[str, str], sections: Sequence[Section]) -> str:
    """The report as one HTML file with its pictures inside."""
    loader = Environment(
        loader=PackageLoader("fovconn_env.training.evaluation"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
    )
    loader.filters |= {"embedded": _embedded, "term": _term, "anchor": _anchor}
    anchors: dict[str, Section] = {}
    for section in sections:
        anchor = _anchor(section.title) or "section"
        while anchor in anchors:  # titles may differ in what no anchor holds
            anchor += "-2"
        anchors[anchor] = section
    return loader.get_template("report.html").render(title=TITLE, head=head, sections=anchors) + "\n"


def lost_table(comparison: Comparison, record: Record, scenario: str) -> tuple[Table, int]:
    """Episodes in which a policy called expert... lost its team, the expert's own first; and how many there are."""
    rows = []
    policies = [policy for policy in comparison.on(scenario) if policy.startswith(EXPERT)]
    for policy in sorted(policies, key=lambda policy: policy != EXPERT):
        evaluation = comparison.compared[scenario, policy].evaluation
        episodes = evaluation.episodes
        for k in np.flatnonzero(np.isfinite(episodes["first_disconnection"])):
            row = [
                marked(record, policy),
                str(evaluation.seeds[k]),
                number(episodes["first_disconnection"][k], ".2f"),
                LOST_PAIR[int(episodes["split_cause"][k])],
                figures(episodes["split_lambda2_hat"][k]),
                number(episodes["split_alignment"][k], ".3f"),
            ]
            rows.append(row)
    return (["policy", "seed", "time, s", "cause", "lambda2_hat before", "v2 alignment"], rows[:MOST_LOST]), len(rows)


# ------------------------------------------------------------------------------------------------------------ parts
def _overview(record: Record) -> Section:
    scenarios = list(dict.fromkeys(result.scenario for result in record.results))
    where = f"all {len(scenarios)} scenarios" if len(scenarios) > 1 else scenarios[0]
    lines = [] if len(record.overall) == len(record.policies) else ["Policies that flew every scenario."]
    table = overall_table(record)
    return Section("Overview", lines, tables=[Grid(f"Over {where}", *table, footnotes(table))])


def _scenario(comparison: Comparison, record: Record, scenario: str) -> Section:
    count = next(iter(comparison.on(scenario).values())).result.count
    results, differences = scenario_table(record, scenario), difference_table(record, scenario)
    tables = [Grid("Results", *results, footnotes(results))]
    if len(differences[0]) > 1:
        about = ["On the same seeds; kept, success and time connected in percentage points."]
        tables.append(Grid("Difference to the expert", *differences, about))
    tables.append(Grid("Connectivity and estimators", *estimator_table(record, scenario)))
    lost, total = lost_table(comparison, record, scenario)
    if total:
        note = [f"The first {MOST_LOST} of {total}."] if total > MOST_LOST else []
        note.append("lambda2_hat, mean over the robots, and |cos| between their v2 and the true one: one step before.")
        tables.append(Grid("Teams that the expert and its variants lost", *lost, note))
    order = " Policies by success, the best first." if len(comparison.on(scenario)) > 1 else ""
    lines = [f"{count} episode{'s' if count > 1 else ''} a policy, all from the same seeds.{order}"]
    return Section(scenario, lines, tables=tables)


def _anchor(text: str) -> str:
    """A text as a place in the page."""
    return re.sub(r"[^a-z0-9-]+", "-", text.lower()).strip("-")


def _term(head: str) -> str:
    """The definition of a column, "" if there is none."""
    return next((name for name, _ in TERMS if name in head), "")


def _shown(value: Any) -> Any:
    """A value of the page; a file in UTF-8 takes no half of a letter."""
    return printable(value) if type(value) is str else value


def _embedded(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def _link(folder: Path) -> str:
    """Address of docs/metrics.md as seen from the folder; "" outside of the repository."""
    inside = METRICS.is_file() and folder.resolve().is_relative_to(ROOT)
    return Path(os.path.relpath(METRICS, folder.resolve())).as_posix() if inside else ""
