"""Odometry and IMU: what a robot measures of its own motion."""

from __future__ import annotations

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths import random


@kernel
def measure_ego_motion(body, ego, i, episode, p):
    """Odometry and IMU of robot i: actual velocity, yaw rate, roll and pitch, with noise and bias where set."""
    ego.vx, ego.vy, ego.vz, ego.yaw_rate = body.vx, body.vy, body.vz, body.yaw_rate
    ego.roll, ego.pitch = body.roll, body.pitch
    key, tick = episode.key, episode.n_rounds
    if p.velocity_noise > 0.0 or p.velocity_bias > 0.0:
        a, b, c = random.sensor_error(key, tick, i, random.VELOCITY, p.velocity_noise, p.velocity_bias)
        ego.vx, ego.vy, ego.vz = ego.vx + a, ego.vy + b, ego.vz + c
    if p.gyro_noise > 0.0 or p.gyro_bias > 0.0:
        a, _, _ = random.sensor_error(key, tick, i, random.GYRO, p.gyro_noise, p.gyro_bias)
        ego.yaw_rate += a
    if p.attitude_noise > 0.0 or p.attitude_bias > 0.0:
        a, b, _ = random.sensor_error(key, tick, i, random.ATTITUDE, p.attitude_noise, p.attitude_bias)
        ego.roll, ego.pitch = ego.roll + a, ego.pitch + b
