"""The tables of a leaderboard's record, see `leaderboard.ranked`."""

from __future__ import annotations

from fovconn_env.training.evaluation.record import Record, Result
from fovconn_env.training.evaluation.text import Table, escape, estimate, marked, number

SUCCESS = "success"
CEILING = "oracle-planner"  # what it reaches is known to be possible


def leaderboard_tables(record: Record) -> dict[str, Table]:
    """All tables of a leaderboard, in Markdown: "ranking", and one of each suite. Names in it may be a stranger's."""
    head, rows = ranking_table(record)
    suites = {suite: suite_table(record, suite) for suite in record.run["suites"]}
    return {"ranking": ([escape(cell) for cell in head], [[escape(cell) for cell in row] for row in rows]), **suites}


def ranking_table(record: Record) -> Table:
    """A row for each policy: its rank, its success over each suite, how far it is from the first, where it is from."""
    suites = list(record.run["suites"])
    of = {(result.policy, result.scenario): result for result in record.overall}
    first = ordinary(record)[0]
    head = ["rank", "policy", *(f"{name}, success %" for name in suites), f"{suites[0]}, points to the first"]
    rows = []
    for name in columns(record):
        own, about = of[name, suites[0]], record.policies[name]
        shares = [number(100 * of[name, suite].measures[SUCCESS].value, ".1f") for suite in suites]
        behind = estimate(own.difference(first, SUCCESS), "+z.1f", 100)
        origin = [str(about[key] or "-") for key in ("fovconn_env", "commit", "command")]
        rows.append([ranks(record, suites[0]).get(name, "-"), marked(record, name), *shares, behind, *origin])
    return [*head, "fovconn_env", "commit", "command"], rows


def suite_table(record: Record, suite: str) -> Table:
    """Success on each task of a suite, in percent; bold where no other policy is better beyond doubt."""
    rows = []
    for task, results in tasks_of(record, suite).items():
        cells = [_cell(record, results[name]) for name in columns(record)]
        rows.append([task, f"{next(iter(results.values())).count}", *cells])
    return ["task", "episodes", *(escape(marked(record, name)) for name in columns(record))], rows


def tasks_of(record: Record, suite: str) -> dict[str, dict[str, Result]]:
    """The results of a suite, by task and policy."""
    tasks: dict[str, dict[str, Result]] = {}
    for result in record.results:
        if result.scenario in record.run["suites"][suite]:
            tasks.setdefault(result.scenario, {})[result.policy] = result
    return tasks


def columns(record: Record) -> list[str]:
    """The policies, the best one first; oracles come last, and of them the ceiling."""
    oracles = [name for name in record.policies if record.policies[name]["oracle"]]
    return [*ordinary(record), *sorted(oracles, key=lambda name: name == CEILING)]


def ordinary(record: Record) -> list[str]:
    """The policies that are ranked, the best one first: all but oracles, or all if there are no others."""
    return [name for name in record.policies if not record.policies[name]["oracle"]] or list(record.policies)


def ranks(record: Record, suite: str) -> dict[str, str]:
    """One more than the number of policies that are better beyond doubt; "=" where another may be as good."""
    names = ordinary(record)
    of = {result.policy: result for result in record.overall if result.scenario == suite}
    differences = {name: [of[name].difference(other, SUCCESS) for other in names if other != name] for name in names}
    better = {name: sum(each.high < 0 for each in differences[name]) for name in names}
    tied = {name: any(not (each.high < 0 or each.low > 0) for each in differences[name]) for name in names}
    return {name: f"{1 + better[name]}" + "=" * tied[name] for name in names}


def _cell(record: Record, result: Result) -> str:
    share = f"{100 * result.measures[SUCCESS].value:.0f}"
    best = result.policy in ordinary(record) and all(each[SUCCESS].high >= 0 for each in result.against.values())
    return f"**{share}**" if best else share
