"""A whole team in numpy, tick by tick: model (1), cameras, messages, both estimators, and what each robot observes.

Kinematic model, sight links, no noise, no loss, delivery in the next round; the equations are those of `reference`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fovconn_env import layout
from tests import reference as ref


class Post(NamedTuple):
    """All messages of one round: entry [i, j] is what i says to j."""

    links: np.ndarray  # (N, N) bool
    A: np.ndarray  # (N, N) link weights
    sight: dict  # (i, j): p_ij, only where i sees j
    f: np.ndarray  # (N, N)
    psi: np.ndarray  # (N, N) own estimates
    valid: np.ndarray  # (N, N) bool
    motion: np.ndarray  # (N, 4) velocity in the own yaw frame, yaw rate
    x: np.ndarray  # (N,)
    y: np.ndarray  # (3, N)


class Team:
    def __init__(self, scenario, poses, x):
        self.scenario, self.n = scenario, len(poses)
        self.p, self.yaw = poses[:, :3].copy(), poses[:, 3].copy()
        self.motion = np.zeros((self.n, 4))
        self.flooding = scenario.lambda2 == "flooding"
        self.power = ref.Flooding(self.n) if self.flooding else ref.PowerIteration(x)
        self.n_ticks = 0
        self.pairs = [(i, j) for i in range(self.n) for j in range(self.n) if i != j]
        self.yaws = {pair: ref.YawEstimator() for pair in self.pairs}
        self.post = None  # on the air
        self.last: dict = {}  # (i, j): the Post in which i last heard of j
        self.age = np.full((self.n, self.n), scenario.radio.memory)
        self.weight = np.zeros((self.n, self.n))  # agreed A_ij
        self.beats = np.zeros((self.n, self.n))  # [knows, of]: last tick known of each
        self.beat_air = None
        self.distance = np.zeros((self.n, self.n))

    @property
    def round_time(self):
        return self.scenario.clock.tick / self.scenario.clock.rounds

    @property
    def poses(self):
        return [ref.Pose(p, yaw) for p, yaw in zip(self.p, self.yaw, strict=True)]

    def tick(self, commands=None):
        """commands (N, 4): velocities in the yaw frames and yaw rates; None holds the robots."""
        if commands is not None:
            self.move(commands)
        self.sense()
        self.n_ticks += 1
        for k in range(self.scenario.clock.rounds):
            self.deliver()
            if k == 0:
                np.fill_diagonal(self.beats, self.n_ticks)
                self.beat_air = self.beats.copy()
            if self.flooding and k == 0:
                self.power.write(self.weight, self.n_ticks)
            self.write()
        for pair in self.pairs:
            self.orient(*pair)

    def move(self, commands):
        """(1), on the heading half-way through the tick."""
        dt, self.motion = self.scenario.clock.tick, np.array(commands)
        for i, (*v, w) in enumerate(commands):
            self.p[i] += dt * ref.Rz(self.yaw[i] + 0.5 * w * dt) @ v
            self.yaw[i] += dt * w

    def sense(self):
        camera, team = self.scenario.camera, self.poses
        self.sight = {
            (i, j): ref.relative(team[i], team[j]) for i, j in self.pairs if ref.watches(team[i], team[j], camera)
        }
        self.f = np.zeros((self.n, self.n))
        for i, j in self.sight:
            self.f[i, j] = ref.f_star(ref.cosine(team[i], team[j], camera), camera)
            self.distance[i, j] = np.linalg.norm(self.sight[i, j])

    def deliver(self):
        """What was written in the last round arrives; the power iteration uses it."""
        scenario, links, A = self.scenario, np.zeros((self.n, self.n), bool), self.weight
        self.age = np.minimum(self.age + self.round_time, scenario.radio.memory)
        if self.post is not None:
            links = self.post.links
            A = np.where(links, self.post.A, np.where(self.age >= scenario.radio.memory, 0.0, self.weight))
            self.age[links] = 0.0
            for i, j in zip(*np.nonzero(links), strict=True):
                self.last[i, j] = self.post
        self.weight = A
        if self.beat_air is not None:
            for i, j in zip(*np.nonzero(links), strict=True):
                self.beats[i] = np.maximum(self.beats[i], self.beat_air[j])
            self.beat_air = None
        if not self.flooding:
            self.power.round(A, links, self.age < scenario.radio.memory, scenario.power.scaled(self.n))
        elif self.power.air is not None:
            self.power.deliver(links)

    def write(self):
        links = np.zeros((self.n, self.n), bool)
        psi, valid = np.zeros((self.n, self.n)), np.zeros((self.n, self.n), bool)
        for i, j in self.pairs:
            links[i, j] = (i, j) in self.sight or (j, i) in self.sight
            psi[i, j], valid[i, j] = self.yaws[i, j].psi, self.yaws[i, j].valid
        A = ref.weights(self.poses, self.scenario.camera, self.scenario.weight)
        said = self.sight, self.f.copy(), psi, valid, self.motion.copy(), self.power.x.copy(), self.power.y.copy()
        self.post = Post(links, A, *said)

    def heard(self, i, j):
        post = self.last.get((i, j))
        if post is None:
            return ref.Heard(False, False, np.zeros(3), 0.0, 0.0, False, np.zeros(3), 0.0)
        seen = (j, i) in post.sight
        p_ji = post.sight.get((j, i), np.zeros(3))
        told = self.age[i, j] < self.scenario.radio.memory
        *v, w = post.motion[j]
        return ref.Heard(told, seen, p_ji, post.f[j, i], post.psi[j, i], bool(post.valid[j, i]), np.array(v), w)

    def orient(self, i, j):
        sight, heard = self.sight.get((i, j)), self.heard(i, j)
        *v, w = self.motion[i]
        settings = self.scenario.yaw, self.scenario.clock.tick
        self.yaws[i, j].tick(sight, sight is not None, self.f[i, j], np.array(v), w, heard, *settings)
        if sight is None and heard.told and heard.seen:
            self.distance[i, j] = np.linalg.norm(heard.p_ji)

    def present(self, i, j):
        heard = self.heard(i, j)
        return (i, j) in self.sight or (heard.told and heard.seen)

    def conclude(self):
        """At the end of a step."""
        if self.flooding:
            self.power.solve(self.n_ticks, self.scenario.flooding.memory / self.scenario.clock.tick + 1e-6)

    # ---------------------------------------------------------------------------------------------- observation
    def observe(self, i, stick):
        """Robot i's observation (D,): the columns of layout, row by row."""
        leader = float(i == self.scenario.leader_index)
        own = dict(
            zip(("vx", "vy", "vz", "yaw_rate"), self.motion[i], strict=True), roll=0.0, pitch=0.0, is_leader=leader
        )
        missed = (self.n_ticks - self.beats[i]) * self.scenario.clock.tick
        own |= {"team_share": np.mean(missed < self.scenario.radio.liveness + 1e-6)}
        own |= {"lambda2_hat": self.power.lambda2_hat[i], "v2_hat": self.power.v2_hat[i]}
        own |= {f"stick_{a}": leader * s for a, s in zip("xyz", stick, strict=True)}
        near = sorted((j for j in range(self.n) if j != i and self.present(i, j)), key=lambda j: self.distance[i, j])
        rows = [self.neighbor(i, j) for j in near]
        points = ref.range_points(
            i,
            self.poses,
            [],
            0.5 * self.scenario.collision_robot,
            self.scenario.rangefinder.range_max,
            self.scenario.max_ranges,
        )
        ranges = [{"present": 1.0, **dict(zip("xyz", point, strict=True))} for point in points]
        return np.concatenate(
            [
                _table([own], layout.SELF, 1),
                _table(rows, layout.NEIGHBOR, self.scenario.max_neighbors),
                _table(ranges, layout.RANGE, self.scenario.max_ranges),
            ]
        )

    def neighbor(self, i, j):
        heard, post, estimate = self.heard(i, j), self.last.get((i, j)), self.yaws[i, j]
        d, bearing = self.distance[i, j], np.zeros(3)
        if (i, j) in self.sight:
            bearing = self.sight[i, j] / d
        elif estimate.valid:
            bearing = -ref.Rz(estimate.psi_used) @ heard.p_ji / d  # case 2 of Sec. III-C
        x_j, y_j = (post.x[j], post.y[:, j]) if post is not None else (0.0, np.zeros(3))
        v2_j = self.power.vectors[i, j] if self.flooding else x_j / np.sqrt(self.n * self.power.size[i])
        return {
            **{
                "present": 1.0,
                "f_ij": self.f[i, j],
                "f_ji": heard.f_ji,
                "distance": d,
                "yaw_valid": float(estimate.valid),
            },
            **{f"bearing_{a}": b for a, b in zip("xyz", bearing, strict=True)},
            **{"cos_yaw": np.cos(estimate.psi_used), "sin_yaw": np.sin(estimate.psi_used), "roll": 0.0, "pitch": 0.0},
            **{f"v{a}": v for a, v in zip("xyz", heard.v_j, strict=True)},
            **{"yaw_rate": heard.w_j, "v2_hat": v2_j},
            **{
                "lambda2_hat": max(y_j[2] / max(y_j[1], 1e-6), 0.0),
                "weight": self.weight[i, j],
                "age": self.age[i, j] + self.round_time,
            },
        }


def _table(rows, table, count):
    """Rows (dicts by column name) as a flat table padded with zeros to `count` rows."""
    filled = np.zeros((count, len(table)))
    for k, row in enumerate(rows[:count]):
        assert row.keys() == {column.name for column in table}
        filled[k] = [row[column.name] for column in table]
    return filled.ravel()
