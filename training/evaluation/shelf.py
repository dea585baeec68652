"""Finished episodes kept on disk, found again as long as what they come from is the same."""

from __future__ import annotations

import functools
import hashlib
import inspect
import json
import os
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote, unquote_to_bytes

import numba
import numpy as np

import fovconn_env
from fovconn_env import Scenario
from fovconn_env.baselines import find_pilot
from fovconn_env.baselines.sources import source_files
from fovconn_env.errors import FovconnError, SettingError
from fovconn_env.files import Archive, Kind, printable, read_archive, write_archive
from fovconn_env.scenarios.serialize import scenario_to_json
from fovconn_env.text import file_name
from fovconn_env.training.evaluation.episode_checks import check_file
from fovconn_env.training.evaluation.flights import Evaluation, join, label
from fovconn_env.training.evaluation.provenance import Files, changed, digest, merge, packages, sources, torn

EVALUATION = Kind("fovconn_evaluation", "file of finished episodes", "fovconn eval writes them", 2)


class Cell(NamedTuple):
    """What is flown: a policy, as `find_pilot` takes it, on a scenario."""

    policy: str
    scenario: Scenario


class Flown(NamedTuple):
    """Episodes of a cell, in the order of their seeds, and where they come from."""

    evaluation: Evaluation
    times: dict[int, int]  # when each seed was flown, Unix time, s
    files: Files  # what the policy consisted of and read, see `provenance`

    @classmethod
    def of(cls, part: Evaluation, files: Files) -> Flown:
        """What was flown now."""
        nothing = part._replace(seeds=[], episodes={name: v[:0] for name, v in part.episodes.items()})
        return cls(nothing._replace(histograms=part.histograms[:0]), {}, files).joined(part, files)

    def joined(self, part: Evaluation, files: Mapping[str, str]) -> Flown:
        """With episodes that were flown now; raises `SettingError` if the policy was another one by then."""
        files = merge(self.files, files)
        if names := torn(files):
            hint = "its episodes do not belong together; run the same command again"
            raise SettingError(
                f"policy {part.policy} must stay as it is while it flies, got another {names[0]}: {hint}"
            )
        others = sorted(self.times.keys() - set(part.seeds))
        both = join([in_order(self.evaluation, others), part])
        times = self.times | dict.fromkeys(part.seeds, int(time.time()))
        return Flown(in_order(both, sorted(both.seeds)), times, files)


def in_order(part: Evaluation, seeds: Sequence[int]) -> Evaluation:
    """The episodes of these seeds in their order."""
    place = {seed: k for k, seed in enumerate(part.seeds)}
    chosen = [place[seed] for seed in seeds]
    episodes = {name: values[chosen] for name, values in part.episodes.items()}
    return part._replace(seeds=list(seeds), episodes=episodes, histograms=part.histograms[chosen])


class Shelf:
    """Finished episodes on disk, one file for a policy on a scenario; without a folder, nothing is kept.

    A file's name holds a fingerprint of all settings and of the source code. The file itself lists what the policy read
    beside that. So what was flown by other settings, code or weights is not taken for the same.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder

    def load(self, cell: Cell) -> tuple[Flown | None, list[str]]:
        """A cell's episodes, None if there are none; and the names of the files that have changed since.

        Raises `OSError`, and `files.OtherKind` or `files.Damaged` for what no campaign leaves.
        """
        file = self._file(cell)
        if file is None or not file.is_file():
            return None, []
        try:
            header, arrays = read_archive(file, EVALUATION)
            check_file(header, arrays, printable(str(file)))
        except FovconnError as problem:
            raise type(problem)(f"{problem}; delete it, and its episodes are flown again") from problem
        histograms, seeds, times = (arrays.pop(name) for name in ("histograms", "seeds", "times"))
        evaluation = Evaluation(label(cell.policy), cell.scenario, seeds.tolist(), arrays, histograms)
        files = {os.fsdecode(unquote_to_bytes(path)): was for path, was in header["files"].items()}
        return Flown(evaluation, dict(zip(seeds.tolist(), times.tolist(), strict=True)), files), changed(files)

    def save(self, cell: Cell, flown: Flown) -> None:
        """Put finished episodes in the place of what was there, with no moment in which neither is."""
        file = self._file(cell)
        if file is None:
            return
        evaluation = flown.evaluation
        times = np.array([flown.times[seed] for seed in evaluation.seeds], np.int64)
        arrays = {"seeds": np.array(evaluation.seeds), "times": times, "histograms": evaluation.histograms}
        files = {quote(os.fsencode(path)): was for path, was in flown.files.items()}  # a path may be no text
        header = {"policy": evaluation.policy, "scenario": evaluation.scenario.name, "files": files}
        write_archive(file, EVALUATION, Archive(header, {**arrays, **evaluation.episodes}))

    def _file(self, cell: Cell) -> Path | None:
        if self.folder is None:
            return None
        return self.folder / f"{file_name(label(cell.policy))}@{file_name(cell.scenario.name)}-{fingerprint(cell)}.npz"


def fingerprint(cell: Cell) -> str:
    """Twelve letters that change with all settings of a cell, the code that flies it, and what the code runs on."""
    kind = find_pilot(cell.policy)
    files = [*sources(kind), *plugin_files(cell.scenario)]
    parts = [scenario_to_json(scenario) for scenario in (cell.scenario, kind.equip(cell.scenario))]
    parts += [code_hash(Path(inspect.getfile(fovconn_env)).parent), kind.tag(), [digest(str(file)) for file in files]]
    parts += [platform.python_version(), np.__version__, numba.__version__, packages(files)]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:12]


def plugin_files(scenario: Scenario) -> list[Path]:
    """The module that registered a scenario's own functions, and what it imports."""
    module = sys.modules.get(scenario.own.plugin) if scenario.own is not None else None
    file = getattr(module, "__file__", None)
    return source_files(Path(file), Path(file).parent) if file else []


@functools.cache
def code_hash(root: Path) -> str:
    """Hash of all that `code_files` names."""
    return hashlib.sha256(json.dumps(code_files(root)).encode()).hexdigest()


def code_files(root: Path) -> Files:
    """Hashes of the sources below a folder, links followed: of all that flies, so not of render/ and training/."""
    files: Files = {}
    for folder, below, names in os.walk(root, followlinks=True):
        below[:] = sorted(set(below) - {"render", "training"})
        for file in sorted(Path(folder, name) for name in names if name.endswith(".py")):
            files[file.relative_to(root).as_posix()] = digest(str(file))
    return files
