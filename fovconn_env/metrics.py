"""What an episode was worth, beyond its return: measured against the truth, for a whole batch at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fovconn_env.flight import true_yaw
from fovconn_env.layout import BYTES_PER_MESSAGE, bytes_per_table
from fovconn_env.simulator import Simulator

WARM = 5.0  # s after the first motion from which the validity of yaw estimates counts
MOVING = 0.05  # m/s, a robot that is faster moves


class Samples(NamedTuple):
    """Estimator errors of all robots and steps, pooled over episodes."""

    lambda2: np.ndarray  # relative error of lambda2_hat, |hat - true| / true, while the team is connected
    yaw_mutual: np.ndarray  # sin(error / 2) of valid estimates, both see each other
    yaw_one_way: np.ndarray  # the same where only one of the two sees the other


class Meter:
    """Follows a simulator from a reset to the end of its episodes; call `update` after every step."""

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator
        b = simulator.n_worlds
        self._open = np.ones(b, bool)  # episodes not over before the step
        self._sums = {name: np.zeros(b) for name in _SUMS}
        self._least = {name: np.full(b, np.inf) for name in ("lambda2", "separation", "clearance")}
        self._first_loss = np.full(b, np.nan)
        self._moved_at = np.full(b, np.inf)
        self._links = simulator.adjacency() > 0
        self._samples: tuple[list, list, list] = ([], [], [])

    def update(self) -> None:
        """Take in the step just made."""
        sim, live = self.simulator, self._open.copy()
        scenario, state = sim.scenario, sim.state
        body, pair, episode = state.body, state.pair, state.episode
        now = episode["step"] * scenario.step_time
        lambda2 = episode["lambda2"]
        connected = lambda2 > scenario.lambda2_min
        links = pair["weight"] > 0
        seen = pair["seen"]
        mutual, one_way = seen & seen.transpose(0, 2, 1), seen ^ seen.transpose(0, 2, 1)
        speed = np.sqrt(body["vx"] ** 2 + body["vy"] ** 2 + body["vz"] ** 2)
        self._moved_at = np.where((speed > MOVING).any(1) & live, np.minimum(self._moved_at, now), self._moved_at)
        command = np.sqrt(sum(body[f"command_{name}"] ** 2 for name in ("vx", "vy", "vz")))
        self._add(live, "steps", 1.0)
        self._add(live, "connected", connected)
        self._add(live, "lambda2", np.minimum(lambda2, scenario.lambda2_max))
        self._add(live, "lost", (self._links & ~links).sum((1, 2)) / 2)
        self._add(live, "mutual", mutual.sum((1, 2)) / 2)
        self._add(live, "one_way", one_way.sum((1, 2)) / 2)
        self._add(live, "speed", speed.mean(1))
        self._add(live, "saturated", (command > 0.999 * scenario.speed_limit).mean(1))
        self._add(live, "bytes", state.info["bytes_sent"].mean(1))
        self._add(live, "reward", state.reward.mean(1))
        settled = live & (now >= self._moved_at + WARM)
        valid = state.track["valid"] & state.track["present"]
        for name, kind in (("mutual", mutual), ("one_way", one_way)):
            self._add(settled, f"{name}_time", kind.sum((1, 2)))
            self._add(settled, f"{name}_valid", (kind & valid).sum((1, 2)))
        for name, value in (
            ("lambda2", lambda2),
            ("separation", body["nearest"].min(1)),
            ("clearance", body["clearance"].min(1)),
        ):
            np.minimum(self._least[name], value, out=self._least[name], where=live)
        self._first_loss = np.where(live & ~connected & np.isnan(self._first_loss), now, self._first_loss)
        self._links = links
        self._sample(live, connected, mutual & valid, one_way & valid)
        self._open &= ~sim.over

    def results(self) -> dict[str, np.ndarray]:
        """Measures of every episode, (B,) each; names and units in `docs/metrics.md`."""
        sim, sums = self.simulator, self._sums
        scenario, episode = sim.scenario, sim.state.episode
        n, steps = scenario.n_agents, np.maximum(sums["steps"], 1)
        duration, pairs = steps * scenario.step_time, n * (n - 1) / 2
        flooded = bytes_per_table(n) if scenario.lambda2 == "flooding" else 0  # with one message of a tick's
        per_message = BYTES_PER_MESSAGE + flooded / scenario.clock.rounds
        return {
            "never_disconnected": np.isnan(self._first_loss).astype(float),
            "success": episode["success"].astype(float),
            "collision": episode["collision"].astype(float),
            "connected_share": sums["connected"] / steps,
            "min_lambda2": self._least["lambda2"],
            "mean_lambda2": sums["lambda2"] / steps,
            "first_disconnection": self._first_loss,
            "links_lost_per_minute": sums["lost"] / duration * 60,
            "mutual_share": sums["mutual"] / steps / pairs,
            "one_way_share": sums["one_way"] / steps / pairs,
            "least_separation": self._least["separation"],
            "least_clearance": np.minimum(self._least["clearance"], 1e3),
            "progress": _ratio(episode["travelled"], episode["pushed"]),
            "duration": duration,
            "mean_speed": sums["speed"] / steps,
            "saturated_share": sums["saturated"] / steps,
            "yaw_valid_mutual": _ratio(sums["mutual_valid"], sums["mutual_time"]),
            "yaw_valid_one_way": _ratio(sums["one_way_valid"], sums["one_way_time"]),
            "messages_per_second": sums["bytes"] / per_message / duration,
            "bytes_per_second": sums["bytes"] / duration,
            "return": sums["reward"],
        }

    def samples(self) -> Samples:
        """Estimator errors of all steps so far."""
        return Samples(*(np.concatenate([np.zeros(0, np.float32), *kept]) for kept in self._samples))

    def _add(self, live: np.ndarray, name: str, value: np.ndarray | float) -> None:
        self._sums[name] += np.where(live, value, 0.0)

    def _sample(self, live: np.ndarray, connected: np.ndarray, mutual: np.ndarray, one_way: np.ndarray) -> None:
        state, true = self.simulator.state, self.simulator.state.episode["lambda2"][:, None]
        good = live & connected
        error = np.abs(state.belief["lambda2_hat"] - true) / np.maximum(true, 1e-12)
        self._samples[0].append(error[good].astype(np.float32).ravel())
        estimate = np.arctan2(state.track["sin_used"], state.track["cos_used"])
        half = np.sin((estimate - true_yaw(state.body["yaw"])) / 2).astype(np.float32)
        self._samples[1].append(half[mutual & live[:, None, None]])
        self._samples[2].append(half[one_way & live[:, None, None]])


_SUMS = (
    "steps connected lambda2 lost mutual one_way speed saturated bytes reward "
    "mutual_time mutual_valid one_way_time one_way_valid"
).split()


def _ratio(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """part / whole, NaN where there is no whole."""
    return np.divide(part, whole, out=np.full(np.shape(whole), np.nan), where=np.asarray(whole) > 0)
