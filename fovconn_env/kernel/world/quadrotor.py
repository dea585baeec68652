"""Quadrotor: a rigid body under four lagging rotors, and the controller that makes it follow a velocity command.

The controller is the geometric tracking of Lee, Leok and McClamroch (CDC 2010; "Lee" below, in their symbols, z up).
Frames: world; body (x forward, y left, z up); yaw (the world turned by the heading). The quaternion q and its matrix
R = Rz(yaw) Ry(pitch) Rx(roll) turn body into world; b1, b2, b3 are the columns of R. Rotors 0 to 3 stand front left,
rear left, rear right, front right; 0 and 2 turn clockwise seen from above, so their drag turns the body to the left.
"""

from __future__ import annotations

import math

import numpy as np

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths.random import FORCE, ROTOR, draw, normal_triple
from fovconn_env.kernel.world.kinematics import reset_kinematic, saturate

GRAVITY = 9.81  # m/s^2
_LEAST_LIFT = 0.2 * GRAVITY  # m/s^2, kept in the fastest descent: without thrust there is no tilting
_NOISE_STEP = 1e-3  # s, the time step that p.rotor_noise refers to
_SQRT_HALF = math.sqrt(0.5)
_LOW16, _S16, _S32, _S48 = (np.uint64(n) for n in (0xFFFF, 16, 32, 48))


@kernel
def reset_quadrotor(body, flight, p):
    """Put a robot at rest and level where its pose says, its rotors carrying its weight and its references at rest."""
    reset_kinematic(body, p)
    flight.qw, flight.qx, flight.qy, flight.qz = math.cos(0.5 * body.yaw), 0.0, 0.0, math.sin(0.5 * body.yaw)
    flight.vx = flight.vy = flight.vz = flight.wx = flight.wy = flight.wz = 0.0
    speed = math.sqrt(0.25 * p.mass * GRAVITY / p.thrust_gain)
    flight.rotor0 = flight.rotor1 = flight.rotor2 = flight.rotor3 = speed
    flight.ex = flight.ey = flight.ez = flight.yaw_reference = 0.0
    flight.rx = flight.ry = flight.rz = flight.ax = flight.ay = flight.az = 0.0
    flight.fx = flight.fy = flight.fz = 0.0


@kernel
def step_quadrotor(body, flight, p, key, tick, i):
    """Fly robot i for one tick: the position loop runs once, the attitude loop, the rotors and the body in substeps."""
    n = max(1, round(p.tick / p.substep))
    h = p.tick / n
    keep, noise = math.exp(-h / p.rotor_lag), p.rotor_noise * math.sqrt(_NOISE_STEP / h)
    external = disturbance_force(body, flight, p, key, tick, i)  # random force <- its past
    jerk = update_reference(body, flight, p)  # acceleration reference <- command
    thrust, force = desired_force(flight, p)  # force <- references, motion
    goal, omega = desired_attitude(body, flight, force, jerk)  # attitude <- force, yaw reference
    propagate_reference(body, flight, p)  # references <- acceleration reference, command
    dx = dy = dz = 0.0
    for s in range(n):
        command = allocate(thrust, attitude_control(flight, goal, omega, p), p)
        if noise > 0.0:
            command = add_rotor_noise(command, noise, draw(key, tick * n + s, i, ROTOR))
        wrench = step_rotors(flight, command, keep, p)
        x, y, z = integrate(flight, wrench, external, h, p)
        dx, dy, dz = dx + x, dy + y, dz + z
    body.x, body.y, body.z = body.x + dx, body.y + dy, body.z + dz
    flight.ex, flight.ey, flight.ez = flight.ex - dx, flight.ey - dy, flight.ez - dz
    write_body(body, flight, p)


# --------------------------------------------------------------------------------------------------- once a tick
@kernel
def disturbance_force(body, flight, p, key, tick, i):
    """Renew the slow random force (Ornstein-Uhlenbeck, N, yaw frame); acceleration by it and gravity, m/s^2, world."""
    if p.force_noise > 0.0:
        keep = math.exp(-p.tick / p.force_time)
        fresh = p.force_noise * math.sqrt(1.0 - keep * keep)  # keeps the variance
        a, b, c = normal_triple(key, tick, i, FORCE)
        flight.fx = keep * flight.fx + fresh * a
        flight.fy = keep * flight.fy + fresh * b
        flight.fz = keep * flight.fz + fresh * c
    fx, fy = turn(body.cos_yaw, body.sin_yaw, flight.fx, flight.fy)
    return fx / p.mass, fy / p.mass, flight.fz / p.mass - GRAVITY


@kernel
def update_reference(body, flight, p):
    """Set this tick's acceleration reference so that the velocity soonest meets the command; jerk, m/s^3, world.

    An acceleration of k max_jerk dt, taken back by max_jerk dt a tick, adds k (k + 1) / 2 max_jerk dt^2 of velocity.
    """
    dt = p.tick
    gx, gy = turn(body.cos_yaw, body.sin_yaw, body.command_vx, body.command_vy)
    gx, gy, gz = gx - flight.rx, gy - flight.ry, body.command_vz - flight.rz
    gap = math.sqrt(gx * gx + gy * gy + gz * gz)
    k = 0.5 * math.sqrt(1.0 + 8.0 * gap / (p.max_jerk * dt * dt)) - 0.5
    gain = min(k * p.max_jerk * dt, gap / dt, p.max_accel) / max(gap, 1e-12)
    jx, jy, jz = (gain * gx - flight.ax) / dt, (gain * gy - flight.ay) / dt, (gain * gz - flight.az) / dt
    jx, jy, jz = saturate(jx, jy, jz, p.max_jerk)
    flight.ax, flight.ay, flight.az = flight.ax + dt * jx, flight.ay + dt * jy, flight.az + dt * jz
    return jx, jy, jz


@kernel
def desired_force(flight, p):
    """Thrust (Lee: f; N) and the force per mass to give (Lee: A / m; m/s^2, world), tilted by max_tilt at most."""
    ux = p.kp * flight.ex + p.kv * (flight.rx - flight.vx) + flight.ax  # Lee: -k_x e_x - k_v e_v + x_d'' + g e_3
    uy = p.kp * flight.ey + p.kv * (flight.ry - flight.vy) + flight.ay
    uz = p.kp * flight.ez + p.kv * (flight.rz - flight.vz) + flight.az + GRAVITY
    uz = max(uz, _LEAST_LIFT)
    ux, uy, _ = saturate(ux, uy, 0.0, uz * math.tan(p.max_tilt))
    bx, by, bz = body_z(flight.qw, flight.qx, flight.qy, flight.qz)
    return p.mass * (ux * bx + uy * by + uz * bz), (ux, uy, uz)  # Lee: f = A . R e_3


@kernel
def desired_attitude(body, flight, force, jerk):
    """Attitude with b3 along the force and the yaw wanted (Lee: R_d; quaternion), and its body rate (Lee: Omega_d).

    Lee projects the heading on the rotor plane; here it is the yaw of Rz Ry Rx, so that tilting does not turn a robot.
    Lee's rate also holds the rates of e_x and e_v; here it has the reference's jerk alone, which leaves more margin for
    slow rotors: with a lag of 0.05 s and random commands the tilt reached 21 deg, not 76.
    """
    half = 0.5 * (body.yaw + flight.yaw_reference)
    cz, sz = math.cos(half), math.sin(half)
    c, s = cz * cz - sz * sz, 2.0 * cz * sz
    ux, uy = turn(c, -s, force[0], force[1])  # both in the yaw frame wanted
    jx, jy = turn(c, -s, jerk[0], jerk[1])
    uz, jz = force[2], jerk[2]
    side = math.sqrt(ux * ux + uz * uz)
    norm = math.sqrt(ux * ux + uy * uy + uz * uz)
    c_pitch, s_pitch = uz / side, ux / side  # b3 = Ry(pitch) Rx(roll) e_3
    c_roll, s_roll = side / norm, -uy / norm
    wx = -(s_roll * (s_pitch * jx + c_pitch * jz) + c_roll * jy) / norm  # b3' = omega_y b1 - omega_x b2
    wy = (c_pitch * jx - s_pitch * jz) / norm
    wz = (body.command_yaw_rate * c_pitch - wy * s_roll) / c_roll  # so that yaw' is the one commanded
    cy, cx = math.sqrt(0.5 + 0.5 * c_pitch), math.sqrt(0.5 + 0.5 * c_roll)  # half angles
    sy, sx = 0.5 * s_pitch / cy, 0.5 * s_roll / cx
    qw, qx = cz * cy * cx + sz * sy * sx, cz * cy * sx - sz * sy * cx
    qy, qz = cz * sy * cx + sz * cy * sx, sz * cy * cx - cz * sy * sx
    return (qw, qx, qy, qz), (wx, wy, wz)


@kernel
def propagate_reference(body, flight, p):
    """Carry the velocity, position and yaw references through the tick."""
    dt = p.tick
    flight.ex += dt * (flight.rx + 0.5 * dt * flight.ax)
    flight.ey += dt * (flight.ry + 0.5 * dt * flight.ay)
    flight.ez += dt * (flight.rz + 0.5 * dt * flight.az)
    flight.rx, flight.ry, flight.rz = flight.rx + dt * flight.ax, flight.ry + dt * flight.ay, flight.rz + dt * flight.az
    flight.yaw_reference += dt * body.command_yaw_rate


@kernel
def write_body(body, flight, p):
    """Fill the pose's yaw and what follows from the flight: velocity, yaw rate, roll, pitch and optical axis."""
    w, x, y, z = flight.qw, flight.qx, flight.qy, flight.qz
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    flight.qw, flight.qx, flight.qy, flight.qz = w, x, y, z
    b1x, b1y, b1z = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)
    b2x, b2y, b2z = 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)
    b3x, b3y, b3z = body_z(w, x, y, z)
    level = math.sqrt(b1x * b1x + b1y * b1y)  # cos(pitch)
    c, s = b1x / level, b1y / level
    flight.yaw_reference -= math.asin(body.cos_yaw * s - body.sin_yaw * c)
    body.yaw, body.pitch, body.roll = math.atan2(s, c), -math.asin(b1z), math.atan2(b2z, b3z)
    body.cos_yaw, body.sin_yaw = c, s
    body.vx, body.vy = turn(c, -s, flight.vx, flight.vy)
    body.vz = flight.vz
    body.yaw_rate = (flight.wy * b2z + flight.wz * b3z) / (level * level)  # yaw' of Rz Ry Rx
    ox = b1x * p.axis_x + b2x * p.axis_y + b3x * p.axis_z
    oy = b1y * p.axis_x + b2y * p.axis_y + b3y * p.axis_z
    body.axis_x, body.axis_y = turn(c, -s, ox, oy)
    body.axis_z = b1z * p.axis_x + b2z * p.axis_y + b3z * p.axis_z


@kernel
def turn(c, s, x, y):
    """A horizontal vector turned by the angle of cosine c and sine s."""
    return c * x - s * y, s * x + c * y


@kernel
def body_z(w, x, y, z):
    """b3 of a unit quaternion: the direction of thrust in the world."""
    return 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)


# ------------------------------------------------------------------------------------------------ every substep
@kernel
def attitude_control(flight, goal, omega, p):
    """Torque, N m, body frame, that turns the attitude into the goal and the body rate into omega (Lee: M)."""
    qw, qx, qy, qz = goal
    w, x, y, z = flight.qw, flight.qx, flight.qy, flight.qz
    ew = 2.0 * ((qw * w + qx * x) + (qy * y + qz * z))  # e = goal^-1 q, and 2 e_w (e_x, e_y, e_z) is Lee's
    ex = ew * ((qw * x - qx * w) - (qy * z - qz * y))  # e_R = 1/2 (R_d^T R - R^T R_d)
    ey = ew * ((qw * y - qy * w) - (qz * x - qx * z))
    ez = ew * ((qw * z - qz * w) - (qx * y - qy * x))
    wx, wy, wz = flight.wx, flight.wy, flight.wz
    gyro = p.inertia_z - p.inertia_xy
    mx = gyro * wy * wz - p.kq_tilt * ex - p.kw_tilt * (wx - omega[0])  # Lee: e_Omega, with R^T R_d taken as 1
    my = -gyro * wz * wx - p.kq_tilt * ey - p.kw_tilt * (wy - omega[1])
    mz = -p.kq_yaw * ez - p.kw_yaw * (wz - omega[2])
    return mx, my, mz


@kernel
def allocate(thrust, torque, p):
    """Rotor speeds for a thrust (N) and torques (N m, body frame).

    Where a rotor would leave its limits, the torque of yaw gives way first, then the thrust, then tilting.
    """
    unit, lever = 0.25 / p.thrust_gain, p.arm * _SQRT_HALF
    lift, yaw = thrust * unit, torque[2] * (unit / p.drag_ratio)
    roll, pitch = torque[0] * (unit / lever), torque[1] * (unit / lever)
    s0, s1, s2, s3 = mix(lift, roll, pitch, yaw)
    low, high = p.rotor_min * p.rotor_min, p.rotor_max * p.rotor_max
    if min(s0, s1, s2, s3) < low or max(s0, s1, s2, s3) > high:
        tilt = abs(roll) + abs(pitch)
        share = 0.5 * (high - low) / max(tilt, 0.5 * (high - low))
        roll, pitch, tilt = roll * share, pitch * share, tilt * share
        lift = min(max(lift, low + tilt), high - tilt)
        room = max(min(lift - low, high - lift) - tilt, 0.0)
        s0, s1, s2, s3 = mix(lift, roll, pitch, min(max(yaw, -room), room))
    return math.sqrt(s0), math.sqrt(s1), math.sqrt(s2), math.sqrt(s3)


@kernel
def mix(lift, roll, pitch, yaw):
    """Squared rotor speeds from what each rotor gives to thrust and torques."""
    return lift + roll - pitch + yaw, lift + roll + pitch - yaw, lift - roll + pitch + yaw, lift - roll - pitch - yaw


@kernel
def add_rotor_noise(command, noise, bits):
    """Rotor speeds with relative errors of standard deviation `noise`, uniform, 16 random bits each."""
    c0, c1, c2, c3 = command
    unit = noise * math.sqrt(12.0) / 65536.0
    c0 *= 1.0 + unit * (float(np.int64(bits & _LOW16)) - 32767.5)
    c1 *= 1.0 + unit * (float(np.int64(bits >> _S16 & _LOW16)) - 32767.5)
    c2 *= 1.0 + unit * (float(np.int64(bits >> _S32 & _LOW16)) - 32767.5)
    c3 *= 1.0 + unit * (float(np.int64(bits >> _S48)) - 32767.5)
    return c0, c1, c2, c3


@kernel
def step_rotors(flight, command, keep, p):
    """Let the rotors follow their commands; thrust (N) and torques (N m, body frame) at their mean speeds."""
    c0, c1, c2, c3 = command
    r0, r1, r2, r3 = flight.rotor0, flight.rotor1, flight.rotor2, flight.rotor3
    gain = 1.0 - keep
    n0, n1, n2, n3 = keep * r0 + gain * c0, keep * r1 + gain * c1, keep * r2 + gain * c2, keep * r3 + gain * c3
    flight.rotor0, flight.rotor1, flight.rotor2, flight.rotor3 = n0, n1, n2, n3
    unit, lever = 0.25 * p.thrust_gain, p.arm * _SQRT_HALF
    f0, f1, f2, f3 = unit * (r0 + n0) ** 2, unit * (r1 + n1) ** 2, unit * (r2 + n2) ** 2, unit * (r3 + n3) ** 2
    mx, my, mz = lever * (f0 + f1 - f2 - f3), lever * (f1 + f2 - f0 - f3), p.drag_ratio * (f0 - f1 + f2 - f3)
    return f0 + f1 + f2 + f3, mx, my, mz


@kernel
def integrate(flight, wrench, external, h, p):
    """Move the rigid body through a substep h (s) by the midpoint of its rates; displacement, m, world."""
    f, mx, my, mz = wrench
    wx, wy, wz = flight.wx, flight.wy, flight.wz
    gyro, k = p.inertia_z - p.inertia_xy, 0.5 * h
    side, top = h / p.inertia_xy, h / p.inertia_z
    hx = wx + 0.5 * side * (mx - gyro * wy * wz)  # body rate half-way
    hy = wy + 0.5 * side * (my + gyro * wz * wx)
    hz = wz + 0.5 * top * mz
    flight.wx = wx + side * (mx - gyro * hy * hz)  # Lee: J Omega' = M - Omega x J Omega
    flight.wy = wy + side * (my + gyro * hz * hx)
    flight.wz = wz + top * mz
    tx, ty, tz = k * hx, k * hy, k * hz
    c = 1.0 - 0.5 * (tx * tx + ty * ty + tz * tz)
    w, x, y, z = flight.qw, flight.qx, flight.qy, flight.qz
    nw = c * w - (tx * x + ty * y + tz * z)  # q <- q exp(h omega / 2), to second order
    nx = (c * x + tx * w) + (tz * y - ty * z)
    ny = (c * y + ty * w) + (tx * z - tz * x)
    nz = (c * z + tz * w) + (ty * x - tx * y)
    flight.qw, flight.qx, flight.qy, flight.qz = nw, nx, ny, nz
    ax, ay, az = body_z(w, x, y, z)
    bx, by, bz = body_z(nw, nx, ny, nz)
    lift = f * (0.5 / p.mass)  # along the mean of old and new b3
    ax, ay, az = lift * (ax + bx) + external[0], lift * (ay + by) + external[1], lift * (az + bz) + external[2]
    vx, vy, vz = flight.vx, flight.vy, flight.vz
    flight.vx, flight.vy, flight.vz = vx + h * ax, vy + h * ay, vz + h * az
    return h * (vx + k * ax), h * (vy + k * ay), h * (vz + k * az)
