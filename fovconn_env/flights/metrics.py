"""What an episode was worth, beyond its return: measured against the truth, world by world."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from fovconn_env.flights.rollout import Observer, PilotClass, rollout
from fovconn_env.kernel.jit import code_of, entry, kernel
from fovconn_env.kernel.maths.weights import range_weight
from fovconn_env.kernel.onboard.power_iteration import FLOODING
from fovconn_env.kernel.world.faults import count_living
from fovconn_env.kernel.world.outcome import FAULT, OCCLUSION, OWN_VIEW, RANGE, lost_link
from fovconn_env.layout import LOST_LINK, LOST_PAIR
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.simulator import Simulator

WARM = 5.0  # s after the first motion from which the validity of yaw estimates counts
MOVING = 0.05  # m/s, a robot that is faster moves

ERRORS = ("lambda2", "yaw_mutual", "yaw_one_way")  # what the histograms count
BINS_PER_DECADE, DECADES, LOWEST = 20, 8, 1e-6
N_BINS = BINS_PER_DECADE * DECADES + 2  # the first: below LOWEST, the last: from 100 on
ENDED = "ended_"  # before the name of an own termination: whether it ended the episode
LOST_BY = tuple(f"lost_by_{cause.split()[-1]}" for cause in LOST_PAIR[1:])  # counts of lost links
# by the code of a robot's lost link, that of its pair's
_OF_PAIR = tuple(next(k for k, cause in enumerate(LOST_PAIR) if name.endswith(cause)) for name in LOST_LINK)
_METER = np.dtype(
    (
        np.record,
        [
            ("open", "i8"),  # the episode was not over before the step
            *((name, "i8") for name in LOST_BY),
            *(
                (name, "i8")
                for name in "steps living living_pairs connected mutual one_way saturated split_cause".split()
            ),
            *((name, "i8") for name in "mutual_time mutual_valid one_way_time one_way_valid".split()),
            *((name, "i8") for name in "name_swaps in_view named".split()),
            *((name, "f8") for name in "lambda2 speed bytes reward least_lambda2 least_separation".split()),
            *((name, "f8") for name in "least_clearance first_loss moved_at alignment aligned hat".split()),
            *((name, "f8") for name in "split_alignment split_hat square_mutual square_one_way".split()),
        ],
    )
)


class Meter(Observer):
    """Measures all worlds from a reset to the end of their episodes.

    It observes a rollout; or, made with a simulator that has been reset, is called `update` after every step.
    """

    def __init__(self, simulator: Simulator | None = None) -> None:
        if simulator is not None:
            self.begin(simulator)

    def begin(self, simulator: Simulator) -> None:
        """Start measuring; the worlds have been reset."""
        self.simulator = simulator
        b = simulator.n_worlds
        self._sums = np.zeros(b, _METER)
        self._sums["open"] = 1
        for name in ("least_lambda2", "least_separation", "least_clearance", "moved_at"):
            self._sums[name] = math.inf
        for name in ("first_loss", "split_alignment", "split_hat"):
            self._sums[name] = math.nan
        self._histograms = np.zeros((b, len(ERRORS), N_BINS), np.uint32)
        self._before = simulator.adjacency()  # of the last step
        self._called: tuple[Any, Any] = None, None  # the state that was measured, and the machine code for it

    def update(self) -> None:
        """Take in the step just made."""
        simulator = self.simulator
        state, code = self._called
        run = code if state is simulator.state else _measure
        arguments = simulator.state, self._sums, self._histograms, self._before, simulator.params
        run(*arguments)
        if run is _measure:
            self._called = simulator.state, code_of(_measure, *arguments)

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_called": (None, None)}  # machine code is of this process

    def results(self) -> dict[str, np.ndarray]:
        """Measures of every episode, (B,) each; names and units in `docs/metrics.md`."""
        sums, scenario, episode = self._sums, self.simulator.scenario, self.simulator.state.episode
        steps = np.maximum(sums["steps"], 1)
        living, pairs = (np.where(sums["steps"] > 0, sums[name], 1) / steps for name in ("living", "living_pairs"))
        duration = steps * scenario.step_time
        mutual, one_way = (self._histograms[:, k].sum(-1) for k in (1, 2))
        return {
            "sct": episode["success"] * np.minimum(ideal_time(scenario) / duration, 1.0),
            "never_disconnected": np.isnan(sums["first_loss"]).astype(float),
            "success": episode["success"].astype(float),
            "collision": episode["collision"].astype(float),
            "connected_share": sums["connected"] / steps,
            "min_lambda2": sums["least_lambda2"],
            "mean_lambda2": sums["lambda2"] / steps,
            "first_disconnection": sums["first_loss"],
            "split_cause": sums["split_cause"].astype(float),
            "split_lambda2_hat": sums["split_hat"],
            "split_alignment": sums["split_alignment"],
            "links_lost_per_minute": sum(sums[name] for name in LOST_BY) / duration * 60,
            **{name: sums[name].astype(float) for name in LOST_BY},
            "mutual_share": _ratio(sums["mutual"] / steps, pairs),
            "one_way_share": _ratio(sums["one_way"] / steps, pairs),
            "least_separation": sums["least_separation"],
            "least_clearance": np.minimum(sums["least_clearance"], 1e3),
            "progress": _ratio(episode["travelled"], episode["pushed"]),
            "duration": duration,
            "time_to_goal": np.where(episode["success"], duration, np.nan),
            "mean_speed": sums["speed"] / steps,
            "saturated_share": _ratio(sums["saturated"] / steps, living),
            "v2_alignment": _ratio(sums["alignment"], sums["connected"]),
            "yaw_rms_mutual": np.sqrt(_ratio(sums["square_mutual"], mutual)),
            "yaw_rms_one_way": np.sqrt(_ratio(sums["square_one_way"], one_way)),
            "yaw_valid_mutual": _ratio(sums["mutual_valid"], sums["mutual_time"]),
            "yaw_valid_one_way": _ratio(sums["one_way_valid"], sums["one_way_time"]),
            "named_share": _ratio(sums["named"], sums["in_view"]),
            "name_swaps": sums["name_swaps"].astype(float),
            "bytes_per_second": sums["bytes"] / duration,
            "return": sums["reward"],
            **{f"{ENDED}{name}": ended.astype(float) for name, ended in self.simulator.own_outcomes().items()},
        }

    def histograms(self) -> np.ndarray:
        """Counts of estimator errors, (B, len(ERRORS), N_BINS), over all robots and steps so far; see `bin_edges`."""
        return self._histograms.copy()


def ideal_time(scenario: Scenario) -> float:
    """Time to the goal, s, of a leader that flies as fast as it is pulled; without one, of a goal held at once."""
    course = scenario.course
    if scenario.leader == "none":
        return course.goal_hold
    speed = min(scenario.stick_speed, scenario.speed_limit)
    return course.settle + course.pause * (course.legs - 1) + (course.legs * course.leg - course.goal_radius) / speed


def bin_edges() -> np.ndarray:
    """Edges between the bins of a histogram, (N_BINS - 1,): 20 a decade from 1e-6 to 100."""
    return LOWEST * 10.0 ** (np.arange(N_BINS - 1) / BINS_PER_DECADE)


def quantile(counts: np.ndarray, share: float) -> float:
    """The error below which a share of a histogram (N_BINS,) lies, interpolated in its bin.

    0 if below LOWEST, NaN of an empty one.
    """
    total = np.cumsum(counts, dtype=np.float64)
    if total[-1] == 0:
        return math.nan
    k = int(np.searchsorted(total, share * total[-1]))
    if k == 0:
        return 0.0
    inside = (share * total[-1] - total[k - 1]) / counts[k]
    return float(LOWEST * 10.0 ** ((k - 1 + min(inside, 1.0)) / BINS_PER_DECADE))


@entry
def _measure(state, sums, histograms, before, params):
    """Add the step just made to the sums (B,) and histograms of every open episode; before: weights (B, N, N)."""
    p, body, pair, belief, episode = params[0], state.body, state.pair, state.belief, state.episode
    n = body.shape[1]
    for b in range(body.shape[0]):
        s = sums[b]
        if s.open == 0:
            continue
        now, lambda2 = episode[b].step * p.step_time, episode[b].lambda2
        _count_motion(body[b], state.reward[b], state.info[b], s, now, p)
        cause = _count_links(pair[b], before[b], s, p)
        s.steps += 1
        s.lambda2 += min(lambda2, p.lambda2_max)
        s.least_lambda2 = min(s.least_lambda2, lambda2)
        connected = lambda2 > p.lambda2_min
        if connected:
            s.connected += 1
            _align(body[b], belief[b], state.mode[b], state.fiedler[b], s, p)
            for i in range(n):
                if body[b, i].alive:
                    histograms[b, 0, _bin(abs(belief[b, i].lambda2_hat - lambda2) / lambda2)] += 1
        elif math.isnan(s.first_loss):
            s.first_loss, s.split_cause = now, cause if cause > 0 else _weakness(pair[b], state.fiedler[b], p)
            s.split_alignment, s.split_hat = s.aligned, s.hat  # of the last step before it
        _count_yaws(body[b], pair[b], state.peer[b], s, histograms[b], now >= s.moved_at + WARM)
        s.open = 0 if episode[b].over else 1


@kernel
def _count_motion(bodies, rewards, infos, s, now, p):
    n, living = bodies.shape[0], count_living(bodies)
    s.living += living
    s.living_pairs += living * (living - 1) // 2
    for i in range(n):
        s.reward += rewards[i] / n
        a = bodies[i]
        if not a.alive:
            continue
        speed = math.sqrt(a.vx * a.vx + a.vy * a.vy + a.vz * a.vz)
        command = math.sqrt(a.command_vx**2 + a.command_vy**2 + a.command_vz**2)
        if speed > MOVING:
            s.moved_at = min(s.moved_at, now)
        s.speed += speed / living
        s.saturated += command > 0.999 * p.speed_limit
        s.bytes += infos[i].bytes_sent / living
        s.name_swaps += int(infos[i].name_swaps)
        s.least_separation = min(s.least_separation, a.nearest)
        s.least_clearance = min(s.least_clearance, a.clearance)


@kernel
def _count_links(pairs, before, s, p):
    """Count lost links and kinds of sight; returns why the strongest lost one was lost, see LOST_PAIR."""
    n, strongest, cause = pairs.shape[0], 0.0, 0
    for i in range(n):
        for j in range(i + 1, n):
            ij, ji = pairs[i, j], pairs[j, i]
            weight = before[i, j]
            if weight > 0.0 and ij.weight == 0.0:
                why = lost_link(ij, OWN_VIEW, p)
                s.lost_by_range += why == RANGE
                s.lost_by_view += why == OWN_VIEW
                s.lost_by_occlusion += why == OCCLUSION
                s.lost_by_fault += why == FAULT
                if weight > strongest:
                    strongest, cause = weight, _OF_PAIR[why]
            before[i, j] = ij.weight
            s.mutual += ij.seen and ji.seen
            s.one_way += ij.seen != ji.seen
    return cause


@kernel
def _weakness(pairs, v2, p):
    """What makes the strongest link between the two sides of v2 weak, distance or field of view, see LOST_PAIR."""
    n, strongest, cause = pairs.shape[0], -1.0, 0
    for i in range(n):
        for j in range(i + 1, n):
            if (v2[i] > 0.0) != (v2[j] > 0.0) and pairs[i, j].weight > strongest:
                strongest, gamma = pairs[i, j].weight, range_weight(pairs[i, j].distance, p)
                # the weight is gamma times the view's
                cause = _OF_PAIR[RANGE if gamma * gamma <= strongest else OWN_VIEW]
    return cause


@kernel
def _align(bodies, beliefs, modes, v2, s, p):
    """Cosine between the living robots' v2 and the true one, without sign, and the mean of their lambda2_hat.

    With flooding each robot has a vector of its own (N,), and the mean of the cosines counts.
    """
    n, along, square, hat, aligned = v2.shape[0], 0.0, 0.0, 0.0, 0.0
    living = count_living(bodies)
    for i in range(n):
        if not bodies[i].alive:
            continue
        along += beliefs[i].v2_hat * v2[i]
        square += beliefs[i].v2_hat ** 2
        hat += beliefs[i].lambda2_hat / living
        if p.lambda2 == FLOODING:
            own = 0.0
            for j in range(n):
                own += modes[i, j] * v2[j]
            aligned += abs(own) / living
    if p.lambda2 != FLOODING:
        aligned = abs(along) / math.sqrt(square) if square > 0.0 else 0.0
    s.aligned, s.hat = aligned, hat
    s.alignment += aligned


@kernel
def _count_yaws(bodies, pairs, peers, s, histograms, settled):
    """Errors and validity of relative yaws by sight class, of all ordered pairs."""
    n = bodies.shape[0]
    for i in range(n):
        for j in range(n):
            seen, watched = pairs[i, j].seen, pairs[j, i].seen
            if i == j or not (seen or watched):
                continue
            track, mutual = peers[i, j].track, seen and watched
            s.in_view += seen
            s.named += seen and track.held
            valid = track.valid and track.present
            if settled and mutual:
                s.mutual_time += 1
                s.mutual_valid += valid
            elif settled:
                s.one_way_time += 1
                s.one_way_valid += valid
            if not valid:
                continue
            estimate = math.atan2(track.sin_used, track.cos_used)
            half = abs(math.sin(0.5 * (estimate - (bodies[j].yaw - bodies[i].yaw))))
            if mutual:
                s.square_mutual += half * half
                histograms[1, _bin(half)] += 1
            else:
                s.square_one_way += half * half
                histograms[2, _bin(half)] += 1


def compile_ahead(policy: PilotClass, scenario: Scenario) -> None:
    """Compile, or find compiled, what a measured flight of a policy needs: its reset, and one step."""
    for _ in itertools.islice(rollout(policy, scenario, [0], observers=[Meter()]), 2):
        pass


@kernel
def _bin(error):
    """Index of the bin of an error, see `bin_edges`."""
    if not error >= LOWEST:
        return 0
    return min(math.floor(math.log10(error / LOWEST) * BINS_PER_DECADE) + 1, N_BINS - 1)


def _ratio(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """part / whole, NaN where there is no whole."""
    return np.divide(part, whole, out=np.full(np.shape(whole), np.nan), where=np.asarray(whole) > 0)
