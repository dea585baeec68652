"""A submission to the leaderboard: a policy with all files that it is made of, and the outcome of every episode."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
import os
import platform
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numba
import numpy as np

import fovconn_env
from fovconn_env import Scenario
from fovconn_env.baselines import ORACLES, POLICIES, Pilot, Policy, find_pilot
from fovconn_env.baselines.laws.filters import split_name
from fovconn_env.errors import SettingError, rule
from fovconn_env.fields import check_array, check_keys, check_texts
from fovconn_env.files import Archive, Damaged, Kind, one_line, read_archive, write_archive
from fovconn_env.scenarios.scenario import ON_BOARD
from fovconn_env.scenarios.serialize import scenario_to_json
from fovconn_env.text import printable
from fovconn_env.training.evaluation.flights import SHARES, Evaluation
from fovconn_env.training.evaluation.provenance import Files, commit, packages, sources
from fovconn_env.training.evaluation.record import Record, about, from_json, result_of, run_block, to_json
from fovconn_env.training.evaluation.shelf import code_hash

SUBMISSION = Kind("fovconn_submission", "submission", "fovconn submit writes them, as .npz", 1)
OUTCOMES = (*SHARES, "duration")  # what is kept of every episode, and must come out again
_HEADER = ("policy", "suites", "settings", "files", "record")


class Submission(NamedTuple):
    """One policy on all tasks of some suites."""

    policy: str  # as `find_pilot` takes it in the folder of its files
    suites: dict[str, list[str]]  # the tasks of each
    settings: dict[str, str]  # of each task, see `settings_hash`
    files: dict[str, bytes]  # of the policy, by their path in its folder; none of a policy of this package
    record: Record  # of the one policy, with `OUTCOMES` of all episodes

    @property
    def label(self) -> str:
        """What the policy is called in tables."""
        (name,) = self.record.policies
        return name


def submission(policy: str, suites: Mapping[str, Sequence[Evaluation]], files: Files, seconds: float) -> Submission:
    """The submission of a policy; suites: its evaluations; files: what it consists of and has read, by path.

    Raises `SettingError` for code of the policy that is not below the current folder: it would not be found again.
    """
    evaluations = [each for group in suites.values() for each in group]
    results = [result_of(each) for each in evaluations]
    results = [
        each._replace(episodes={name: each.episodes[name] for name in OUTCOMES}, histograms={}) for each in results
    ]
    seeds = max((each.seeds for each in evaluations), key=len)
    kind = find_pilot(policy)
    run = run_block(seconds) | versions() | {"packages": packages(sources(kind))}
    run["command"] = shlex.join(["fovconn", "submit", policy])
    what = about(policy) | {"oracle": is_oracle(kind, [each.scenario for each in evaluations])}
    record = Record("submission", list(seeds), {results[0].policy: what}, results, run=run)
    tasks = {name: [each.scenario.name for each in group] for name, group in suites.items()}
    settings = {each.scenario.name: settings_hash(each.scenario) for each in evaluations}
    contents = packed(policy, files)
    _check_code(policy, contents)
    return Submission(policy, tasks, settings, contents, record)


def is_shipped(policy: str) -> bool:
    """Whether a policy is one of this package, with or without a filter."""
    return split_name(policy)[1] in (*POLICIES, *ORACLES)


def _check_code(policy: str, files: Mapping[str, bytes]) -> None:
    """`SettingError` for a policy without files that is none of this package: whoever flies it would lack it."""
    rule(bool(files) or is_shipped(policy), "policy", "of this package, or in files", policy, "name its file")


def is_oracle(kind: type[Pilot], tasks: Sequence[Scenario]) -> bool:
    """Whether a policy says so, acts by the truth, or has its team equipped with more than it computes on board."""
    return kind.oracle or not issubclass(kind, Policy) or not all(_on_board(task, kind.equip(task)) for task in tasks)


def _on_board(task: Scenario, equipped: Scenario) -> bool:
    values = {item.name: getattr(equipped, item.name) for item in dataclasses.fields(task)}
    changed = {name: value for name, value in values.items() if value != getattr(task, name)}
    return all(name in ON_BOARD and value != "true" for name, value in changed.items())


def packed(policy: str, files: Files) -> dict[str, bytes]:
    """The contents of a policy's files below the current folder, by their path there; raises as `submission`."""
    here, result = os.path.realpath("."), {}
    for file in map(str, sources(find_pilot(policy))):
        inside = file.startswith(os.path.join(here, ""))
        hint = "go to the folder that holds all of it, and name the policy from there"
        rule(inside, f"the files of policy {policy!r}", f"below the current folder {here!r}", file, hint)
    for path in files:
        if path.startswith(os.path.join(here, "")) and os.path.isfile(path):
            result[Path(path).relative_to(here).as_posix()] = Path(path).read_bytes()
    return result


def left_out(files: Files) -> list[str]:
    """Files that a policy has read and that are not packed: they lie elsewhere."""
    here = os.path.join(os.path.realpath("."), "")
    return [path for path in files if os.path.isfile(path) and not path.startswith(here)]


def settings_hash(scenario: Scenario) -> str:
    """Twelve letters that change with any setting of a scenario."""
    return hashlib.sha256(json.dumps(scenario_to_json(scenario), sort_keys=True).encode()).hexdigest()[:12]


def versions() -> dict[str, str]:
    """What an episode's outcome may depend on beside policy, settings and seed."""
    return {
        "fovconn_env": fovconn_env.__version__,
        "commit": commit(),
        "code": code_hash(Path(inspect.getfile(fovconn_env)).parent)[:12],
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "machine": platform.machine(),
    }


# -------------------------------------------------------------------------------------------------------------- file
def save(made: Submission, file: Path) -> Path:
    """Write a submission to an .npz; returns the file."""
    header = made._asdict() | {"record": to_json(made.record), "files": list(made.files)}
    arrays = {f"file/{k}": np.frombuffer(data, np.uint8) for k, data in enumerate(made.files.values())}
    write_archive(file, SUBMISSION, Archive(header, arrays))
    return file


def load(file: Path) -> Submission:
    """The submission of a file. Nothing of it is run.

    Raises `OSError`, `files.OtherKind` and `files.Damaged`.
    """
    return from_archive(read_archive(file, SUBMISSION), printable(str(file)))


def from_archive(archive: Archive, path: str) -> Submission:
    """The submission that an archive holds; `Damaged` for what is none. path: the file's name in errors."""
    try:
        return _read(*archive)
    except SettingError as problem:
        raise Damaged(f"{path} is damaged: {one_line(problem)}") from problem


def unpack(made: Submission, folder: Path) -> None:
    """Write the files of a submission's policy into a folder."""
    for name, data in made.files.items():
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)


def _read(header: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> Submission:
    check_keys("header", header, _HEADER)
    check_texts("policy", [header["policy"]])
    suites, settings, names = (header[key] for key in ("suites", "settings", "files"))
    check_keys("suites", suites, (), list(suites) if isinstance(suites, dict) else ())
    for name, tasks in suites.items():
        check_texts(f"suites {name!r}", tasks)
    every = [task for tasks in suites.values() for task in tasks]
    rule(len(set(every)) == len(every) > 0, "suites", "of tasks, each once", every[:3], "a suite names its tasks")
    check_keys("settings", settings, every)
    check_texts("settings", list(settings.values()))
    check_texts("files", names)
    rule(len(set(names)) == len(names), "files", "each once", names[:3], "by their paths")
    check_keys("arrays", arrays, [f"file/{k}" for k in range(len(names))])
    for name in names:
        parts = PurePosixPath(name).parts
        inside = bool(parts) and not name.startswith("/") and ".." not in parts and not set(name) & set("\\:")
        rule(inside, "files", "paths below the policy's folder", name, "they are written there")
    contents = {}
    for k, name in enumerate(names):
        check_array(name, arrays[f"file/{k}"], "u1", (-1,))
        contents[name] = arrays[f"file/{k}"].tobytes()
    _check_code(header["policy"], contents)
    record = from_json(header["record"])
    _check_outcomes(record, every)
    return Submission(header["policy"], suites, settings, contents, record)


def _check_outcomes(record: Record, tasks: list[str]) -> None:
    """One policy, each task once, and all outcomes of all its episodes."""
    rule(len(record.policies) == 1, "record", "of one policy", list(record.policies), "each has its own file")
    (about,) = record.policies.values()
    rule(type(about.get("oracle")) is bool, "oracle of the policy", "true or false", about.get("oracle"), "its class's")
    flown = [(result.policy, result.scenario) for result in record.results]
    wanted = [(policy, task) for policy in record.policies for task in tasks]
    rule(flown == wanted and flown != [], "record", f"of the tasks {tasks}", flown, "each once, in order")
    check_texts("run", [record.run.get(key) for key in ("fovconn_env", "commit", "command")])
    rule(len(set(record.seeds)) == len(record.seeds), "seeds", "each once", record.seeds[:3], "one an episode")
    for result in record.results:
        check_keys(f"episodes on {result.scenario}", result.episodes, OUTCOMES)
        rule(0 < result.count <= len(record.seeds), "count", f"1 to {len(record.seeds)}", result.count, "episodes")
        for name, values in result.episodes.items():
            whole = len(values) == result.count and bool(np.isfinite(values).all())
            rule(whole, f"{name} on {result.scenario}", f"{result.count} numbers", len(values), "one an episode")
            known = name not in SHARES or set(values) <= {0.0, 1.0}
            rule(known, f"{name} on {result.scenario}", "0 or 1 each", values[:3], "yes or no")
