"""DAgger (Ross, Gordon and Bagnell, AISTATS 2011): imitate a law on the states that the learner itself gets into.

fly -> label -> aggregate -> regress. In each iteration the worlds fly on, by the law in a share beta of the episodes
and by the network in the others; every few steps the rows go into a buffer with what the law would do there; then the
network learns from the buffer. It is SB3's `ActorCriticPolicy` of a PPO model, so that PPO continues from it. A teacher
may know more than the learner: `informed:cohesive` acts by the truth, and the network by what a robot observes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from fovconn_env import Scenario
from fovconn_env.baselines import Policy, TeamOracle, find_pilot
from fovconn_env.baselines.learned.cards import BASES
from fovconn_env.baselines.learned.inputs import ACTION
from fovconn_env.baselines.learned.policy import load
from fovconn_env.bounds import check_numbers, fraction, positive, setting
from fovconn_env.errors import rule
from fovconn_env.fields import check_array
from fovconn_env.flights.truth import read_truth
from fovconn_env.training.learn.checkpoints import below, check_like
from fovconn_env.training.learn.curriculum import Curriculum
from fovconn_env.training.learn.learning import Algorithm
from fovconn_env.training.learn.model import Network, actor, load_weights, make_model, prepare
from fovconn_env.training.learn.rows import Rows


@dataclass(frozen=True, kw_only=True)
class DaggerSettings:
    """Hyper-parameters; why these: docs/training.md."""

    expert: str = setting("expert", "the law to imitate: expert, augmented or cohesive")
    n_worlds: int = positive(64, "flown at once")
    n_steps: int = positive(200, "flown in an iteration, in each world")
    every: int = positive(4, "one of so many steps is labelled: neighbouring ones are nearly the same")
    capacity: int = positive(500_000, "rows of the buffer; when it is full, new ones replace random old ones")
    n_updates: int = positive(150, "gradient steps in an iteration")
    batch: int = positive(1024, "samples of a gradient step")
    learning_rate: float = positive(1e-3, "at the start; falls to 1 % along a cosine")
    knee: float = positive(0.02, "error from which the loss grows linearly: small errors matter where V' is steep")
    mixed: float = fraction(0.15, "share of the training in which the law still flies, less and less")
    frontier: float = fraction(0.0, "how far scenarios flown half of the time are preferred; 0: not at all")

    def __post_init__(self) -> None:
        check_numbers(self)
        rule(self.expert in BASES, "DaggerSettings.expert", f"one of {', '.join(BASES)}", self.expert, "no memory")


class Dagger(Algorithm):
    """See the module."""

    name = "dagger"

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seed: int = 0,
        settings: DaggerSettings | None = None,
        network: Network | None = None,
        *,
        weights: npt.ArrayLike | None = None,
        teachers: Sequence[str] = (),
        start: Path | None = None,
        n_threads: int | None = None,
    ) -> None:
        """weights: as of `Rows`; teachers: a pilot's name for each scenario, by default the law of the settings.

        start: a policy to go on from; it flies from the first step, since it shows itself where a good flight leads.
        """
        s, network = settings or DaggerSettings(), (network or Network()).deviating(-2.0)
        self.curriculum = Curriculum(weights, s.frontier, len(scenarios))
        drawn = self.curriculum.weights
        self.rows = Rows(scenarios, s.n_worlds, weights=drawn, memory=network.memory, n_threads=n_threads)
        self.rows.seed(seed)
        super().__init__(make_model(self.rows, network, seed), scenarios, seed, s, network)
        self.s, self.start = s, start
        if start is not None:
            load_weights(self.policy, *load(start)[1:])
        self.teachers = list(teachers) or [s.expert] * len(scenarios)
        hint, least = "one a scenario", self.rows.num_envs
        rule(
            s.capacity >= least, "capacity", f"at least {least}, the robots of a step", s.capacity, "or fewer n_worlds"
        )
        rule(len(self.teachers) == len(scenarios), "teachers", f"{len(scenarios)} names", len(self.teachers), hint)
        pairs = zip(self.teachers, scenarios, strict=True)
        self.laws = [teacher(name, scenario) for name, scenario in pairs]
        self.seen = np.zeros((s.capacity, self.rows.observations.shape[1]), np.float32)
        self.wanted = np.zeros((s.capacity, ACTION), np.float32)
        self.filled = 0
        self.by_law = np.full(self.rows.num_envs, start is None)  # rows whose episode the law flies
        self.rows.seed(seed)
        self.rows.reset()

    def iterate(self, share: float) -> dict[str, float]:
        """Fly, label, learn."""
        rng = self.generator()
        self.curriculum.move(self.rows)
        self.fly(rng, beta=max(1.0 - share / max(self.s.mixed, 1e-9), 0.0) if self.start is None else 0.0)
        rate = self.s.learning_rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * share)))
        return {"loss": self.learn(rng, rate), "learning_rate": rate, "buffer": self.filled, **self.rows.outcomes()}

    def fly(self, rng: np.random.Generator, beta: float) -> None:
        """n_steps in all worlds; a new episode is the law's with probability beta."""
        pilot = actor(self.policy)
        for k in range(self.s.n_steps):
            keep = k % self.s.every == 0
            observations = self.rows.observations
            actions = pilot.run(prepare(self.policy, observations))[0].numpy()
            if keep or self.by_law.any():
                labels = self.labels()
                actions[self.by_law] = labels[self.by_law]
                if keep:
                    self.store(rng, observations, labels)
            _, _, ended, _ = self.rows.step(actions)
            self.steps += len(actions)
            self.redraw(rng, ended, beta)

    def labels(self) -> np.ndarray:
        """The law's actions for every row, in the network's units."""
        wanted = np.zeros((self.rows.num_envs, ACTION), np.float32)
        for k, rows in self.rows.parts:
            law = self.laws[k]
            if isinstance(law, TeamOracle):
                simulator, places = self.rows.flies(k, rows)
                asked = law.decide(read_truth(simulator)).reshape(-1, ACTION)[places]
            else:
                asked = law.decide(self.rows.flat(k, rows))
            wanted[rows] = asked / self.rows.gains[k]
        return wanted

    def redraw(self, rng: np.random.Generator, ended: np.ndarray, beta: float) -> None:
        """Draw law or network for the worlds with a new episode; all robots of a world have the same pilot."""
        for team in self.rows.teams:
            new = ended[team.rows].reshape(-1, team.n_agents)[:, 0]
            if new.any():
                drawn = rng.random(int(new.sum())) < beta
                self.by_law[team.rows].reshape(-1, team.n_agents)[new] = drawn[:, None]

    def store(self, rng: np.random.Generator, observations: np.ndarray, labels: np.ndarray) -> None:
        """Store rows in the buffer: at its end, or at random places when it is full."""
        count, free = len(labels), self.s.capacity - self.filled
        if count <= free:
            places = np.arange(self.filled, self.filled + count)
            self.filled += count
        else:
            places = rng.choice(self.filled, min(count, self.filled), replace=False)
        self.seen[places], self.wanted[places] = observations[: len(places)], labels[: len(places)]

    def learn(self, rng: np.random.Generator, rate: float) -> float:
        """n_updates of regression; the mean loss."""
        return regress(self.model.policy, self.seen, self.wanted, self.filled, rng, rate, self.s)

    def recipe(self) -> dict:
        """With what is drawn, the teachers and the start."""
        others: dict[str, Any] = {"teachers": self.teachers} if set(self.teachers) != {self.s.expert} else {}
        if self.start is not None:
            others["start"] = load(self.start)[0].sha256
        return super().recipe() | self.curriculum.recipe() | others

    def pack(self) -> dict[str, np.ndarray]:
        """With buffer and worlds: about 0.4 GB when the buffer is full."""
        arrays = {f"rows/{name}": array for name, array in self.rows.pack().items()}
        arrays |= {"seen": self.seen[: self.filled], "wanted": self.wanted[: self.filled], "by_law": self.by_law}
        return super().pack() | arrays

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the state of `pack`."""
        super().unpack(arrays)
        check_array("seen", arrays.get("seen"), "f4", (-1, self.seen.shape[1]))
        check_array("wanted", arrays.get("wanted"), "f4", (len(arrays["seen"]), ACTION))
        seen, wanted = arrays["seen"], arrays["wanted"]
        rule(len(seen) <= self.s.capacity, "seen", f"at most {self.s.capacity} rows", len(seen), "the buffer has more")
        check_like("by_law", arrays.get("by_law"), self.by_law)
        self.rows.unpack(below(arrays, "rows"))
        self.filled, self.by_law = len(seen), arrays["by_law"]
        self.seen[: self.filled], self.wanted[: self.filled] = seen, wanted


def teacher(name: str, scenario: Scenario) -> Policy | TeamOracle:
    """A pilot that can be asked at any state; `SettingError` for one with a memory or own equipment."""
    kind: Any = find_pilot(name)
    rule(not kind.overrides, "teacher", "a policy that flies with any equipment", name, f"it needs {kind.overrides}")
    pilot = kind(scenario)
    rule(not pilot.has_memory, "teacher", "a policy without a memory", name, "rows are labelled now and then")
    return pilot


def regress(policy, seen, wanted, count, rng, rate, s) -> float:
    """n_updates with batches from the first `count` rows of seen and wanted; the mean loss.

    The loss is smooth L1: quadratic below `knee`, linear above, so that saturated actions do not drown the rest.
    """
    for group in policy.optimizer.param_groups:
        group["lr"] = rate
    learner, total = actor(policy), 0.0
    for _ in range(s.n_updates):
        chosen = rng.integers(0, count, s.batch)
        inputs, labels = prepare(policy, seen[chosen]), torch.from_numpy(wanted[chosen])
        policy.optimizer.zero_grad()
        output, kept = learner.run(inputs)
        error = output - labels
        near = error.clamp(-s.knee, s.knee)
        learner.add_gradient(kept, near / (s.knee * labels.numel()))
        total += float((near * (error - near / 2.0)).mean()) / s.knee
        torch.nn.utils.clip_grad_norm_(learner.parameters, 1.0)
        policy.optimizer.step()
    return total / s.n_updates
