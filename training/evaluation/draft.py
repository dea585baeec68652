"""What a report has of each scenario, made in a thread as soon as all of its flights are there."""

from __future__ import annotations

import contextlib
import gc
import importlib.util
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fovconn_env.training.evaluation.comparison import Compared, Comparison, compare
from fovconn_env.training.evaluation.flights import Evaluation, label
from fovconn_env.training.evaluation.record import Record, about

if TYPE_CHECKING:
    from fovconn_env.training.evaluation.pictures import Picture


def can_draw() -> bool:
    """Whether there is matplotlib."""
    return importlib.util.find_spec("matplotlib") is not None


class Draft:
    """Differences with their intervals, and pictures. Nothing is written; arguments as of `publish`."""

    def __init__(self, policies: Sequence[str], settings: Mapping[str, Any], folder: Path) -> None:
        self._settings, self._folder = settings, folder
        self._kinds = {label(policy): about(policy) for policy in policies}
        self._parts: dict[str, Future[tuple[Comparison, list[Picture]]]] = {}
        self._thread = ThreadPoolExecutor(1)  # while others fly there is no core for more

    def __enter__(self) -> Draft:
        return self

    def __exit__(self, *problem: object) -> None:
        self._thread.shutdown(wait=False, cancel_futures=True)

    def add(self, evaluations: Sequence[Evaluation]) -> None:
        """Begin with a scenario, all of whose policies these are."""
        self._parts[evaluations[0].scenario.name] = self._thread.submit(self._make, evaluations)

    def parts(self) -> tuple[dict[tuple[str, str], Compared], dict[str, list[Picture]]]:
        """What there is, by scenario and policy, and by scenario; waits for it, and raises what went wrong."""
        done = {name: part.result() for name, part in self._parts.items()}
        compared = {place: each for comparison, _ in done.values() for place, each in comparison.compared.items()}
        return compared, {name: pictures for name, (_, pictures) in done.items()}

    def _make(self, evaluations: Sequence[Evaluation]) -> tuple[Comparison, list[Picture]]:
        comparison = compare(evaluations, self._settings)
        if not can_draw():
            return comparison, []
        from fovconn_env.training.evaluation.pictures import draw
        from fovconn_env.training.evaluation.report import PLOTS, names_on

        (scenario,) = comparison.scenarios
        comparison = comparison._replace(policies=list(self._kinds))  # each has its colour in all pictures
        names = names_on(comparison, Record("eval", [], self._kinds, []), scenario)
        with _spared():
            return comparison, draw(comparison, names, scenario, self._folder / PLOTS)


@contextlib.contextmanager
def _spared() -> Iterator[None]:
    """What is loaded by now is not walked again and again for the rubbish that figures leave; a tenth of their time."""
    if gc.get_freeze_count():  # by somebody else, who says when it ends
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
