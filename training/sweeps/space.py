"""The file of a sweep: which settings of a training it tries, from which seeds, and whether it stops some early.

    grid:                                  # all combinations
      n_epochs: [2, 4]
    random:                                # with each of them, `samples` draws
      learning_rate: {loguniform: [5.0e-4, 5.0e-3]}
      entropy: {uniform: [0, 0.01]}
      hidden: {choices: [[128, 64], [64, 64]]}
    samples: 8
    asha: {grace: 2, reduction: 3}         # scores before a trial may be stopped; it goes on if it is in the best third
    seeds: 0-2

All is read, drawn and checked before the first training starts.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fovconn_env.errors import SettingError, check_count, closest, is_list, is_whole, rule
from fovconn_env.fields import check_keys, check_whole
from fovconn_env.files import Damaged, one_line, printable, read_file
from fovconn_env.training.evaluation.campaign import parse_seeds
from fovconn_env.training.learn.trainings import Training

MOST = 10_000  # trials
MAX_BYTES = 1 << 20
KEYS = "grid", "random", "samples", "draw_seed", "asha", "seeds"
Point = dict[str, Any]  # settings by name


class Asha(NamedTuple):
    """Asynchronous successive halving (Li et al., MLSys 2020), as Ray Tune does it."""

    grace: int = 1  # scores before a trial may be stopped
    reduction: float = 3.0  # one in so many goes on at each rung


class Space(NamedTuple):
    """What a sweep tries."""

    points: list[Point]
    seeds: list[int] | None = None
    asha: Asha | None = None


def read_space(file: Path, training: Training) -> Space:
    """The space in a file, over the settings of a training.

    Raises `SettingError`, `Damaged` or `OtherKind`, naming file and field, for anything but such a file: a setting
    that the training does not have, a value out of its bounds, an empty grid; and `OSError`.
    """
    name = printable(str(file))
    data = _load(file, name)
    try:
        check_keys("the file", data, (), KEYS)
        points = _points(data, training)
        seeds = None if data.get("seeds") is None else training_seeds(str(data["seeds"]))
        trials = len(points) * len(seeds or [0])
        rule(trials <= MOST, "the sweep", f"at most {MOST} trials", trials, "each is a training")
        return Space(points, seeds, _asha(data["asha"]) if data.get("asha") is not None else None)
    except SettingError as problem:
        raise SettingError(f"{name}: {problem}") from problem


def training_seeds(text: str) -> list[int]:
    """Seeds of trainings, written as those of flights. Raises as `parse_seeds`."""
    seeds = parse_seeds(text)
    rule(len(seeds) <= MOST, "seeds", f"at most {MOST}", len(seeds), "each is a training")
    rule(max(seeds) < 2**32, "seeds", "at most 2**32 - 1", max(seeds), "torch and numpy are seeded with them")
    return seeds


def _load(file: Path, name: str) -> Any:
    import yaml

    class Loader(yaml.SafeLoader):
        """Without aliases, which make gigabytes of a few bytes, and without a name that stands twice."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.MarkedYAMLError(problem="an alias", problem_mark=self.peek_event().start_mark)
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            keys = [key.value for key, _ in node.value]
            for k, (key, _) in enumerate(node.value):
                if key.value in keys[:k]:
                    raise yaml.MarkedYAMLError(problem=f"{key.value} stands twice", problem_mark=key.start_mark)
            return super().construct_mapping(node, deep)

    text = read_file(file, "file of a sweep", MAX_BYTES)
    try:
        return yaml.load(text, Loader)
    except Exception as problem:  # also IndexError and others: yaml checks no value behind a tag
        mark = getattr(problem, "problem_mark", None)
        at = f" in line {mark.line + 1}" if mark is not None else ""
        says = getattr(problem, "problem", None) or problem
        raise Damaged(f"{name} is no YAML of a sweep{at}: {one_line(says)}") from problem


def _points(data: Mapping[str, Any], training: Training) -> list[Point]:
    grid, ranges = (data.get(part) or {} for part in ("grid", "random"))
    fields = _fields(training)
    for part, settings in (("grid", grid), ("random", ranges)):
        rule(isinstance(settings, dict), part, "settings by name", settings, "for example gamma: [0.98, 0.99]")
        for name in settings:
            known = isinstance(name, str) and name in fields
            rule(known, part, "settings that --tune names", name, closest(name, list(fields)))
    twice = sorted(grid.keys() & ranges.keys())
    rule(not twice, "grid and random", "of different settings", twice, "name each in one of the two")
    rule(bool(grid or ranges), "grid and random", "given, one of the two at least", "none", "there is nothing to try")
    values = {name: _values(f"grid.{name}", given) for name, given in grid.items()}
    draws = _draws(data, {name: _range(name, given, fields[name]) for name, given in ranges.items()}, training)
    for name, tried in values.items():
        for value in tried:
            _check(f"grid.{name}", {name: value}, training)
    count = math.prod(map(len, values.values())) * len(draws)
    rule(count <= MOST, "the sweep", f"at most {MOST} points", count, "each is a training")
    points = [
        {**dict(zip(values, chosen, strict=True)), **draw}
        for chosen in itertools.product(*values.values())
        for draw in draws
    ]
    for point in points:
        _check(", ".join(f"{name}={value}" for name, value in point.items()), point, training)
    return points


def _fields(training: Training) -> dict[str, dataclasses.Field[Any]]:
    return {field.name: field for part in (training.settings, training.network) for field in dataclasses.fields(part)}


def _check(where: str, values: Point, training: Training) -> None:
    try:
        training.changed(0, values)
    except SettingError as problem:
        raise SettingError(f"{where}: {problem}") from problem


def _values(where: str, given: Any) -> list[Any]:
    rule(is_list(given) and len(given) > 0, where, "a list of values", given, "for example [0.98, 0.99]")
    rule(len(given) <= MOST, where, f"at most {MOST} values", len(given), "each is a training")
    values = [_value(where, item) for item in given]
    rule(len({repr(value) for value in values}) == len(values), where, "different values", given, "once each")
    return values


def _value(where: str, item: Any) -> Any:
    """A value as `--tune` reads it: YAML takes 1e-3 and (128, 64) for words, and has lists for tuples."""
    if isinstance(item, str):
        with contextlib.suppress(ValueError, SyntaxError, MemoryError, RecursionError):  # a word
            item = ast.literal_eval(item)
    value = tuple(item) if is_list(item) else item
    parts = value if isinstance(value, tuple) else (value,)
    plain = all(part is None or isinstance(part, (int, float, str)) for part in parts)
    rule(plain, where, "numbers, words, or lists of them", item, "for example [0.98, 0.99]")
    return value


# -------------------------------------------------------------------------------------------------------------- draws
Draw = Callable[[np.random.Generator], Any]


class Range(NamedTuple):
    """How a setting is drawn."""

    draw: Draw
    ends: list[Any]  # values to check: all choices, or least and greatest


def _range(name: str, given: Any, field: dataclasses.Field[Any]) -> Range:
    where, kinds = f"random.{name}", ("uniform", "loguniform", "choices")
    one = isinstance(given, dict) and len(given) == 1 and next(iter(given)) in kinds
    rule(one, where, f"one of {', '.join(kinds)}", given, "for example {uniform: [0.98, 0.99]}")
    kind, bounds = next(iter(given.items()))
    if kind == "choices":
        values = _values(f"{where}.choices", bounds)
        return Range(lambda rng: values[int(rng.integers(len(values)))], values)
    where, pair = f"{where}.{kind}", _values(f"{where}.{kind}", bounds)
    numbers = len(pair) == 2 and all(isinstance(x, (int, float)) and math.isfinite(x) for x in pair)
    rule(numbers and pair[0] < pair[1], where, "two numbers, the lower one first", bounds, "for example [0.98, 0.99]")
    rule(kind == "uniform" or pair[0] > 0, where, "above 0", pair[0], "0 has no logarithm")
    whole = isinstance(field.default, int)
    rule(not whole or all(map(is_whole, pair)), where, "whole numbers", bounds, f"{name} counts something")
    low, high = map(float, pair)

    def draw(rng: np.random.Generator) -> float:
        if kind == "uniform":
            value = float(rng.uniform(low, high))
        else:
            value = min(max(math.exp(rng.uniform(math.log(low), math.log(high))), low), high)
        return round(value) if whole else value

    return Range(draw, pair)


def _draws(data: Mapping[str, Any], ranges: Mapping[str, Range], training: Training) -> list[Point]:
    """`samples` draws of all ranges, always the same; one of nothing without ranges."""
    if not ranges:
        for name in ("samples", "draw_seed"):
            rule(data.get(name) is None, name, "given with random", data.get(name), "a grid has all its points")
        return [{}]
    for name, each in ranges.items():
        for value in each.ends:
            _check(f"random.{name}", {name: value}, training)
    samples = check_count("samples", data.get("samples"), "how often the ranges are drawn", most=MOST)
    seed = data.get("draw_seed", 0)
    check_whole("draw_seed", seed, 0, 2**32 - 1, "another one draws other values")
    rng = np.random.default_rng(seed)
    return [{name: each.draw(rng) for name, each in ranges.items()} for _ in range(samples)]


def _asha(given: Any) -> Asha:
    hint = "for example asha: {grace: 2, reduction: 3}"
    rule(isinstance(given, dict), "asha", "of grace and reduction", given, hint)
    check_keys("asha", given, (), Asha._fields)
    asha = Asha(**given)
    check_count("asha.grace", asha.grace, "scores before a trial may be stopped")
    fine = isinstance(asha.reduction, (int, float)) and 1 < asha.reduction <= 1000
    rule(fine, "asha.reduction", "a number above 1", asha.reduction, "one in so many goes on at each rung")
    return asha
