"""Records as tables of text, for the terminal, the report and the docs: the one place where numbers become words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

from fovconn_env import Scenario, scenario
from fovconn_env.flights.metrics import ENDED
from fovconn_env.training.evaluation import cameras, envelope
from fovconn_env.training.evaluation.ablations import PANELS, Panel
from fovconn_env.training.evaluation.comparison import EXPERT
from fovconn_env.training.evaluation.leaderboard_tables import leaderboard_tables
from fovconn_env.training.evaluation.learned import ROWS, Row
from fovconn_env.training.evaluation.record import Record, Result
from fovconn_env.training.evaluation.text import (
    ORACLE,
    Table,
    estimate,
    figures,
    markdown,
    marked,
    number,
    percent,
    settings_in_words,
)

FOOTNOTE = f"{ORACLE} an oracle: its robots know more than they can"
KEPT, SUCCESS = "never_disconnected", "success"
ON_CARD = ("expert", "augmented", "recovery", "oracle")  # policies on the card of a scenario
CARD = (  # what a row is called, the measures it shows, and how; "share" is in percent, with its 95 % interval
    ("never disconnected, %", (KEPT,), "share"),
    ("success, %", (SUCCESS,), "share"),
    ("collision, %", ("collision",), "share"),
    ("time connected", ("connected_share",), ".2%"),
    ("lambda2, least (mean over episodes)", ("min_lambda2",), ".3f"),
    ("lambda2, mean (clipped at lambda2_max)", ("mean_lambda2",), ".3f"),
    ("leader's progress (achieved / pushed)", ("progress",), ".3f"),
    ("duration, s", ("duration",), ".1f"),
    ("links lost per minute", ("links_lost_per_minute",), ".1f"),
    ("pairs in mutual / one-way view", ("mutual_share", "one_way_share"), ".0%"),
    ("least separation, m (worst episode)", ("least_separation",), ".2f"),
    ("lambda2_hat relative error, p50 / p95", ("lambda2_error_median", "lambda2_error_p95"), ".2%"),
    ("sin(yaw error / 2), rms, mutual / one-way", ("yaw_rms_mutual", "yaw_rms_one_way"), ".4f"),
    ("yaw valid, share of mutual / one-way time", ("yaw_valid_mutual", "yaw_valid_one_way"), ".1%"),
    ("bytes sent per robot and second", ("bytes_per_second",), ",.0f"),
)


def tables(record: Record) -> dict[str, Table]:
    """All tables of a record by name; of `eval` "overall", "kept and success", and four of each scenario."""
    return _STUDIES[record.study](record)


# -------------------------------------------------------------------------------------------------- policies compared
def scenario_table(record: Record, name: str) -> Table:
    """What the policies were worth on a scenario; a terminal of 120 letters is wide enough."""
    columns = {
        "policy": lambda result: marked(record, result.policy),
        "kept %": lambda result: percent(result.measures[KEPT]),
        "success %": lambda result: percent(result.measures[SUCCESS]),
        "collided": lambda result: f"{result.count * result.measures['collision'].value:.0f}",
        "connected": lambda result: number(100 * result.measures["connected_share"].value, ".2f") + " %",
        "progress": lambda result: number(result.measures["progress"].value, ".3f"),
        "score IQM": lambda result: estimate(result.measures["score"], "z.2f"),
        "> expert %": lambda result: percent(result.difference(EXPERT, "improvement")),
    }
    columns |= {f"{title} %": partial(_share, measure) for measure, title in own_ends(_on(record, name)).items()}
    return _table(_on(record, name), columns, always=6)


def difference_table(record: Record, name: str) -> Table:
    """Differences to the expert on the same seeds; shares in percentage points."""
    columns = {
        "policy": lambda result: marked(record, result.policy),
        "kept": lambda result: estimate(result.difference(EXPERT, KEPT), "+z.1f", 100),
        "success": lambda result: estimate(result.difference(EXPERT, SUCCESS), "+z.1f", 100),
        "connected": lambda result: estimate(result.difference(EXPERT, "connected_share"), "+z.1f", 100),
        "progress": lambda result: estimate(result.difference(EXPERT, "progress"), "+z.3f"),
    }
    return _table([result for result in _on(record, name) if result.policy != EXPERT], columns, always=1)


def estimator_table(record: Record, name: str) -> Table:
    """How strongly the team was connected, how well the robots knew it, and what that cost."""
    columns = {
        "policy": lambda result: marked(record, result.policy),
        "mean lambda2": lambda result: number(result.measures["mean_lambda2"].value, ".2f"),
        "lambda2 error p50": lambda result: figures(result.measures["lambda2_error_median"].value),
        "p95": lambda result: figures(result.measures["lambda2_error_p95"].value),
        "yaw rms mutual": lambda result: number(result.measures["yaw_rms_mutual"].value, ".4f"),
        "one-way": lambda result: number(result.measures["yaw_rms_one_way"].value, ".4f"),
        "B/s": lambda result: number(result.measures["bytes_per_second"].value, ",.0f"),
    }
    return _table(_on(record, name), columns, always=7)


def matrix(record: Record) -> Table:
    """Shares of episodes kept and of successes, policies by scenarios."""
    names = _scenarios(record)
    shares = {(result.policy, result.scenario): _kept_and_success(result, ".1f") for result in record.results}
    rows = [[marked(record, p), *(shares.get((p, name), "-") for name in names)] for p in record.policies]
    return ["policy", *names], rows


def overall_table(record: Record) -> Table:
    """The policies over all scenarios together."""
    columns = {
        "policy": lambda result: marked(record, result.policy),
        "mean kept %": lambda result: number(100 * result.measures[KEPT].value, ".1f"),
        "mean success %": lambda result: number(100 * result.measures[SUCCESS].value, ".1f"),
        "score IQM": lambda result: estimate(result.measures["score"], "z.2f"),
        "> expert %": lambda result: percent(result.difference(EXPERT, "improvement")),
    }
    return _table(record.overall, columns, always=3)


def card(results: Mapping[str, Result], rows: Sequence[tuple[str, Sequence[str], str]] = CARD) -> Table:
    """Measure by measure, a column for each result under its name; rows as in `CARD`."""
    every = [*rows, *((f"{title}, %", (measure,), "share") for measure, title in own_ends(results.values()).items())]
    lines = [[title, *(_cell(result, names, form) for result in results.values())] for title, names, form in every]
    return ["measure", *results], lines


def own_ends(results: Iterable[Result]) -> dict[str, str]:
    """The measures that say whether own terminations ended the episodes, and what they are called in tables."""
    names = dict.fromkeys(name for result in results for name in result.measures if name.startswith(ENDED))
    return {name: f"ended by {name.removeprefix(ENDED)}" for name in names}


def _share(measure: str, result: Result) -> str:
    return percent(result.measures[measure])


def _cell(result: Result, names: Sequence[str], form: str) -> str:
    if form == "share":
        return percent(result.measures[names[0]])
    return " / ".join(number(result.measures[name].value, form) for name in names)


def _eval_tables(record: Record) -> dict[str, Table]:
    result = {"overall": overall_table(record), "kept and success": matrix(record)}
    for name in _scenarios(record):
        result[name] = scenario_table(record, name)
        result[f"{name} differences"] = difference_table(record, name)
        result[f"{name} estimators"] = estimator_table(record, name)
        shown = {marked(record, each.policy): each for each in _on(record, name) if each.policy in ON_CARD}
        if shown:
            result[f"{name} card"] = card(shown)
    return result


# ------------------------------------------------------------------------------------------------------ other studies
def level_table(record: Record, name: str) -> Table:
    """The levels of a scenario: all settings that differ from the defaults, and what each policy keeps and finishes."""
    rows = []
    for level, by_policy in _levels(record, name).items():
        shares = [_kept_and_success(result, ".0f") for result in by_policy.values()]
        rows.append([*_level_cells(name, level, by_policy), *shares])
    return ["level", "settings", "episodes", *(marked(record, policy) for policy in record.policies)], rows


def estimate_table(record: Record, name: str) -> Table:
    """What lambda2 is worth on the levels of a scenario, and what its messages weigh, iterated and flooded."""
    policies, rows = ("expert", "expert-flooding"), []
    for level, by_policy in _levels(record, name).items():
        measures = [by_policy[policy].measures for policy in policies]
        errors = [100 * each["lambda2_error_median"].value for each in measures]
        cells = [f"{each['bytes_per_second'].value:,.0f}" for each in measures]
        cells += [f"{error:.0f} %" if error >= 10 else f"{error:.2g} %" for error in errors]
        rows.append([*_level_cells(name, level, by_policy), *cells])
    head = [f"{quantity}, {policy}" for quantity in ("B/s", "error") for policy in policies]
    return ["level", "settings", "episodes", *head], rows


def _levels(record: Record, name: str) -> dict[int, dict[str, Result]]:
    levels: dict[int, dict[str, Result]] = {}
    for result in _on(record, name):
        levels.setdefault(result.settings["level"], {})[result.policy] = result
    return levels


def _level_cells(name: str, level: int, by_policy: Mapping[str, Result]) -> list[str]:
    changed = settings_in_words(scenario(name, level=level), Scenario())
    text = " ".join(f"`{setting}={value}`" for setting, value in changed.items()) or "-"
    return [f"{level}", text, f"{next(iter(by_policy.values())).count}"]


def _level_tables(record: Record) -> dict[str, Table]:
    result = {}
    for name in _scenarios(record):
        result |= {name: level_table(record, name), f"{name} lambda2": estimate_table(record, name)}
    return result


def learned_table(record: Record, rows: Sequence[Row]) -> Table:
    """Policies beside others on the same seeds; differences in percentage points."""
    head = ["policy", "flown on", "kept %", "success %", "progress"]
    head += ["against", "kept, difference", "success, difference", "its progress"]
    lines = []
    for row in rows:
        own, other = (record.find(policy, row.scenario, dict(row.settings)) for policy in (row.policy, row.against))
        task = " ".join([row.scenario, *(f"`{name}={value}`" for name, value in row.settings)])
        shares = [estimate(own.measures[name], ".1f", 100) for name in (KEPT, SUCCESS)]
        signed = [estimate(own.difference(row.against, name), "+.1f", 100) for name in (KEPT, SUCCESS)]
        progress = [number(each.measures["progress"].value, ".2f") for each in (own, other)]
        lines.append([row.policy, task, *shares, progress[0], row.against, *signed, progress[1]])
    return head, lines


def ablation_table(record: Record, panels: Sequence[Panel] | None = None) -> Table:
    """All points of all panels, those of the ablations by default."""
    rows = []
    for panel in panels or PANELS:
        title = f"{panel.title}, {panel.axis}" if panel.axis else panel.title
        for point in panel.points:
            measures = record.find(*point.task).measures
            place = point.label if point.at is None else f"{point.at:g}"
            shares = [percent(measures[name]) for name in (KEPT, SUCCESS)]
            numbers = [f"{measures['progress'].value:.2f}", f"{measures['lambda2_error_median'].value:.2%}"]
            rows.append([title, place, point.policy, *shares, *numbers])
    return ["study", "point", "policy", "kept %", "success %", "progress", "lambda2 error p50"], rows


def camera_table(record: Record) -> Table:
    """All points of the sweeps over what a camera lacks, with what they are drawn by."""
    head, rows = ablation_table(record, cameras.PANELS)
    points = [point for panel in cameras.PANELS for point in panel.points]
    for row, point in zip(rows, points, strict=True):
        measures = record.find(*point.task).measures
        row += [number(measures[name].value, ".3f") for name in ("yaw_rms_mutual", "yaw_rms_one_way", "named_share")]
        row.append(number(measures["name_swaps"].value, ".2f"))
    return [*head, "yaw, mutual", "yaw, one-way", "named share", "swaps a flight"], rows


def envelope_table(record: Record) -> Table:
    """The policy on each task beside the law that is best there, and its difference to that law, in points.

    The mean is that of the levels; teams of other sizes come behind it.
    """
    head = ["flown on", "episodes", "best law", "its success %", f"{envelope.POLICY} %", "difference", "progress"]
    lines, own, best, levels = [], [], [], envelope.levels()
    for name, settings in levels + envelope.sizes():
        policy = record.find(envelope.POLICY, name, dict(settings))
        law = envelope.best_law(record, name, settings)
        own.append(policy.measures[SUCCESS].value)
        best.append(law.measures[SUCCESS].value)
        task = " ".join([name, *(f"`{setting}={value}`" for setting, value in settings)])
        cells = [percent(policy.measures[SUCCESS]), estimate(policy.difference(law.policy, SUCCESS), "+.1f", 100)]
        progress = number(policy.measures["progress"].value, ".2f")
        lines.append([task, f"{policy.count}", law.policy, f"{100 * best[-1]:.1f}", *cells, progress])
    count = len(levels)
    means = [f"{100 * sum(values[:count]) / count:.1f}" for values in (best, own)]
    return head, [*lines[:count], ["mean of the levels", "", "", *means, "", ""], *lines[count:]]


_STUDIES: dict[str, Callable[[Record], dict[str, Table]]] = {
    "eval": _eval_tables,
    "levels": _level_tables,
    "learned": lambda record: {name: learned_table(record, rows) for name, rows in ROWS.items()},
    "envelope": lambda record: {"levels": envelope_table(record)},
    "ablations": lambda record: {"points": ablation_table(record)},
    "leaderboard": leaderboard_tables,
    "cameras": lambda record: {"points": camera_table(record)},
}


# -------------------------------------------------------------------------------------------------------------- parts
def footnotes(table: Table) -> list[str]:
    """The footnotes that a table needs."""
    return [FOOTNOTE] if any(ORACLE in cell for row in table[1] for cell in row[:2]) else []


def run_line(record: Record) -> str:
    """Seeds, date, versions and time of a record in a sentence."""
    run = record.run
    versions = [f"fovconn_env {record.version}", *(f"{name} {run[name]}" for name in ("python", "numpy", "numba"))]
    took = run.get("reused") or f"{run['seconds']:.0f} s on {run['cores']} cores"
    return f"Seeds {record.seeds[0]} to {record.seeds[-1]}, {run['finished'][:10]}, {', '.join(versions)}; {took}."


def _on(record: Record, name: str) -> list[Result]:
    return [result for result in record.results if result.scenario == name]


def _scenarios(record: Record) -> list[str]:
    return list(dict.fromkeys(result.scenario for result in record.results))


def _kept_and_success(result: Result, form: str) -> str:
    return " / ".join(format(100 * result.measures[name].value, form) for name in (KEPT, SUCCESS))


def _table(results: Iterable[Result], columns: Mapping[str, Callable[[Result], str]], always: int) -> Table:
    """Cells of all results; a column after the first `always` is left out where it has nothing to say."""
    results = list(results)
    cells = {head: [cell(result) for result in results] for head, cell in columns.items()}
    shown = [head for k, head in enumerate(cells) if k < always or any(text != "-" for text in cells[head])]
    return shown, [list(row) for row in zip(*(cells[head] for head in shown), strict=True)]


def page(file: Path, record: Record, origin: str = "Made by `make docs`") -> str:
    """A Markdown page with all tables of a record, which lies in `file`; origin: how the page was made."""
    parts = [f"# All tables of {file.name}", f"{origin} of [{file.name}]({file.name}). {run_line(record)}"]
    for title, table in tables(record).items():
        parts += [f"## {title}", markdown(table), *footnotes(table)]
    return "\n\n".join(parts) + "\n"
