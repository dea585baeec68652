"""Link weights (6)-(11) and their gradient (12), (13). Plain numbers, yaw frame of robot i.

`o_i` and `o_j` are the optical axes, both in i's yaw frame: without tilt o_i is the constant o_C of the paper and
o_j = iR_j o_C.
"""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import formula, kernel

UNION, PRODUCT, OMNI = range(3)  # scenarios.params.SWITCHES["weight"]
_WAVE = tuple((-1) ** k * math.pi ** (2 * k + 1) / (2 * math.factorial(2 * k + 1)) for k in range(10))


@kernel
def half_wave(x):
    """(1 - cos(pi x)) / 2 for x in [0, 1], to 3e-16: the Taylor series of (1 + sin(pi t)) / 2 about t = x - 1/2.

    The cosine of libm takes several times as long, and its last bit differs from machine to machine.
    """
    t = x - 0.5
    s = t * t
    s2 = s * s
    low = (_WAVE[0] + s * _WAVE[1]) + s2 * (_WAVE[2] + s * _WAVE[3])
    middle = (_WAVE[4] + s * _WAVE[5]) + s2 * (_WAVE[6] + s * _WAVE[7])
    return 0.5 + t * (low + s2 * s2 * (middle + s2 * s2 * (_WAVE[8] + s * _WAVE[9])))


@formula
def rise(x, low, high):
    """Rising activation w_1^0 (7): 0 up to `low`, 1 from `high`."""
    if x <= low:
        return 0.0
    if x >= high:
        return 1.0
    return half_wave((x - low) / (high - low))  # (7)


@kernel
def rise_slope(x, low, high):
    """Derivative of (7) with respect to x."""
    if x <= low or x >= high:
        return 0.0
    a = math.pi / (high - low)
    return 0.5 * a * math.sin(a * (x - low))


@kernel
def range_weight(distance, p):
    """gamma_ij (9): w_1^0 rises over d_min..D1, w_0^1 = 1 - w_1^0 falls over D2..d_max (8). distance in m."""
    return rise(distance, p.d_min, p.D1) * (1.0 - rise(distance, p.D2, p.d_max))  # (9)


@kernel
def range_slope(distance, p):
    """Derivative of gamma_ij (9) with respect to the distance, 1/m."""
    rising, falling = rise(distance, p.d_min, p.D1), 1.0 - rise(distance, p.D2, p.d_max)
    return rise_slope(distance, p.d_min, p.D1) * falling - rising * rise_slope(distance, p.D2, p.d_max)


@kernel
def sight_weight(cosine, p):
    """f*_ij (10) from a_ij, the cosine of the angle between optical axis and bearing."""
    return rise(cosine, p.a_min, p.a_max)  # (10)


@kernel
def view_weight(f_ij, f_ji, kind):
    """f_ij of a link from both directions: union (11), product ("both must look") or omnidirectional."""
    if kind == UNION:
        return f_ij + f_ji - f_ij * f_ji  # (11)
    if kind == PRODUCT:
        return f_ij * f_ji
    return 1.0


@kernel
def view_slope(f_ji, kind):
    """Derivative of `view_weight` with respect to its first argument."""
    if kind == UNION:
        return 1.0 - f_ji
    if kind == PRODUCT:
        return f_ji
    return 0.0


@kernel
def weight_gradient(bearing, distance, axis_i, axis_j, kind, p):
    """Gradient of A_ij with respect to robot i's motion: (R_i^T dA_ij/dp_i, dA_ij/dyaw_i), in 1/m and 1/rad.

    bearing of j and optical axes o_i, o_j: (x, y, z) each, unit, i's yaw frame. distance in m. Since
    b_ji = -(iR_j)^T b_ij, the paper's iR_j P_ji o_C equals P_ij o_j, and a_ji = -o_j . b_ij.
    """
    (bx, by, bz), (oix, oiy, oiz), (ojx, ojy, ojz) = bearing, axis_i, axis_j
    a_ij = oix * bx + oiy * by + oiz * bz
    a_ji = -(ojx * bx + ojy * by + ojz * bz)
    f_ij, f_ji = sight_weight(a_ij, p), sight_weight(a_ji, p)
    gamma = range_weight(distance, p)
    radial = -view_weight(f_ij, f_ji, kind) * range_slope(distance, p)  # first term of (12)
    turn_i = gamma * view_slope(f_ji, kind) * rise_slope(a_ij, p.a_min, p.a_max)
    turn_j = gamma * view_slope(f_ij, kind) * rise_slope(a_ji, p.a_min, p.a_max)
    # P_ij o = o - (o . b) b; note that o_j . b = -a_ji
    gx = radial * bx + (-turn_i * (oix - a_ij * bx) + turn_j * (ojx + a_ji * bx)) / distance  # (12)
    gy = radial * by + (-turn_i * (oiy - a_ij * by) + turn_j * (ojy + a_ji * by)) / distance
    gz = radial * bz + (-turn_i * (oiz - a_ij * bz) + turn_j * (ojz + a_ji * bz)) / distance
    g_yaw = -turn_i * (oiy * bx - oix * by)  # (13): o_C^T S b with S b = z x b
    return gx, gy, gz, g_yaw
