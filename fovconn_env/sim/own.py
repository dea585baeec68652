"""What a scenario's own functions make of the steps of a simulator. They read the state, and write beside it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from fovconn_env import layout
from fovconn_env.errors import OwnError, SettingError, as_numbers, policy_code, rule
from fovconn_env.kernel.records import State, World
from fovconn_env.scenarios.own import Columns, OnBoard, Own, Step, name_of, seen_columns
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.memory import observation_bounds, row_views, zeros

# The fields of the simulator's records that are public; docs/own.md has their meaning.
ROBOTS: Sequence[str] = (
    "x y z yaw cos_yaw sin_yaw vx vy vz yaw_rate roll pitch nearest clearance alive sees talks".split()
)
PAIRS: Sequence[str] = "distance cosine blocked broken seen linked weight f_star".split()
TEAMS: Sequence[str] = (
    "step max_steps leader stick_x stick_y stick_z waypoint split held lambda2 n_edges "
    "over terminated truncated success collision disconnected"
).split()


def own_memory(state: State, scenario: Scenario) -> State:
    """The state with observations in memory of their own: who has a view into them can reach nothing else."""
    flat = zeros({"flat": (state.flat.shape[1:], np.float32)}, len(state.flat))["flat"]
    return state._replace(flat=flat, **row_views(flat, scenario))


class OwnObservation:
    """What robots observe where columns are dropped, or added by a function, of the built-in columns alone."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.own = scenario, scenario.own or Own()
        self.seen = seen_columns(scenario, *observation_bounds(scenario))
        self._checked = False  # that a row's columns follow from this row alone

    @property
    def size(self) -> int:
        """Length of one robot's observation."""
        return len(self.seen.low)

    def __call__(self, flat: np.ndarray, into: np.ndarray | None = None) -> np.ndarray:
        """Observations (R, size) float32 of built-in ones, (R, D) float32; written to `into` if there is one."""
        result = np.empty((len(flat), self.size), np.float32) if into is None else into
        for target, source in self.seen.runs:
            result[:, target] = flat[:, source]
        if self.own.observation is not None:
            result[:, self.seen.n_kept :] = self._compute(self.own.observation, frozen(flat))
        return result

    def _compute(self, columns: Columns, flat: np.ndarray) -> np.ndarray:
        """Own columns, (R, k) float64. The first time they are computed of half the rows as well, and must be equal."""
        values, field = self._call(columns, flat), f"own observation {name_of(columns)}"
        if not np.isfinite(values).all():
            r, k = np.argwhere(~np.isfinite(values))[0].tolist()
            column, hint = columns.names[k], "rows that are not present are zeros"
            raise SettingError(f"{field} must be finite, got {values[r, k]} in column {column} of row {r}: {hint}")
        if not self._checked and len(flat) > 1:
            part = self._call(columns, flat[: len(flat) // 2])
            same, hint = (
                np.allclose(part, values[: len(part)], rtol=1e-4, atol=1e-6),
                "a robot knows no other robot's row",
            )
            rule(same, field, "computed row by row", "other numbers where there are fewer rows", hint)
            self._checked = True
        return np.clip(values, columns.low, columns.high)

    def _call(self, columns: Columns, flat: np.ndarray) -> np.ndarray:
        """What the function returns, (R, k) float64."""
        scenario, name, shape = self.scenario, name_of(columns), (len(flat), len(columns.names))
        sizes = scenario.max_neighbors, scenario.max_ranges, scenario.n_detections
        rows = OnBoard(*layout.rows(flat, *sizes), layout.detections(flat, scenario.n_detections))
        with policy_code(f"own observation {name} failed on {scenario.name}:", OwnError):
            returned = columns.function(rows)
        field = f"own observation {name}"
        values = as_numbers(field, returned)
        fine = values.shape == shape or (shape[1] == 1 and values.shape == shape[:1])
        rule(fine, field, f"of the shape {shape}", values.shape, f"(robots, columns {', '.join(columns.names)})")
        return values.reshape(shape)


class Extension:
    """Rewards, outcomes and observations of B worlds by the functions of their scenario.

    A function that fails, or returns what is none, raises an `OwnError` or a `SettingError` after the worlds have
    moved; what it would have written is then as before the step.
    """

    def __init__(self, scenario: Scenario, state: State) -> None:
        own = scenario.own or Own()
        shape = state.reward.shape
        self.scenario, self.own = scenario, own
        self.rewards = np.zeros(shape)  # (B, N)
        self.terms: dict[str, np.ndarray] = {}  # (B, N) each, of the last step
        self.outcomes: dict[str, np.ndarray] = {}  # (B,) bool each
        self.observation = OwnObservation(scenario)
        self.seen = self.observation.seen
        self.observations: np.ndarray | None = None  # (B, N, D), where they are not the built-in ones
        if own.changes_observation:
            self.observations = np.zeros((*shape, len(self.seen.low)), np.float32)
        self._views: tuple[Any, Any, Step] | None = None  # state, world, and what a function sees of them
        self._before = np.zeros(shape[0], bool), np.zeros((shape[0], 3))

    def before_step(self, state: State) -> None:
        """Keep what a step overwrites."""
        episode = state.episode
        self._before = ~episode["over"], np.stack([episode[name] for name in ("stick_x", "stick_y", "stick_z")], -1)

    def after_step(self, state: State, world: World, actions: np.ndarray) -> None:
        """Observe, end episodes and reward a step that was made by actions (B, N, 4)."""
        moved = self._before[0]
        self.observe(state, moved)
        termination, reward = self.own.termination, self.own.reward
        if (termination is None and reward is None) or not moved.any():
            return
        step = self._step(state, world)._replace(
            moved=frozen(moved), actions=frozen(np.clip(actions, -1.0, 1.0)), stick=frozen(self._before[1])
        )
        if termination is not None:
            self._end(state, self._outcomes(termination, step), moved)
        if reward is not None:
            terms = self._terms(reward, step)
            for name, values in terms.items():
                kept = self.terms.setdefault(name, np.zeros(self.rewards.shape))
                np.copyto(kept, values, where=moved[:, None])
            np.copyto(self.rewards, sum(terms.values()), where=moved[:, None])

    def begin(self, state: State, mask: np.ndarray) -> None:
        """Episodes of the masked worlds (B,) begin."""
        for values in (self.rewards, *self.terms.values(), *self.outcomes.values()):
            values[mask] = 0
        self.observe(state, mask)

    def observe(self, state: State, mask: np.ndarray) -> None:
        """Bring the masked worlds' observations up to date."""
        if self.observations is None or not mask.any():
            return
        every, columns = bool(mask.all()), self.own.observation
        flat, alive = state.flat, state.body["alive"]
        into = self.observations
        if not every:
            flat, alive, into = flat[mask], alive[mask], np.empty((int(mask.sum()), *into.shape[1:]), np.float32)
        self.observation(flat.reshape(-1, flat.shape[-1]), into.reshape(-1, into.shape[-1]))
        if columns is not None and not alive.all():
            into[~alive, self.seen.n_kept :] = np.clip(0.0, columns.low, columns.high)
        if not every:
            self.observations[mask] = into

    # ---------------------------------------------------------------------------------------------- what they see
    def _step(self, state: State, world: World) -> Step:
        """Views of what a function may read, without those of the step itself."""
        if self._views is None or self._views[0] is not state or self._views[1] is not world:
            none, time = np.zeros(0, bool), self.scenario.step_time
            step = Step(
                none,
                np.zeros((0, 0, 4)),
                np.zeros((0, 3)),
                state.body[list(ROBOTS)],
                state.pair[list(PAIRS)],
                state.episode[list(TEAMS)],
                state.fiedler,
                state.info,
                state.own_row,
                state.neighbor_row,
                state.range_row,
                world.waypoint,
                world.n_waypoints,
                time,
                self.scenario,
            )
            views: list[Any] = [frozen(part) if isinstance(part, np.ndarray) else part for part in step]
            self._views = state, world, Step(*views)
        return self._views[2]

    # ------------------------------------------------------------------------------------------- what they return
    def _call(self, kind: str, function: Callable[..., Any], step: Step, *rest: np.ndarray) -> Any:
        if isinstance(function, Dispatcher):
            step = step._replace(scenario=None)
        with policy_code(f"own {kind} {name_of(function)} failed on {self.scenario.name}:", OwnError):
            try:
                return function(step, *rest)
            except NumbaError as problem:  # names the types of all arrays, in lines of thousands of letters
                problem.args = ("\n".join(line[:160] for line in str(problem).splitlines()),)
                raise

    def _terms(self, function: Callable[..., Any], step: Step) -> dict[str, np.ndarray]:
        """An own reward's terms, (B, N) each."""
        name, shape = name_of(function), (len(self.rewards), self.scenario.n_agents)
        if n_arguments(function) > 1:
            filled = np.full(shape, np.nan)
            self._call("reward", function, step, filled)
            returned: Any = filled
        else:
            returned = self._call("reward", function, step)
        terms = {}
        for term, value in named(f"own reward {name}", name, returned):
            field = f"own reward {name}" + f", term {term}" * (term != name)
            values = as_numbers(field, value)
            hint = "(worlds, robots); a team's number is x[:, None]"
            rule(values.shape in (shape, (shape[0], 1)), field, f"of the shape {shape}", values.shape, hint)
            bad = ~np.isfinite(values) & step.moved[:, None]
            if bad.any():
                b, i = np.argwhere(bad)[0].tolist()
                value, hint = float(values[b, i]), "a division by 0, or an entry that was not filled?"
                raise SettingError(f"{field} must be finite, got {value} for uav_{i} of world {b}: {hint}")
            terms[term] = values
        return terms

    def _outcomes(self, function: Callable[..., Any], step: Step) -> dict[str, np.ndarray]:
        """An own termination's outcomes, (B,) bool each."""
        name, shape, ends = name_of(function), step.moved.shape, {}
        for outcome, value in named(f"own termination {name}", name, self._call("termination", function, step)):
            field, values = f"own termination {outcome}", np.asarray(value)
            fine = values.dtype == bool and values.shape == shape
            got = f"{values.dtype} {values.shape}"
            rule(fine, field, f"bool of the shape {shape}", got, "True where a world's episode ends by it")
            taken = any(outcome == column.name for column in layout.INFO)
            rule(not taken, field, "under a name that infos have not", outcome, "rename the function")
            ends[outcome] = values
        same = not self.outcomes or ends.keys() == self.outcomes.keys()
        hint = f"in the step before {', '.join(self.outcomes)}"
        rule(same, f"own termination {name}", "of the same outcomes in every step", list(ends), hint)
        return ends

    def _end(self, state: State, ends: dict[str, np.ndarray], moved: np.ndarray) -> None:
        """End the episodes for which an own termination is True, of those that no built-in one has ended."""
        episode = state.episode
        open_ = moved & ~episode["terminated"]
        for name, values in ends.items():
            ended = values & open_
            kept = self.outcomes.setdefault(name, np.zeros(moved.shape, bool))
            kept[moved] = ended[moved]
            episode["terminated"] |= ended
            episode["over"] |= ended
            episode["truncated"] &= ~ended

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_views": None}


def frozen(array: np.ndarray) -> np.ndarray:
    """A view that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view


def named(field: str, name: str, returned: Any) -> list[tuple[str, Any]]:
    """What a function returned by name: a mapping's parts, or one under the name of the function."""
    if not isinstance(returned, Mapping):
        return [(name, returned)]
    words = bool(returned) and all(isinstance(word, str) and word and word.isprintable() for word in returned)
    rule(words, field, "an array, or a dict of arrays by name", list(returned), "names are printable texts")
    return list(returned.items())


def n_arguments(function: Callable[..., Any]) -> int:
    """How many arguments a function needs."""
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    parameters = inspect.signature(getattr(function, "py_func", function)).parameters.values()
    return sum(one.kind in kinds and one.default is one.empty for one in parameters)
