"""Taking over a robot and giving it back without a jump."""

from __future__ import annotations

import numpy as np

from fovconn_env.sim.simulator import Simulator

RISE = 1.8  # m/s^2, fastest change of the commanded velocity in a handover: 0.09 m/s in a step of 0.05 s
TURN = 3.0  # rad/s^2, the same of the commanded yaw rate


class Handover:
    """Robots whose commands still are on their way to what their new pilot wants.

    The way ends when the command is there, not before. So a new pilot that jumps by more than this in every step
    (the policy `random`) is held back until it happens to be met.
    """

    def __init__(self, n_agents: int) -> None:
        self.open = np.zeros(n_agents, bool)  # (N,)

    def begin(self, *robots: int) -> None:
        """These robots get another pilot with the next step."""
        self.open[list(robots)] = True

    def soften(self, simulator: Simulator, actions: np.ndarray) -> None:
        """Change the actions (N, 4) for the first world's next step where a robot is handed over."""
        scenario, episode, bodies = simulator.scenario, simulator.state.episode[0], simulator.state.body[0]
        top = scenario.speed_limit + scenario.stick_speed
        for i in np.flatnonzero(self.open):
            body, pull = bodies[i], np.zeros(3)
            if i == episode["leader"]:
                pull = np.array([episode[f"stick_{axis}"] for axis in "xyz"])
            wish = np.clip(actions[i], -1.0, 1.0)
            velocity = wish[:3] * top + pull
            velocity *= scenario.speed_limit / max(float(np.linalg.norm(velocity)), scenario.speed_limit)
            before = np.array([body[f"command_v{axis}"] for axis in "xyz"])
            velocity, there = _towards(before, velocity, RISE * scenario.step_time)
            rate, turned = _towards(
                np.array([body["command_yaw_rate"]]),
                wish[3:] * scenario.yaw_rate_limit,
                TURN * scenario.step_time,
            )
            actions[i, :3] = (velocity - pull) / top  # the environment adds the stick again
            actions[i, 3:] = rate / scenario.yaw_rate_limit
            self.open[i] = not (there and turned)


def _towards(now: np.ndarray, goal: np.ndarray, reach: float) -> tuple[np.ndarray, bool]:
    """At most `reach` from `now` towards a goal, (n,) each, and whether it was reached."""
    way = goal - now
    length = float(np.linalg.norm(way))
    return (goal, True) if length <= reach else (now + way * (reach / length), False)
