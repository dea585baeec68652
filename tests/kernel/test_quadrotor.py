"""The quadrotor: its rigid body against a slow integration, its controller in closed loop, its noise and its frames."""

import math

import numpy as np
import pytest
from numba.core import config

from fovconn_env.kernel.jit import entry
from fovconn_env.kernel.maths.geometry import tilt
from fovconn_env.kernel.records import BODY, FLIGHT
from fovconn_env.kernel.world import quadrotor
from fovconn_env.scenarios.scenario import Scenario

pytestmark = pytest.mark.nojit

MODEL = {
    **dict(tick=0.01, mass=1.28, inertia_xy=0.0229, inertia_z=0.0221, arm=0.23, thrust_gain=6.5e-4, drag_ratio=0.0154),
    **dict(rotor_min=16.0, rotor_max=100.0, rotor_lag=0.02, substep=0.0025, kp=4.0, kv=5.0, kq_tilt=8.0, kq_yaw=0.3),
    **dict(kw_tilt=0.8, kw_yaw=0.2, max_accel=2.5, max_jerk=10.0, max_tilt=0.5, force_time=1.0, axis_x=1.0),
}
CALM, ROUGH = {}, {"rotor_noise": 0.01, "force_noise": 0.2}
SHAKEN = {"rotor_noise": 0.05, "rotor_lag": 0.05}
SEEN = "vx vy vz yaw_rate roll pitch axis_x axis_y axis_z".split()  # what the robot and its camera notice
DIRECTIONS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0.6, 0.8, 0), (0, 0, 1), (0, 0, -1), (0.64, -0.48, 0.6)]


def params(**changes):
    p = np.zeros_like(Scenario().params())
    for name, value in (MODEL | changes).items():
        p[0][name] = value
    return p


@entry
def rest(body, flight, p):
    quadrotor.reset_quadrotor(body[0], flight[0], p[0])


@entry
def follow(body, flight, p, key, commands, bodies, flights):
    for t in range(len(commands)):
        b, f = body[0], flight[0]
        b.command_vx, b.command_vy, b.command_vz, b.command_yaw_rate = commands[t]
        quadrotor.step_quadrotor(b, f, p[0], key, t, 3)
        bodies[t], flights[t] = body[0], flight[0]


@entry
def coast(flight, p, command, external, h, steps):
    """Rotors at a constant command, no controller; returns the displacement."""
    x = y = z = 0.0
    c = (command[0], command[1], command[2], command[3])
    for _ in range(steps):
        wrench = quadrotor.step_rotors(flight[0], c, math.exp(-h / p[0].rotor_lag), p[0])
        dx, dy, dz = quadrotor.integrate(flight[0], wrench, (external[0], external[1], external[2]), h, p[0])
        x, y, z = x + dx, y + dy, z + dz
    return x, y, z


@entry
def tumble(flight, p, h, steps):
    for _ in range(steps):
        quadrotor.integrate(flight[0], (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, -quadrotor.GRAVITY), h, p[0])


@entry
def given(flight, p, wrenches, commands, results):
    """commands, results (n, 4) <- rotor commands for each wrench (n, 4), and the wrench they give when reached."""
    for i in range(len(wrenches)):
        f, mx, my, mz = wrenches[i]
        c0, c1, c2, c3 = quadrotor.allocate(f, (mx, my, mz), p[0])
        commands[i] = c0, c1, c2, c3
        r = flight[0]
        r.rotor0, r.rotor1, r.rotor2, r.rotor3 = c0, c1, c2, c3
        results[i] = quadrotor.step_rotors(r, (c0, c1, c2, c3), 0.0, p[0])


@entry
def aimed(body, flight, force, jerk, q, omega):
    u, du = (force[0], force[1], force[2]), (jerk[0], jerk[1], jerk[2])
    q[:], omega[:] = quadrotor.desired_attitude(body[0], flight[0], u, du)


@entry
def shaped(body, flight, p, commands, found):
    """found (n, 6) <- velocity and acceleration reference after each command (n, 3)."""
    for t in range(len(commands)):
        b, f = body[0], flight[0]
        b.command_vx, b.command_vy, b.command_vz = commands[t]
        quadrotor.update_reference(b, f, p[0])
        quadrotor.propagate_reference(b, f, p[0])
        found[t] = f.rx, f.ry, f.rz, f.ax, f.ay, f.az


@entry
def steered(flight, p, goal, omega, torque):
    q = (goal[0], goal[1], goal[2], goal[3])
    torque[:] = quadrotor.attitude_control(flight[0], q, (omega[0], omega[1], omega[2]), p[0])


@entry
def disturbed(bits, noise, found):
    for i in range(len(bits)):
        found[i] = quadrotor.add_rotor_noise((1.0, 1.0, 1.0, 1.0), noise, bits[i])


@entry
def tilted(v, roll, pitch):
    return tilt(v[0], v[1], v[2], roll, pitch)


def start(p, pose=(0.0, 0.0, 0.0, 0.0)):
    body, flight = np.full(1, np.nan, BODY), np.full(1, np.nan, FLIGHT)
    body[0].x, body[0].y, body[0].z, body[0].yaw = pose
    rest(body, flight, p)
    return body, flight


def run(commands, pose=(0.0, 0.0, 0.0, 0.0), key=5, **changes):
    """Bodies and flights, (ticks,) each, of a robot that gets one command (vx, vy, vz, yaw rate) a tick."""
    p = params(**changes)
    body, flight = start(p, pose)
    bodies, flights = np.zeros(len(commands), BODY), np.zeros(len(commands), FLIGHT)
    follow(body, flight, p, np.uint64(key), np.asarray(commands, float), bodies, flights)
    return bodies, flights


def hold(command, seconds):
    return np.tile(np.asarray(command, float), (round(seconds / MODEL["tick"]), 1))


def flips(seconds, seed=0, every=0.3):
    """Velocities of 1.5 m/s in random directions with yaw rates in (-1, 1) rad/s, drawn anew every 0.3 s."""
    rng, ticks = np.random.default_rng(seed), round(every / MODEL["tick"])
    v = rng.normal(size=(math.ceil(seconds / every), 4))
    v[:, :3] *= 1.5 / np.linalg.norm(v[:, :3], axis=1, keepdims=True)
    v[:, 3] = rng.uniform(-1.0, 1.0, len(v))
    return np.repeat(v, ticks, axis=0)


def matrix(f):
    """R of a FLIGHT record or a quaternion (w, x, y, z)."""
    w, x, y, z = (f.qw, f.qx, f.qy, f.qz) if hasattr(f, "qw") else f
    q = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2.0 * w * q + 2.0 * q @ q


def euler(roll, pitch, yaw):
    """R = Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ ry @ rx


def tilt_of(bodies):
    return np.arccos(np.cos(bodies["roll"]) * np.cos(bodies["pitch"]))


# ------------------------------------------------------------------------------------------------- the rigid body
def slow_body(state, command, external, m, seconds, steps=2000):
    """Runge and Kutta's fourth order on x, v, R, omega, rotors (22 numbers); each force at its rotor, M = sum r x F."""
    lever = m["arm"] / math.sqrt(2.0)
    arms = lever * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    inertia = np.diag([m["inertia_xy"], m["inertia_xy"], m["inertia_z"]])

    def change(s):
        v, r, w, rotor = s[3:6], s[6:15].reshape(3, 3), s[15:18], s[18:22]
        force = m["thrust_gain"] * rotor**2
        torque = np.cross(arms, np.outer(force, [0, 0, 1])).sum(axis=0)
        torque[2] += m["drag_ratio"] * (force @ [1, -1, 1, -1])
        turning = r @ np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        dw = np.linalg.solve(inertia, torque - np.cross(w, inertia @ w))
        dv = r[:, 2] * force.sum() / m["mass"] + external
        return np.concatenate([v, dv, turning.ravel(), dw, (command - rotor) / m["rotor_lag"]])

    h = seconds / steps
    for _ in range(steps):
        k1 = change(state)
        k2 = change(state + 0.5 * h * k1)
        k3 = change(state + 0.5 * h * k2)
        k4 = change(state + h * k3)
        state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return state


def coasted(h, command, external, p, seconds):
    _, flight = start(p, (0.0, 0.0, 0.0, 0.4))
    f = flight[0]
    f.wx, f.wy, f.wz, f.vx, f.vy, f.vz = 0.8, -0.5, 0.6, 0.3, -0.2, 0.1
    before = np.concatenate([[0, 0, 0, f.vx, f.vy, f.vz], matrix(f).ravel(), [f.wx, f.wy, f.wz], [f.rotor0] * 4])
    moved = coast(flight, p, command, external, h, round(seconds / h))
    f = flight[0]
    rotors = [f.rotor0, f.rotor1, f.rotor2, f.rotor3]
    after = np.concatenate([moved, [f.vx, f.vy, f.vz], matrix(f).ravel(), [f.wx, f.wy, f.wz], rotors])
    return before, after


def test_open_loop_agrees_with_a_slow_integration_and_converges_with_the_square_of_the_substep():
    changes = {"inertia_z": 0.04}  # so that Omega x J Omega matters
    p, seconds = params(**changes), 0.3
    command, external = np.array([72.0, 69.0, 71.0, 66.0]), np.array([0.2, -0.1, -9.81])
    errors = []
    for h in (0.005, 0.0025, 0.00125):
        before, after = coasted(h, command, external, p, seconds)
        errors.append(np.abs(after - slow_body(before, command, external, MODEL | changes, seconds, 300)).max())
    assert errors[1] < 2e-3  # rotor units, m, m/s, rad/s: the largest of all
    assert errors[0] / errors[2] > 12.0  # 16 for the second order, 4 for the first


def test_free_fall_keeps_energy_momentum_and_angular_momentum():
    p = params()
    _, flight = start(p)
    f = flight[0]
    f.wx, f.wy, f.wz, f.vx = 2.0, -1.0, 1.5, 0.7
    inertia = np.diag([MODEL["inertia_xy"], MODEL["inertia_xy"], MODEL["inertia_z"]])
    w = np.array([f.wx, f.wy, f.wz])
    momentum, energy = matrix(f) @ inertia @ w, w @ inertia @ w
    tumble(flight, p, MODEL["substep"], 400)
    f = flight[0]
    w = np.array([f.wx, f.wy, f.wz])
    np.testing.assert_allclose([f.vx, f.vy, f.vz], [0.7, 0.0, -quadrotor.GRAVITY], atol=1e-12)
    np.testing.assert_allclose(w @ inertia @ w, energy, rtol=1e-4)
    np.testing.assert_allclose(matrix(f) @ inertia @ w, momentum, rtol=0.0, atol=2e-3 * np.linalg.norm(momentum))


# ------------------------------------------------------------------------------------------------- the controller
def test_allocation_gives_what_is_asked_within_the_limits_and_gives_up_yaw_first():
    p = params()
    _, flight = start(p)
    rng = np.random.default_rng(1)
    wrenches = rng.normal(size=(2000, 4)) * [8.0, 0.8, 0.8, 0.1] + [12.0, 0.0, 0.0, 0.0]
    commands, results = np.full((2000, 4), np.nan), np.full((2000, 4), np.nan)
    given(flight, p, wrenches, commands, results)
    assert commands.min() >= MODEL["rotor_min"] * (1.0 - 1e-12)
    assert commands.max() <= MODEL["rotor_max"] * (1.0 + 1e-12)
    error = np.abs(results - wrenches) > 1e-9
    inside = (commands > MODEL["rotor_min"] + 1e-6).all(axis=1) & (commands < MODEL["rotor_max"] - 1e-6).all(axis=1)
    assert inside.sum() > 100
    assert not error[inside, :3].any()
    thrust_given_up = error[:, 0] & ~error[:, 1:3].any(axis=1)
    assert np.abs(results[thrust_given_up, 3]).max() < 1e-9  # no yaw left before thrust yields
    tilt_given_up = error[:, 1:3].any(axis=1)
    middle = 2.0 * MODEL["thrust_gain"] * (MODEL["rotor_min"] ** 2 + MODEL["rotor_max"] ** 2)
    np.testing.assert_allclose(results[tilt_given_up, 0], middle)  # thrust has made all the room there is
    assert (results[:, 3] * wrenches[:, 3] >= -1e-9).all()
    assert tilt_given_up.any()
    assert thrust_given_up.any()
    assert (error[:, 3] & ~error[:, :3].any(axis=1)).any()


def test_aim_points_thrust_along_the_force_keeps_the_heading_and_turns_at_its_own_rate():
    body, flight = start(params(), (0.0, 0.0, 0.0, 2.0))
    force, jerk, w_yaw, dt = np.array([1.5, -2.0, 10.5]), np.array([3.0, 2.0, -4.0]), 0.7, 1e-5
    body[0].command_yaw_rate = w_yaw
    q, omega, unused = np.zeros(4), np.zeros(3), np.zeros(3)
    attitudes = []
    for t in (-dt, 0.0, dt):
        flight[0].yaw_reference = 0.3 + t * w_yaw
        aimed(body, flight, force + t * jerk, jerk, q, omega if t == 0.0 else unused)
        attitudes.append(matrix(q))
    before, now, after = attitudes
    np.testing.assert_allclose(now[:, 2], force / np.linalg.norm(force), atol=1e-12)
    np.testing.assert_allclose(math.atan2(now[1, 0], now[0, 0]), 2.3, atol=1e-12)
    skew = now.T @ (after - before) / (2.0 * dt)
    np.testing.assert_allclose(omega, [skew[2, 1], skew[0, 2], skew[1, 0]], atol=1e-8)


def test_torque_is_that_of_lee():
    p = params(inertia_z=0.03)
    _, flight = start(p)
    rng = np.random.default_rng(2)
    q, goal = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 4)))
    w, omega, torque = *rng.normal(size=(2, 3)), np.zeros(3)
    f = flight[0]
    f.qw, f.qx, f.qy, f.qz = q
    f.wx, f.wy, f.wz = w
    steered(flight, p, goal, omega, torque)
    e = 0.5 * (matrix(goal).T @ matrix(q) - matrix(q).T @ matrix(goal))
    e_r, inertia = np.array([e[2, 1], e[0, 2], e[1, 0]]), np.array([0.0229, 0.0229, 0.03])
    expected = -np.array([8.0, 8.0, 0.3]) * e_r - np.array([0.8, 0.8, 0.2]) * (w - omega) + np.cross(w, inertia * w)
    np.testing.assert_allclose(torque, expected, atol=1e-12)


def test_hover_stays_put():
    pose = (3.0, -2.0, 5.0, 2.5)
    body, flight = start(params(), pose)
    assert not np.isnan(list(flight[0])).any()
    assert not any(np.isnan(body[0][name]) for name in [*SEEN, "cos_yaw", "sin_yaw"])
    bodies, flights = run(hold((0, 0, 0, 0), 5.0), pose)
    for name, value in zip(("x", "y", "z", "yaw"), pose, strict=True):
        np.testing.assert_allclose(bodies[name], value, atol=1e-9)
    for name in "vx vy vz yaw_rate roll pitch".split():
        np.testing.assert_allclose(bodies[name], 0.0, atol=1e-9)
    np.testing.assert_allclose(flights["rotor0"], math.sqrt(1.28 * 9.81 / 4.0 / 6.5e-4), atol=1e-6)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_step_of_1_m_s_is_quick_and_hardly_tilts(direction):
    bodies, _ = run(hold((*direction, 0), 3.0), (0.0, 0.0, 0.0, 1.0))
    v = np.column_stack([bodies["vx"], bodies["vy"], bodies["vz"]]) @ direction
    assert np.argmax(v >= 0.9) * MODEL["tick"] < 0.6
    assert v.max() < 1.15
    assert np.degrees(tilt_of(bodies).max()) < 20.0
    np.testing.assert_allclose(v[-100:], 1.0, atol=0.01)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_step_settles_with_slow_and_noisy_rotors(direction):
    bodies, _ = run(hold((*direction, 0), 5.0), **SHAKEN)
    error = np.column_stack([bodies["vx"], bodies["vy"], bodies["vz"]])[-200:] - direction
    assert math.sqrt((error**2).sum(axis=1).mean()) < 0.1
    assert np.degrees(tilt_of(bodies).max()) < 25.0


def planar(seconds, m, speed=1.0, force=0.0, h=2.5e-4):
    """Place, speed and pitch, (ticks,) each, of a step of `speed` (1 or 0 m/s) under a force (N), from Lee's equations.

    The loop in a vertical plane: the reference is the trapezoid of acceleration that the limits allow, held for a tick
    at its value at the tick's end; thrust and torque lag, height is not controlled; explicit Euler in steps of h.
    """
    ramp, hold = m["max_accel"] / m["max_jerk"], 1.0 / m["max_accel"] - m["max_accel"] / m["max_jerk"]
    knots, top = np.array([0.0, ramp, ramp + hold, 2.0 * ramp + hold]), speed * m["max_accel"]
    gap = r = x = v = pitch = rate = torque = 0.0  # gap: position reference minus position
    lift, found, n = 9.81, [], round(m["tick"] / h)
    for k in range(round(seconds / h)):
        now = m["tick"] * (k // n)
        before, a = np.interp([now, now + m["tick"]], knots, [0.0, top, top, 0.0])
        jerk = (a - before) / m["tick"]
        u = m["kp"] * gap + m["kv"] * (r - v) + a
        goal, omega = math.atan2(u, 9.81), jerk * 9.81 / (u * u + 9.81**2)
        asked = -m["kq_tilt"] * math.sin(pitch - goal) - m["kw_tilt"] * (rate - omega)
        torque += h * (asked - torque) / m["rotor_lag"]
        lift += h * (u * math.sin(pitch) + 9.81 * math.cos(pitch) - lift) / m["rotor_lag"]
        pitch, rate = pitch + h * rate, rate + h * torque / m["inertia_xy"]
        gap, r, x = gap + h * (r - v), r + h * a, x + h * v
        v += h * (lift * math.sin(pitch) + force / m["mass"])
        if (k + 1) % n == 0:
            found.append((x, v, pitch))
    return np.array(found).T


@pytest.mark.parametrize("changes", [{}, {"rotor_lag": 0.04}, {"max_accel": 2.0}], ids=str)
def test_step_of_1_m_s_is_that_of_a_planar_model(changes):
    bodies, _ = run(hold((1, 0, 0, 0), 2.0), **changes)
    x, speed, pitch = planar(2.0, MODEL | changes)
    np.testing.assert_allclose(bodies["x"], x, atol=0.002)
    np.testing.assert_allclose(bodies["vx"], speed, atol=0.005)
    np.testing.assert_allclose(np.degrees(bodies["pitch"]), np.degrees(pitch), atol=0.3)


def test_a_constant_force_moves_it_as_it_moves_a_planar_model():
    p = params()
    body, flight = start(p)
    flight[0].fx = 1.0  # N; without force_noise it stays
    commands = hold((0, 0, 0, 0), 6.0)
    bodies, flights = np.zeros(len(commands), BODY), np.zeros(len(commands), FLIGHT)
    follow(body, flight, p, np.uint64(5), commands, bodies, flights)
    x, _, pitch = planar(6.0, MODEL, speed=0.0, force=1.0)
    np.testing.assert_allclose(bodies["x"], x, atol=0.002)
    np.testing.assert_allclose(np.degrees(bodies["pitch"]), np.degrees(pitch), atol=0.1)
    assert abs(bodies["x"][-1] * MODEL["mass"] * MODEL["kp"] - 1.0) < 0.01  # it ends at F / (m kp)


def test_yaw_rate_step_is_tracked():
    bodies, flights = run(hold((0.5, 0, 0, 1.0), 6.0))
    w = bodies["yaw_rate"]
    assert np.argmax(w >= 0.9) * MODEL["tick"] < 0.3
    assert w.max() < 1.2
    np.testing.assert_allclose(w[-100:], 1.0, atol=0.01)
    assert np.abs(flights["yaw_reference"]).max() < 0.2


def test_reference_keeps_its_limits_and_arrives_without_overshoot():
    p = params(max_accel=2.2)
    body, flight = start(p)
    commands, found = np.concatenate([hold((1.5, 0, 0), 1.5), hold((-0.9, 1.2, 0), 2.0)]), np.full((350, 6), np.nan)
    shaped(body, flight, p, commands, found)
    r, a = found[:, :3], found[:, 3:]
    assert np.linalg.norm(a, axis=1).max() <= 2.2 + 1e-9
    assert np.linalg.norm(np.diff(a, axis=0), axis=1).max() / MODEL["tick"] <= 10.0 + 1e-9
    assert np.linalg.norm(r, axis=1).max() <= 1.5 + 5e-3
    least = 1.5 / 2.2 + 2.2 / 10.0  # s, of a velocity change that reaches max_accel
    assert np.argmax(r[:, 0] > 1.5 - 5e-3) * MODEL["tick"] <= least
    np.testing.assert_allclose(r[149], [1.5, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(r[-1], [-0.9, 1.2, 0.0], atol=1e-9)


@pytest.mark.parametrize("noise", [ROUGH, SHAKEN | ROUGH], ids=["rough", "slow rotors"])
def test_aggressive_commands_leave_it_upright(noise):
    bodies, flights = run(flips(6.0 if config.DISABLE_JIT else 60.0), **noise)
    assert np.degrees(tilt_of(bodies).max()) < 30.0
    assert max(np.abs(flights[name]).max() for name in ("ex", "ey", "ez")) < 0.3  # m
    assert np.sqrt(bodies["vx"] ** 2 + bodies["vy"] ** 2 + bodies["vz"] ** 2).max() < 1.8


def test_halving_the_substep_changes_little():
    coarse, fine = (run(flips(5.0, every=0.5), substep=s)[0] for s in (0.0025, 0.00125))
    for name in ("vx", "vy", "vz"):
        np.testing.assert_allclose(coarse[name], fine[name], atol=0.005)
    for name in ("x", "y", "z", "yaw", "roll", "pitch"):
        np.testing.assert_allclose(coarse[name], fine[name], atol=0.01)


# ------------------------------------------------------------------------------------------- outputs and their frames
def test_outputs_agree_with_the_attitude_and_the_track():
    bodies, flights = run(flips(4.0), (1.0, 2.0, 3.0, 3.0), axis_x=0.8, axis_y=0.36, axis_z=-0.48)
    assert np.abs(bodies["yaw"]).max() <= math.pi
    for t in range(0, len(bodies), 20):
        b = bodies[t]
        np.testing.assert_allclose(euler(b.roll, b.pitch, b.yaw), matrix(flights[t]), atol=1e-12)
        np.testing.assert_allclose([b.cos_yaw, b.sin_yaw], [math.cos(b.yaw), math.sin(b.yaw)], atol=1e-12)
        axis = np.array([0.8, 0.36, -0.48])
        np.testing.assert_allclose([b.axis_x, b.axis_y, b.axis_z], tilted(axis, b.roll, b.pitch), atol=1e-12)
        north = b.cos_yaw * b.vx - b.sin_yaw * b.vy, b.sin_yaw * b.vx + b.cos_yaw * b.vy, b.vz
        np.testing.assert_allclose(north, [flights[t].vx, flights[t].vy, flights[t].vz], atol=1e-12)
    dt = MODEL["tick"]
    for place, speed in (("x", "vx"), ("y", "vy"), ("z", "vz")):
        slope = (bodies[place][2:] - bodies[place][:-2]) / (2.0 * dt)
        np.testing.assert_allclose(slope, flights[speed][1:-1], atol=2e-3)
    slope = np.diff(np.unwrap(bodies["yaw"]))
    slope = (slope[1:] + slope[:-1]) / (2.0 * dt)
    np.testing.assert_allclose(slope, bodies["yaw_rate"][1:-1], atol=0.02)


def test_turning_and_shifting_the_world_changes_nothing_on_board():
    commands = flips(6.0)
    here, _ = run(commands, (0.0, 0.0, 0.0, 0.0), **ROUGH)
    there, _ = run(commands, (1000.0, -700.0, 300.0, 2.9), **ROUGH)
    for name in SEEN:
        np.testing.assert_allclose(there[name], here[name], rtol=0.0, atol=1e-8)


def test_flight_depends_on_the_key_alone():
    commands = flips(1.0)
    first, again, other = (run(commands, key=key, **ROUGH)[0] for key in (5, 5, 6))
    assert first.tobytes() == again.tobytes()
    assert np.abs(first["vx"] - other["vx"]).max() > 1e-4


# ------------------------------------------------------------------------------------------------------- the noise
def test_rotor_noise_is_uniform_and_independent_between_rotors():
    bits = np.random.default_rng(3).integers(0, 2**64, 20000, np.uint64)
    found = np.full((len(bits), 4), np.nan)
    disturbed(bits, 0.01, found)
    error = found - 1.0
    np.testing.assert_allclose(error.std(axis=0), 0.01, rtol=0.02)
    np.testing.assert_allclose(error.mean(axis=0), 0.0, atol=3e-4)
    assert np.abs(error).max() <= 0.01 * math.sqrt(3.0)
    assert np.abs(np.corrcoef(error.T) - np.eye(4)).max() < 0.03
