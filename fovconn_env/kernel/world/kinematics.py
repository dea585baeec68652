"""The velocity-controlled robot (1), and how any model turns an action into a saturated command."""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import kernel


@kernel
def saturate(vx, vy, vz, limit):
    """Velocity with its Euclidean norm limited and its direction kept. m/s."""
    norm = math.sqrt(vx * vx + vy * vy + vz * vz)
    if norm <= limit:
        return vx, vy, vz
    scale = limit / norm
    return vx * scale, vy * scale, vz * scale


@kernel
def set_command(body, action, stick_x, stick_y, stick_z, p):
    """Set a robot's command from its action, (4,) shares in [-1, 1], and the operator's stick (m/s, yaw frame)."""
    top = p.speed_limit + p.stick_speed
    vx = min(max(action[0], -1.0), 1.0) * top + stick_x
    vy = min(max(action[1], -1.0), 1.0) * top + stick_y
    vz = min(max(action[2], -1.0), 1.0) * top + stick_z
    body.command_vx, body.command_vy, body.command_vz = saturate(vx, vy, vz, p.speed_limit)
    body.command_yaw_rate = min(max(action[3], -1.0), 1.0) * p.yaw_rate_limit


@kernel
def reset_kinematic(body, p):
    """Put a robot at rest and level at its pose, and set what follows from the pose."""
    body.cos_yaw, body.sin_yaw = math.cos(body.yaw), math.sin(body.yaw)
    body.vx = body.vy = body.vz = body.yaw_rate = 0.0
    body.roll = body.pitch = 0.0
    body.axis_x, body.axis_y, body.axis_z = p.axis_x, p.axis_y, p.axis_z
    body.command_vx = body.command_vy = body.command_vz = body.command_yaw_rate = 0.0
    body.turn_cos, body.turn_sin = 1.0, 0.0


@kernel
def cache_half_turn(body, p):
    """Once a step, before its ticks: half a tick's turn at the commanded yaw rate, and the heading without drift."""
    half = 0.5 * body.command_yaw_rate * p.tick
    body.turn_cos, body.turn_sin = math.cos(half), math.sin(half)
    body.cos_yaw, body.sin_yaw = math.cos(body.yaw), math.sin(body.yaw)


@kernel
def step_kinematic(body, p):
    """Integrate (1) over one tick with the commanded velocity, at the heading half-way through the tick.

    Twice half a turn instead of two sines and cosines: in the few ticks of a step that drifts by rounding alone.
    """
    dt, w = p.tick, body.command_yaw_rate
    body.vx, body.vy, body.vz, body.yaw_rate = body.command_vx, body.command_vy, body.command_vz, w
    c, s = body.cos_yaw, body.sin_yaw
    c, s = c * body.turn_cos - s * body.turn_sin, s * body.turn_cos + c * body.turn_sin
    body.x += dt * (c * body.vx - s * body.vy)  # (1)
    body.y += dt * (s * body.vx + c * body.vy)
    body.z += dt * body.vz
    body.cos_yaw, body.sin_yaw = c * body.turn_cos - s * body.turn_sin, s * body.turn_cos + c * body.turn_sin
    yaw = body.yaw + dt * w
    body.yaw = yaw - 2.0 * math.pi * math.floor((yaw + math.pi) / (2.0 * math.pi))
