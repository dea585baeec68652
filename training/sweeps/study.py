"""A study: all trainings of a sweep in one folder, with a record that tells which they are, and what they found."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fovconn_env.errors import rule
from fovconn_env.files import Damaged, printable, read_json
from fovconn_env.training.evaluation.record import write_json
from fovconn_env.training.learn.learning import make_room
from fovconn_env.training.learn.origin import check_same
from fovconn_env.training.learn.trainings import Training
from fovconn_env.training.sweeps.report import Summary, best_of, copy_policy, summaries, to_json
from fovconn_env.training.sweeps.space import Space
from fovconn_env.training.sweeps.trials import STUDY, Length, Outcome, Trial

PICTURE = "sweep.png"
FORMAT = 1
MAX_BYTES = 64 << 20  # of a record


class Study(NamedTuple):
    """What a sweep trains, and where."""

    training: Training  # with the settings and the seed that the space does not change
    space: Space
    length: Length
    folder: Path  # absolute

    @property
    def seeds(self) -> list[int]:
        """Seeds from which each point is trained."""
        return self.space.seeds or [self.training.seed]

    def trials(self) -> list[Trial]:
        """All trainings, those of the first seed first."""
        digits, single = len(str(len(self.space.points) - 1)), len(self.space.points) == 1 and not self.space.points[0]
        trials = []
        for seed in self.seeds:
            for k, point in enumerate(self.space.points):
                words = [] if single else [f"trial-{k:0{digits}d}"]
                words += [f"seed-{seed}"] if self.space.seeds else []
                trials.append(Trial(self.folder / "-".join(words), k, self.training.changed(seed, point)))
        return trials

    def about(self) -> dict[str, Any]:
        """What a resumed sweep has to have in common with the one before, in JSON types: all but the length."""
        asha = self.space.asha._asdict() if self.space.asha is not None else None
        space = {"points": self.space.points, "seeds": self.seeds, "asha": asha}
        return json.loads(json.dumps(self.training.recipe() | space))


def begin(study: Study, *, resume: bool, fresh: bool) -> None:
    """Make the folder ready: a new record, or that of the same sweep.

    Raises `SettingError` for a folder that holds a training or another sweep, `Damaged` for a record that is none.
    """
    file = study.folder / STUDY
    if resume:
        rule(file.is_file(), "--resume", "given for a folder with a sweep", str(study.folder), f"it has no {STUDY}")
        record = read_json(file, "record of a sweep", MAX_BYTES)
        whole = isinstance(record, dict) and isinstance(record.get("study"), dict)
        if not whole or record.get("format") != FORMAT:
            raise Damaged(f"{printable(str(file))} is no record of a sweep, or of another version")
        hint = "resume with the same command, or train in another --out"
        check_same("", record["study"], study.about(), hint, "the sweep's in the folder")
        return
    hint = "--resume goes on with it, --fresh removes it and begins anew"
    begun = sorted([*study.folder.glob("trial-*"), *study.folder.glob("seed-*")])  # of any sweep
    rule(fresh or not begun, "--out", "a folder without a sweep", str(study.folder), hint)
    for folder in [study.folder, *begun]:
        make_room(folder, study.training.name, fresh)
    write_json(file, _head(study))


def finish(study: Study, outcomes: Sequence[Outcome], *, draw: bool) -> tuple[list[Summary], list[Path]]:
    """Write the record with what was found, the best policy, and a picture; returns the files."""
    found = summaries(study.space.points, study.trials(), outcomes)
    best = best_of(found)
    written = copy_policy(best, study.folder) if best is not None else []
    if draw and best is not None:
        from fovconn_env.training.sweeps.picture import save

        written.append(save(found, study.folder / PICTURE))
    written.append(write_json(study.folder / STUDY, _head(study) | to_json(found)))
    return found, written


def _head(study: Study) -> dict[str, Any]:
    budget = study.length.budget
    length = {"steps": budget.steps, "minutes": budget.minutes, "scores": study.length.scores}
    return {"format": FORMAT, "study": study.about(), "length": length}
