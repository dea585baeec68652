"""The files that a campaign leaves: results.json, marl-eval.json, and the report with its pictures."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fovconn_env.baselines import ORACLES, POLICIES, find_pilot
from fovconn_env.baselines.learned.policy import Learned
from fovconn_env.files import write_files
from fovconn_env.scenarios.serialize import scenario_to_json
from fovconn_env.training.evaluation.comparison import Comparison, compare
from fovconn_env.training.evaluation.draft import Draft, can_draw
from fovconn_env.training.evaluation.flights import Evaluation, label, origin
from fovconn_env.training.evaluation.marl_eval import to_marl_eval
from fovconn_env.training.evaluation.provenance import digest, seen_from_here, sources
from fovconn_env.training.evaluation.record import Record, about, json_text, run_block, to_json

DIGITS = 16  # of a hash that is shown


class Published(NamedTuple):
    """What was made of a campaign."""

    record: Record
    files: list[Path]


def publish(
    results: Sequence[Evaluation],
    policies: Sequence[str],
    settings: Mapping[str, Any],
    folder: Path,
    seconds: float,
    draft: Draft | None = None,
) -> Published:
    """Write results.json, marl-eval.json and the report into a folder: all of them or, after an exception, none.

    policies: as `find_pilot` takes them; settings: changed from the presets; seconds: what the flights took;
    draft: of the same policies, settings and folder, what was made while they flew.
    """
    compared, drawn = draft.parts() if draft is not None else ({}, {})
    comparison = compare(results, settings, compared)
    kinds = {label(policy): about(policy) for policy in policies}
    told = origin(results)
    record = record_of(comparison, kinds)._replace(run=run_block(seconds) | told)
    texts = {
        folder / "results.json": json_text(to_json(record)),
        folder / "marl-eval.json": json_text(to_marl_eval(results)),
    }
    pictures: list[Path] = []
    if can_draw():
        from fovconn_env.training.evaluation.report import make_report

        report, pictures = make_report(comparison, record, folder, _head(record, settings, policies) | told, drawn)
        texts |= report
    write_files({file: text.encode() for file, text in texts.items()})
    return Published(record, [*texts, *pictures])


def record_of(comparison: Comparison, policies: Mapping[str, Mapping[str, Any]]) -> Record:
    """The numbers of a comparison; policies: what each is, see `about`."""
    evaluations = [compared.evaluation for compared in comparison.compared.values()]
    scenarios = {each.scenario.name: scenario_to_json(each.scenario) for each in evaluations}
    results = [compared.result for compared in comparison.compared.values()]
    kinds = {policy: dict(policies[policy]) for policy in comparison.policies}
    seeds = max((each.seeds for each in evaluations), key=len)  # others have the first of them
    return Record("eval", list(seeds), kinds, results, comparison.overall, scenarios)


def _head(record: Record, settings: Mapping[str, Any], policies: Sequence[str]) -> dict[str, str]:
    """What the report says at its top."""
    seeds, run = record.seeds, record.run
    spread = f"{min(seeds)} to {max(seeds)}" if len(seeds) > 1 else f"{seeds[0]}"
    return {
        "seeds": f"{spread} ({len(seeds)})",
        "settings": ", ".join(f"{name}={value!r}" for name, value in settings.items()) or "the presets'",
        "machine": f"{run['cpu']}, {run['cores']} cores, {run['system']}",
        "versions": f"fovconn_env {record.version}, Python {run['python']}, numpy {run['numpy']}, numba {run['numba']}",
        "flown": run["finished"],
        "command": shlex.join([Path(sys.argv[0]).stem, *sys.argv[1:]]),
        **{kind: "; ".join(each) for kind, each in _identities(policies).items() if each},
    }


def _identities(policies: Sequence[str]) -> dict[str, list[str]]:
    """Where the policies that are no code of this package come from, with the beginning of the hash of each file."""
    own, learned = [], []
    for policy in policies:
        kind, shipped = find_pilot(policy), policy in (*POLICIES, *ORACLES)
        weights = [kind.file] if shipped and issubclass(kind, Learned) else []
        files = [str(file) for file in weights or sources(kind)]
        names = [Path(file).name if weights else seen_from_here(file) for file in files]
        hashes = [f"{name} {digest(file)[:DIGITS]}" for name, file in zip(names, files, strict=True)]
        about = f"{label(policy)} is {policy}" + f" (SHA-256 of {', '.join(hashes)})" * bool(hashes)
        if not shipped:
            own.append(about)
        elif hashes:
            learned.append(f"{label(policy)} (SHA-256 of {hashes[0]})")
    return {"own policies": own, "learned policies": learned}
