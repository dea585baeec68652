"""Whether docs/results is complete, comes out again as it was published, and holds what the project promises.

The last step of `make results`: `python -m fovconn_env.training.evaluation check`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fovconn_env import HARD, PRESETS, scenario
from fovconn_env.baselines import ORACLES, POLICIES
from fovconn_env.baselines.laws.filters import split_name
from fovconn_env.training.evaluation import ablations, cameras, envelope, learned, levels
from fovconn_env.training.evaluation.campaign import DEV_SEEDS
from fovconn_env.training.evaluation.flights import SHARES, evaluate
from fovconn_env.training.evaluation.record import Record, Result, about, load
from fovconn_env.training.evaluation.study import Study

ROOT = Path(__file__).resolve().parents[2]
KEPT, SUCCESS = "never_disconnected", "success"
HIDDEN = ("LeaderObstacles-v0", "Corridor-v0", "NarrowCamera-v0", "LossyRadio-v0", "Blackout-v0")
Claims = Iterator[tuple[str, bool]]  # what is claimed, and whether it holds


def check() -> int:
    """Print every claim that does not hold; the exit status."""
    records = {file.stem: load(file) for file in sorted((ROOT / "docs" / "results").glob("*.json"))}
    claims = [*complete(records), *bars(records)]
    for name, record in records.items():
        if name != "leaderboard":  # `fovconn leaderboard` flies four times as many again before it writes them
            claims += [(f"{name}: {claim}", holds) for claim, holds in repeated(record)]
    failed = [claim for claim, holds in claims if not holds]
    for claim in failed:
        print(f"does not hold: {claim}")
    print(f"{len(claims) - len(failed)} of {len(claims)} claims about docs/results hold")
    return int(bool(failed))


def repeated(record: Record) -> Claims:
    """Each result's first episodes, flown again. Episodes of other seeds differ by far more than is let through."""
    for result in (result for result in record.results if result.episodes and _is_ours(result.policy)):
        seeds = record.seeds[: len(result.episodes["duration"])]
        episodes = evaluate(result.policy, scenario(result.scenario, **result.settings), seeds).episodes
        same = all(result.episodes[name] == episodes[name].tolist() for name in SHARES)
        # rounding differs between processors, and flights are chaotic
        same = same and np.allclose(result.episodes["duration"], episodes["duration"], rtol=0.05)
        yield f"{result.policy} on {result.scenario} {result.settings} comes out as published", bool(same)


def complete(records: dict[str, Record]) -> Claims:
    """Every record is of policies with the equipment they have, and of all tasks of its study."""
    for name, record in records.items():
        yield f"{name} is of our own policies", all(map(_is_ours, record.policies))
        same = all(
            _is_ours(policy) and _equipment(kind) == _equipment(about(policy))
            for policy, kind in record.policies.items()
        )
        yield f"{name} has policies with the equipment they have", same
    full = records["full"]
    suite = {(policy, name) for policy in POLICIES for name in PRESETS}
    yield "full has all policies on all scenarios", {result[:2] for result in full.results} == suite
    yield "full has all seeds", full.seeds == list(DEV_SEEDS)
    board = records["leaderboard"]
    suite = {(policy, name) for policy in (*POLICIES, *ORACLES) for name in (*HARD, *PRESETS)}
    yield "leaderboard has all policies on both suites", {result[:2] for result in board.results} == suite
    yield "leaderboard has all seeds", board.seeds == list(DEV_SEEDS)
    yield "thousand and fast have 1000 seeds", all(len(records[name].seeds) == 1000 for name in ("thousand", "fast"))
    seeds = records["ablations"].seeds
    for name, study in {
        "levels": levels.study(),
        "learned": learned.study(),
        "ablations": ablations.study(seeds),
        "cameras": cameras.study(),
        "envelope": envelope.study(),
    }.items():
        yield f"{name} has all tasks of its study", _tasks(records[name]) == _study_tasks(study)


def bars(records: dict[str, Record]) -> Claims:
    """What the policies are to be worth."""
    yield from _bars_of_laws(records["thousand"], records["fast"])
    yield from _bars_of_levels(records["levels"])
    yield from _bars_of_imitation(records["learned"])
    yield from _bars_of_reward(records["learned"])
    yield from _bars_of_hard(records["leaderboard"])
    yield from _bars_of_generalist(records["envelope"])


def _bars_of_laws(thousand: Record, fast: Record) -> Claims:
    by_policy = {result.policy: result for result in thousand.results}
    expert, augmented = by_policy["expert"], by_policy["augmented"]
    yield "expert-flooding keeps 99.5 %", _value(by_policy["expert-flooding"], KEPT) >= 0.995
    yield "the expert keeps 98.5 %", _value(expert, KEPT) >= 0.985
    yield "omni keeps fewer than the expert", by_policy["omni"].difference("expert", KEPT).high < 0
    yield "augmented is 1.8 times as fast", _value(augmented, "progress") >= 1.8 * _value(expert, "progress")
    for record in (thousand, fast):
        for result in record.results:
            if result.policy == "augmented":
                yield "augmented keeps as many as the expert", result.difference("expert", KEPT).low > -0.01
            if result.policy in ("expert", "expert-flooding", "augmented"):
                yield f"{result.policy} does not collide", _value(result, "collision") == 0.0


def _bars_of_levels(record: Record) -> Claims:
    """On one level at least, better estimates are what is missing."""
    kept = {(each.policy, each.scenario, each.settings["level"]): _value(each, KEPT) for each in record.results}
    levels = {(each.scenario, each.settings["level"]) for each in record.results if each.count >= 128}
    yield (
        "on a level the expert keeps less than half of the teams, the oracle 90 %",
        any(kept["expert", *level] < 0.5 and kept["oracle", *level] >= 0.9 for level in levels),
    )


def _bars_of_imitation(record: Record) -> Claims:
    for row in learned.ROWS["imitation"]:
        own, expert = record.find(row.policy, row.scenario), record.find(row.against, row.scenario)
        yield f"{row.policy} keeps as many as the expert", own.difference("expert", KEPT).value >= -0.01
        yield f"{row.policy} succeeds as often as the expert", own.difference("expert", SUCCESS).value >= -0.02
        progress = _value(own, "progress") / _value(expert, "progress")
        yield f"{row.policy} is as fast as the expert", abs(progress - 1.0) <= 0.03
    for row in learned.ROWS["teams"]:
        own, expert = (record.find(policy, row.scenario, dict(row.settings)) for policy in (row.policy, row.against))
        yield f"dagger keeps teams with {row.settings}", _value(own, KEPT) >= 0.95 * _value(expert, KEPT)


def _bars_of_reward(record: Record) -> Claims:
    own, expert = (record.find(policy, learned.FOLLOW) for policy in ("residual", "expert"))
    yield "residual is 1.8 times as fast as the expert", _value(own, "progress") >= 1.8 * _value(expert, "progress")
    yield "residual is as safe as the expert", own.difference("expert", KEPT).high >= 0.0
    gains = {name: record.find("residual", name).difference("augmented", SUCCESS).low for name in learned.EVERYWHERE}
    yield "residual is nowhere worse than augmented", min(gains.values()) >= -0.02
    yield "residual is better on two hard scenarios", sum(gains[name] > 0.0 for name in HIDDEN) >= 2
    narrow = record.find("residual", "LossyRadio-v0", {"level": 3})
    yield "residual keeps four of five where the expert fails", _value(narrow, KEPT) >= 0.8
    for row in learned.ROWS["filter"]:
        own, bare = record.find(row.policy, row.scenario), record.find(row.against, row.scenario)
        yield f"the filter costs {row.against} nothing", own.difference(row.against, KEPT).low >= -0.01
        helps = _value(bare, KEPT) == 1.0 or _value(own, KEPT) > _value(bare, KEPT)
        yield f"the filter helps {row.against}", helps


def _bars_of_hard(board: Record) -> Claims:
    """What makes a task hard, docs/scenarios.md."""
    for task in HARD:
        shares = {each.policy: _value(each, SUCCESS) for each in board.results if each.scenario == task}
        others = [policy for policy in shares if not board.policies[policy]["oracle"] and policy != envelope.POLICY]
        best = max(shares[policy] for policy in others)  # that has not trained on these tasks
        yield f"the best other policy has success in 10 to 80 % on {task}", 0.1 <= best <= 0.8
        yield f"oracle-planner has success in 90 % on {task}", shares["oracle-planner"] >= 0.9


def _bars_of_generalist(record: Record) -> Claims:
    """One network beside the best law of each level."""
    own, best = [], []
    for name, settings in envelope.levels():
        policy = record.find(envelope.POLICY, name, dict(settings))
        law = envelope.best_law(record, name, settings)
        own.append(_value(policy, SUCCESS))
        best.append(_value(law, SUCCESS))
        near = policy.difference(law.policy, SUCCESS).high >= -0.03  # few flights of large teams say little
        yield f"{envelope.POLICY} is not clearly 3 points below {law.policy} on {name} {dict(settings)}", near
    yield f"{envelope.POLICY} succeeds as often as the best law of each level", sum(own) >= sum(best)


def _is_ours(policy: str) -> bool:
    """Whether a name is one of ours: the name of a file of code, from a file of results, is not run."""
    return split_name(policy)[1] in (*POLICIES, *ORACLES)


def _value(result: Result, measure: str) -> float:
    return result.measures[measure].value


def _equipment(kind: Mapping[str, Any]) -> tuple[Any, Any]:
    return kind["overrides"], kind["oracle"]


def _tasks(record: Record) -> list[str]:
    """Who flew what from how many seeds, in a form that can be sorted."""
    return sorted(f"{result[:4]} {list(result.against)}" for result in record.results)


def _study_tasks(study: Study) -> list[str]:
    tasks = [((*task[:2], dict(task.settings), task.count), list(task.against)) for task in study.tasks]
    return sorted(f"{task} {against}" for task, against in tasks)
