"""Smooth handover of a robot between a person and a policy."""

from __future__ import annotations

import numpy as np

from fovconn_env.sim.simulator import Simulator

RISE = 1.8  # m/s^2, fastest change of the commanded velocity in a handover: 0.09 m/s in a step of 0.05 s
TURN = 3.0  # rad/s^2, the same of the commanded yaw rate


class Handover:
    """Limits the rate of the commands of robots that have a new pilot, until the commands are equal to the pilot's.

    A pilot whose commands change faster than the limit in every step (the policy `random`) stays limited until its
    command happens to be reached.
    """

    def __init__(self, n_agents: int) -> None:
        self.active = np.zeros(n_agents, bool)  # (N,)

    def begin(self, *robots: int) -> None:
        """Begin a handover of these robots with the next step."""
        self.active[list(robots)] = True

    def limit_rates(self, simulator: Simulator, actions: np.ndarray) -> None:
        """Limit in place the actions (N, 4) of the first world's next step for robots in a handover."""
        scenario, episode, bodies = simulator.scenario, simulator.state.episode[0], simulator.state.body[0]
        top = scenario.speed_limit + scenario.stick_speed
        for i in np.flatnonzero(self.active):
            body, pull = bodies[i], np.zeros(3)
            if i == episode["leader"]:
                pull = np.array([episode[f"stick_{axis}"] for axis in "xyz"])
            goal = np.clip(actions[i], -1.0, 1.0)
            velocity = goal[:3] * top + pull
            velocity *= scenario.speed_limit / max(float(np.linalg.norm(velocity)), scenario.speed_limit)
            before = np.array([body[f"command_v{axis}"] for axis in "xyz"])
            velocity, velocity_reached = _move_towards(before, velocity, RISE * scenario.step_time)
            rate, rate_reached = _move_towards(
                np.array([body["command_yaw_rate"]]),
                goal[3:] * scenario.yaw_rate_limit,
                TURN * scenario.step_time,
            )
            actions[i, :3] = (velocity - pull) / top  # the environment adds the stick again
            actions[i, 3:] = rate / scenario.yaw_rate_limit
            self.active[i] = not (velocity_reached and rate_reached)


def _move_towards(now: np.ndarray, goal: np.ndarray, reach: float) -> tuple[np.ndarray, bool]:
    """The point at most `reach` from `now` towards a goal, (n,) each, and whether it is the goal."""
    step = goal - now
    length = float(np.linalg.norm(step))
    return (goal, True) if length <= reach else (now + step * (reach / length), False)
