"""Finished episodes kept on disk, found again as long as settings and code are the same."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import json
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

import fovconn_env
from fovconn_env import Scenario
from fovconn_env.baselines import find_policy
from fovconn_env.errors import FovconnError, SettingError
from fovconn_env.files import Archive, Kind, read_archive, write_archive
from fovconn_env.scenarios.serialize import scenario_to_json
from fovconn_env.text import file_name
from fovconn_env.training.evaluation.flights import Evaluation, label

EVALUATION = Kind("fovconn_evaluation", "file of finished episodes", "fovconn eval writes them", 1)


class Cell(NamedTuple):
    """What is flown: a policy, as `find_policy` takes it, on a scenario."""

    policy: str
    scenario: Scenario


class Shelf:
    """Finished episodes on disk, one file for a policy on a scenario; without a folder, nothing is kept.

    A file's name holds a fingerprint of all settings and of the source code, so that what was flown by other settings
    or other code is not taken for the same.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def load(self, cell: Cell) -> Evaluation | None:
        """A cell's episodes, None if there are none; `ValueError` for a file that cannot be read."""
        file = self._file(cell)
        if file is None or not file.is_file():
            return None
        try:
            episodes = read_archive(file, EVALUATION).arrays
        except FovconnError as problem:
            raise SettingError(f"{problem}; delete it, and its episodes are flown again") from problem
        histograms, seeds = episodes.pop("histograms"), episodes.pop("seeds").tolist()
        return Evaluation(label(cell.policy), cell.scenario, seeds, episodes, histograms)

    def save(self, cell: Cell, evaluation: Evaluation | None) -> None:
        """Put finished episodes in the place of what was there, with no moment in which neither is."""
        file = self._file(cell)
        if file is None or evaluation is None:
            return
        arrays = {"seeds": np.array(evaluation.seeds), "histograms": evaluation.histograms, **evaluation.episodes}
        header = {"policy": evaluation.policy, "scenario": evaluation.scenario.name}
        write_archive(file, EVALUATION, Archive(header, arrays))

    def _file(self, cell: Cell) -> Path | None:
        if self.folder is None:
            return None
        return self.folder / f"{label(cell.policy)}@{file_name(cell.scenario.name)}-{fingerprint(cell)}.npz"


def fingerprint(cell: Cell) -> str:
    """Twelve letters that change with any setting of a cell and with the source code that flies it."""
    kind = find_policy(cell.policy)
    scenarios = [scenario_to_json(scenario) for scenario in (cell.scenario, kind.equip(cell.scenario))]
    digest = hashlib.sha256(json.dumps(scenarios).encode())
    digest.update((code_hash(Path(inspect.getfile(fovconn_env)).parent) + kind.tag()).encode())
    with contextlib.suppress(OSError, TypeError):  # a class typed at a prompt has no file
        digest.update(Path(inspect.getfile(kind)).read_bytes())
    return digest.hexdigest()[:12]


@functools.cache
def code_hash(root: Path) -> str:
    """Hash of the sources below a folder, links followed: of all that flies, so not of render/ and training/."""
    digest = hashlib.sha256()
    for folder, below, names in os.walk(root, followlinks=True):
        below[:] = sorted(set(below) - {"render", "training"})
        for name in sorted(name for name in names if name.endswith(".py")):
            file = Path(folder, name)
            digest.update(file.relative_to(root).as_posix().encode() + file.read_bytes())
    return digest.hexdigest()
