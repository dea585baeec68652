"""Functions of one's own that a scenario flies with: reward, termination, course, and columns of the observation.

They are code, so no file holds them: `register` gives them an id, and files name that.
"""

from __future__ import annotations

import dataclasses
import importlib
import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fovconn_env import layout
from fovconn_env.errors import MissingPlugin, SettingError, SettingTypeError, as_numbers, closest, is_list, rule, shown

if TYPE_CHECKING:
    from fovconn_env.scenarios.scenario import Scenario


class Step(NamedTuple):
    """What happened in a step of B worlds of N robots, the truth: arrays that cannot be written to, after the step.

    Views into the simulator's memory, which the next step overwrites. The fields of the records stand in docs/own.md.
    """

    moved: np.ndarray  # (B,) bool: False in worlds whose episode was over, what is computed of them is not used
    actions: np.ndarray  # (B, N, 4) shares in [-1, 1], clipped: vx, vy, vz, yaw rate
    stick: np.ndarray  # (B, 3) m/s, the operator's velocity in this step, leader's yaw frame
    robots: np.ndarray  # (B, N) records: pose in the world frame, motion in the robot's yaw frame
    pairs: np.ndarray  # (B, N, N) records: what links robots i and j
    teams: np.ndarray  # (B,) records: lambda2, leader, way point, how the episode ended
    v2: np.ndarray  # (B, N) entries of the true unit eigenvector of lambda2
    infos: np.ndarray  # (B, N) records of `layout.INFO`, the built-in reward's terms among them
    own: np.ndarray  # (B, N) records of `layout.SELF`, what robots observe of themselves
    neighbors: np.ndarray  # (B, N, M) records of `layout.NEIGHBOR`
    ranges: np.ndarray  # (B, N, K) records of `layout.RANGE`
    waypoints: np.ndarray  # (B, W, 3) m, world frame
    n_waypoints: np.ndarray  # (B,) those of W that are used
    step_time: float  # s
    scenario: Scenario | None  # None in a compiled function, which can read no Python object


class OnBoard(NamedTuple):
    """What R robots know in a step, a row each: record views of their flat observations, which cannot be written to."""

    own: np.ndarray  # (R,) records of `layout.SELF`
    neighbors: np.ndarray  # (R, M) records of `layout.NEIGHBOR`
    ranges: np.ndarray  # (R, K) records of `layout.RANGE`
    detections: np.ndarray  # (R, Q) records of `layout.DETECTION`; Q = 0 where cameras report all by name


Terms = np.ndarray | Mapping[str, np.ndarray]
RewardFunction = Callable[[Step], Terms] | Callable[[Step, np.ndarray], None]
TerminationFunction = Callable[[Step], Terms]
CourseFunction = Callable[[Any, np.random.Generator], Any]  # an EpisodeStart from the one that was drawn
ColumnsFunction = Callable[[OnBoard], Any]


class Columns:
    """Columns of one's own behind each robot's observation: a function, and the bounds of what it returns.

    `Columns(f, gap=(0.0, 9.0))`: f takes `OnBoard` of R robots and returns (R, 1) numbers, or (R,), for the column
    "gap"; with k columns (R, k) in their order. Numbers beyond the bounds are clipped. Each row is to follow from
    the same row of the arguments alone. Raises `SettingError` for bounds that are none.
    """

    def __init__(self, function: ColumnsFunction, /, **bounds: tuple[float, float]) -> None:
        if not callable(function):
            hint = "write Columns(f, gap=(0.0, 9.0))"
            raise SettingTypeError(f"Columns must be made of a function, got {shown(function)}: {hint}")
        rule(bool(bounds), "Columns", "of one column at least", bounds, "write Columns(f, gap=(0.0, 9.0))")
        for name, pair in bounds.items():
            edge = as_numbers(f"Columns.{name}", pair)
            fine = edge.shape == (2,) and bool(edge[0] < edge[1])
            rule(fine, f"Columns.{name}", "two numbers, low and high", pair, "they are bounds of the observation space")
        self.function, self.names = function, tuple(bounds)
        self.low, self.high = np.array(list(bounds.values()), np.float32).T

    def __repr__(self) -> str:
        return f"Columns({name_of(self.function)}, {', '.join(self.names)})"


@dataclass(frozen=True, kw_only=True)
class Own:
    """What a scenario has of its own, see docs/own.md. Raises `SettingTypeError` for what is no function."""

    reward: RewardFunction | None = None  # in place of the settings `Reward`
    termination: TerminationFunction | None = None  # beside the built-in ones
    course: CourseFunction | None = None  # of what was drawn by the settings
    observation: Columns | None = None
    drop: tuple[str, ...] = ()  # groups, "ranges", or columns, "neighbors.age", that robots do not get
    id: str = ""  # under which it was registered
    plugin: str = ""  # the module that registered it

    def __post_init__(self) -> None:
        for name in ("reward", "termination", "course"):
            value = getattr(self, name)
            if value is not None and not callable(value):
                raise SettingTypeError(f"own {name} must be a function, got {shown(value)}: see docs/own.md")
        if self.observation is not None and not isinstance(self.observation, Columns):
            hint = "write observation=Columns(f, gap=(0.0, 9.0))"
            raise SettingTypeError(f"own observation must be Columns, got {shown(self.observation)}: {hint}")
        drop: Any = (self.drop,) if isinstance(self.drop, str) else self.drop
        words = is_list(drop) and all(isinstance(name, str) for name in drop)
        rule(words, "drop", "names of groups and columns", drop, 'write drop=("ranges", "neighbors.age")')
        object.__setattr__(self, "drop", tuple(drop))

    def __reduce_ex__(self, protocol: Any) -> Any:
        """What is registered by a module is pickled by its name, functions that have none included."""
        if self.id and self.plugin != "__main__":
            return _registered, (self.id, self.plugin)
        return super().__reduce_ex__(protocol)

    def __bool__(self) -> bool:
        parts = (self.reward, self.termination, self.course, self.observation)
        return any(part is not None for part in parts) or bool(self.drop)

    @property
    def changes_flight(self) -> bool:
        """Whether a flight with the same actions may begin or end in another way."""
        return self.termination is not None or self.course is not None

    @property
    def changes_observation(self) -> bool:
        """Whether robots observe other columns."""
        return self.observation is not None or bool(self.drop)

    def to_json(self) -> dict[str, str]:
        """Id and plugin; `SettingError` unless it was registered."""
        if not self.id:
            what = ", ".join(name_of(getattr(self, part)) for part in PARTS if getattr(self, part) is not None)
            raise SettingError(
                f"a scenario's own functions must be registered to be written to a file, got {what or 'drop'}: "
                'call fovconn_env.register("Mine-v0", ...), and fly "Mine-v0"'
            )
        return {"type": "Own", "id": self.id, "plugin": self.plugin}


PARTS = ("reward", "termination", "course", "observation")
KEYWORDS = (*PARTS, "drop")  # of `scenario`; a reward and a course are settings as well
REGISTERED: dict[str, Scenario] = {}  # by id


def _registered(name: str, plugin: str) -> Own:
    """Own functions in another process, of a pickle: which may import, as no other file may."""
    if name not in REGISTERED:
        importlib.import_module(plugin)
    own = REGISTERED[name].own
    assert own is not None
    return own


def name_of(function: Any) -> str:
    """A function's name for messages, terms and outcomes."""
    if isinstance(function, Columns):
        return name_of(function.function)
    return str(getattr(function, "__name__", type(function).__name__))


def take_own(base: Own | None, changes: dict[str, Any]) -> Own | None:
    """Take what is of one's own out of the keywords of `scenario`, beside what its base has."""
    taken = {name: changes.pop(name) for name in ("termination", "observation", "drop") if name in changes}
    for name in ("reward", "course"):
        value = changes.get(name)
        if callable(value) and not isinstance(value, type):
            taken[name] = changes.pop(name)
        elif name in changes and base is not None:
            taken[name] = None  # settings in place of a function
    if not taken:
        return base
    own = dataclasses.replace(base or Own(), **taken, id="", plugin="")
    return own if own else None


def read_own(value: Any) -> Own | None:
    """What is registered, from a file's id; `SettingError` that names the plugin where it is not loaded."""
    if value is None or isinstance(value, Own):
        return value or None
    hint = "write scenario(..., reward=f)"
    if not isinstance(value, Mapping) or not isinstance(value.get("id"), str) or len(value) > 3:
        raise SettingTypeError(f"Scenario.own must be an Own or None, got {shown(value)}: {hint}")
    name, plugin = value["id"], str(value.get("plugin", ""))
    found = find_registered(name)
    own = None if found is None else found.own
    if own is None or own.plugin != plugin:
        raise MissingPlugin(
            f"{shown(name)} must be registered by the plugin {shown(plugin)}, got no such plugin loaded: if you trust "
            "it, import it before, or name it behind fovconn --plugin; a file never loads it"
        )
    return own


def find_registered(name: str) -> Scenario | None:
    """A registered scenario, or None; installed entry points are loaded before."""
    if name not in REGISTERED:
        load_entry_points()
    return REGISTERED.get(name)


_loaded = False


def load_entry_points() -> None:
    """Import the modules that installed packages name in the group "fovconn_env", once; they call `register`."""
    global _loaded
    if _loaded:
        return
    _loaded = True
    from importlib import metadata

    for point in metadata.entry_points(group="fovconn_env"):
        point.load()


# ------------------------------------------------------------------------------------------------ columns that stay
class Seen(NamedTuple):
    """The columns of a robot's observation: those that stay of the built-in ones, and own ones behind."""

    runs: tuple[tuple[slice, slice], ...]  # where built-in columns go to, and come from
    groups: dict[str, slice]  # the parts of a `Dict` observation
    low: np.ndarray  # (D,) float32
    high: np.ndarray  # (D,)

    @property
    def n_kept(self) -> int:
        """How many built-in columns stay."""
        return self.runs[-1][0].stop if self.runs else 0


def seen_columns(scenario: Scenario, low: np.ndarray, high: np.ndarray) -> Seen:
    """The columns of a scenario, whose built-in ones have these bounds, (D,). `SettingError` for a wrong `drop`."""
    own = scenario.own or Own()
    tables = (("self", layout.SELF, 1), ("neighbors", layout.NEIGHBOR, scenario.max_neighbors))
    tables += (("ranges", layout.RANGE, scenario.max_ranges), ("detections", layout.DETECTION, scenario.n_detections))
    flat = [(group, f"{group}.{column.name}") for group, table, count in tables for column in table * count]
    known = tuple(dict.fromkeys(name for pair in flat for name in pair))
    for name in own.drop:
        rule(name in known, "drop", "groups and columns of the observation", name, closest(name, known))
    kept = [k for k, names in enumerate(flat) if not set(names) & set(own.drop)]
    edges = [0, *(n for n in range(1, len(kept)) if kept[n] != kept[n - 1] + 1), len(kept)]
    runs = tuple((slice(a, b), slice(kept[a], kept[b - 1] + 1)) for a, b in itertools.pairwise(edges) if a < b)
    groups = [flat[k][0] for k in kept]
    extra = () if own.observation is None else own.observation.names
    names = [*groups, *["extra"] * len(extra)]
    rule(bool(names), "drop", "less than all columns", own.drop, "nothing is left to observe")
    first = {name: names.index(name) for name in dict.fromkeys(names)}
    bounds = [low[kept], high[kept]]
    if own.observation is not None:
        bounds = [np.append(bounds[0], own.observation.low), np.append(bounds[1], own.observation.high)]
    for bound in bounds:
        bound.flags.writeable = False
    return Seen(runs, {name: slice(k, k + names.count(name)) for name, k in first.items()}, bounds[0], bounds[1])
