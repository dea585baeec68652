"""Worlds that draw which of several scenarios they fly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fovconn_env import Scenario, Simulator
from fovconn_env.errors import SettingError, as_numbers, rule
from fovconn_env.sim.seeds import MAX_SEED, Seed, world_seeds

_DRAW = 0x6D6978  # apart from the generators of the starts, which begin with the seed alone


class Mix:
    """B worlds of one team size, each of which flies one of several scenarios, drawn whenever it is reset.

    To the rows it is as a `Simulator`: what it says of a world, the simulator of that world's scenario says. There is
    one of B worlds for each scenario, in which the worlds that fly another one are over: they cost memory, and hardly
    time.
    """

    def __init__(
        self, scenarios: Sequence[Scenario], n_worlds: int, weights: np.ndarray, n_threads: int | None = None
    ) -> None:
        """weights: (V,) probabilities of the scenarios, as `check_weights` takes them."""
        self.simulators = [Simulator(each, n_worlds, n_threads=n_threads) for each in scenarios]
        self.n_worlds, self.scenario, self.weights = n_worlds, scenarios[0], weights
        self.flown = np.zeros(n_worlds, np.int64)  # the number of the scenario that each world flies
        self.generators: list[np.random.Generator | None] = [None] * n_worlds  # of the draws

    def of(self, b: int) -> Simulator:
        """The simulator in which world b flies."""
        return self.simulators[self.flown[b]]

    def reset(self, seed: Seed = None, *, mask: np.ndarray | None = None, poses: Any = None) -> np.ndarray:
        """As `Simulator.reset`, after a draw for each masked world; without a seed the draws go on."""
        chosen = np.ones(self.n_worlds, bool) if mask is None else np.array(mask, bool)
        seeds = world_seeds(seed, self.n_worlds)
        for b in np.flatnonzero(chosen).tolist():
            given = seeds[b]
            if given is not None or self.generators[b] is None:
                self.generators[b] = np.random.default_rng(None if given is None else [given, _DRAW])
            self.flown[b], seeds[b] = self._draw(self.generators[b], given)
        for k, simulator in enumerate(self.simulators):
            here = self.flown == k
            simulator.state.episode["over"][chosen & ~here] = True
            if (chosen & here).any():
                simulator.reset(seeds, mask=chosen & here, poses=poses)
        return self.observations

    def _draw(self, generator: Any, given: int | None) -> tuple[int, int]:
        """A scenario and a seed of its start, the given one if there is one."""
        k = int(generator.choice(len(self.simulators), p=self.weights / self.weights.sum()))
        return k, int(generator.integers(MAX_SEED)) if given is None else given

    def step(self, actions: np.ndarray) -> None:
        """As `Simulator.step`."""
        for simulator in self.simulators:
            if not simulator.over.all():
                simulator.step(actions)

    @property
    def observations(self) -> np.ndarray:
        """(B, N, D) float32, copied."""
        return self._each(lambda simulator: simulator.observations)

    @property
    def rewards(self) -> np.ndarray:
        """(B, N) of the last step, copied."""
        return self._each(lambda simulator: simulator.rewards)

    @property
    def over(self) -> np.ndarray:
        """(B,) bool: needs a reset."""
        return self._each(lambda simulator: simulator.over)

    @property
    def connected(self) -> np.ndarray:
        """(B,) bool: of the last step."""
        return self._each(lambda simulator: simulator.infos["connected"][:, 0] != 0.0)

    def privileged(self) -> np.ndarray:
        """(B, S) float32, as `Simulator.privileged`."""
        return self._each(lambda simulator: simulator.privileged())

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self.simulators[0].closed

    def close(self) -> None:
        """End the threads."""
        for simulator in self.simulators:
            simulator.close()

    def _each(self, read: Callable[[Simulator], np.ndarray]) -> np.ndarray:
        """For each world what is read of its simulator."""
        joined = read(self.simulators[0]).copy()
        for k, simulator in enumerate(self.simulators[1:], 1):
            here = self.flown == k
            if here.any():
                joined[here] = read(simulator)[here]
        return joined


def check_weights(weights: Any, count: int) -> np.ndarray:
    """Probabilities, up to a factor, of so many scenarios, (V,) float64; `SettingError` for what is none."""
    values = as_numbers("weights", weights)
    rule(values.shape == (count,), "weights", f"{count} numbers, one a scenario", values.shape, "shares of the resets")
    fine = bool(np.isfinite(values).all() and (values >= 0.0).all() and values.sum() > 0.0)
    if not fine:
        raise SettingError(f"weights must be at least 0 and not all 0, got {values.tolist()}: shares of the resets")
    return values
