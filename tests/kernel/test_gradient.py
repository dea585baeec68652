"""The gradients (12), (13) and that of V against finite differences of the weights and of V(lambda2(poses)).

Poses near a kink are left out: no distance or cosine within `KINK` of a border of an activation (7), (8), where the
second derivative jumps. So are teams whose lambda2 and lambda3 nearly meet (`GAP`): there lambda2 has no gradient.
The differences are central, of fourth order: with steps of 2e-4 their error is about 1e-12.
"""

import numpy as np
import pytest

from fovconn_env import layout
from fovconn_env.baselines.laws import expert
from fovconn_env.baselines.laws.expert import Expert, Gains
from fovconn_env.kernel.jit import entry
from fovconn_env.kernel.maths import weights
from tests import reference as ref
from tests.helpers import KINDS, draw_team, few, small

pytestmark = pytest.mark.nojit

STEP, KINK, GAP = 2e-4, 1e-3, 0.02
TILTS = [0.0, 0.3]


@entry
def gradient(b, d, o_i, o_j, p, out):
    out[0], out[1], out[2], out[3] = weights.weight_gradient(
        (b[0], b[1], b[2]), d, (o_i[0], o_i[1], o_i[2]), (o_j[0], o_j[1], o_j[2]), p[0].weight, p[0]
    )


@entry
def descend(own, neighbors, params, gains, out):
    for i in range(len(own)):
        out[i] = expert.connectivity_action(own[i], neighbors[i], params[0], gains[0])


def moved(pose, k, step):
    """The pose a step along column k of the robot's own velocity: x, y, z in its yaw frame (1), or yaw."""
    if k == 3:
        return pose._replace(yaw=pose.yaw + step)
    return pose._replace(p=pose.p + step * ref.Rz(pose.yaw)[:, k])


def difference(function, team, i, k):
    """Derivative of function(team) with respect to column k of robot i's motion, central, of fourth order."""

    def at(step):
        return function([moved(pose, k, step) if j == i else pose for j, pose in enumerate(team)])

    return (8 * (at(STEP) - at(-STEP)) - (at(2 * STEP) - at(-2 * STEP))) / (12 * STEP)


def smooth_here(team, camera):
    """No pair is near a kink of its weight."""
    for i, a in enumerate(team):
        for j, b in enumerate(team):
            if i == j:
                continue
            d, cosine = np.linalg.norm(b.p - a.p), ref.cosine(a, b, camera)
            kinks = [d - border for border in (camera.d_min, camera.D1, camera.D2, camera.d_max)]
            kinks += [cosine - border for border in (camera.a_min, camera.a_max)]
            if np.abs(kinks).min() < KINK:
                return False
    return True


def axes(team, i, j, camera):
    """o_i and o_j in i's yaw frame."""
    o_i, o_j = (ref.tilt(pose.roll, pose.pitch) @ ref.axis(camera) for pose in (team[i], team[j]))
    return o_i, ref.Rz(team[j].yaw - team[i].yaw) @ o_j


@pytest.mark.parametrize("tilt", TILTS)
@pytest.mark.parametrize("kind", KINDS)
def test_gradient_of_a_weight(kind, tilt):
    scenario, rng = small(weight=kind), np.random.default_rng(21)
    params, worst, checked = scenario.params(), 0.0, 0
    while checked < few(150, 40):
        team = draw_team(rng, 2, box=(12, 12, 6), tilt=tilt)
        linked = ref.weight(*team, scenario.camera, kind) > 1e-3
        if not linked or not smooth_here(team, scenario.camera):
            continue
        p_ij = ref.relative(*team)
        d, got = np.linalg.norm(p_ij), np.full(4, np.nan)
        gradient(p_ij / d, d, *axes(team, 0, 1, scenario.camera), params, got)
        wanted = [difference(lambda t: ref.weight(*t, scenario.camera, kind), team, 0, k) for k in range(4)]
        if np.linalg.norm(wanted) < 1e-3:
            continue
        checked += 1
        worst = max(worst, np.linalg.norm(got - wanted) / np.linalg.norm(wanted))
    print(f"worst relative error {worst:.1e}")  # pytest -rP shows it
    assert worst < 1e-6


def rows(team, scenario, lambda2, v2):
    """What the robots of a team would observe with exact lambda2, v2 and relative yaw, in float64: SELF, NEIGHBOR."""
    n, camera = len(team), scenario.camera
    own = np.zeros(n, layout.record(layout.SELF, "f8"))
    neighbors = np.zeros((n, n - 1), layout.record(layout.NEIGHBOR, "f8"))
    own["lambda2_hat"], own["v2_hat"] = lambda2, v2
    for i, me in enumerate(team):
        own[i].roll, own[i].pitch = me.roll, me.pitch
        for row, j in zip(neighbors[i], [j for j in range(n) if j != i], strict=True):
            if not (ref.watches(me, team[j], camera) or ref.watches(team[j], me, camera)):
                continue
            p_ij, yaw = ref.relative(me, team[j]), team[j].yaw - me.yaw
            row.distance = np.linalg.norm(p_ij)
            row.bearing_x, row.bearing_y, row.bearing_z = p_ij / row.distance
            row.present, row.yaw_valid, row.v2_hat = 1.0, 1.0, v2[j]
            row.cos_yaw, row.sin_yaw, row.roll, row.pitch = np.cos(yaw), np.sin(yaw), team[j].roll, team[j].pitch
            row.f_ij = ref.f_star(ref.cosine(me, team[j], camera), camera)
            row.f_ji = ref.f_star(ref.cosine(team[j], me, camera), camera)
    return own, neighbors


@pytest.mark.parametrize("tilt", TILTS)
@pytest.mark.parametrize("kind", KINDS)
def test_gradient_of_V(kind, tilt):
    """What the expert descends (3), (5), all robots together, against V(lambda2) of moved poses."""
    scenario, gains, rng = small(weight=kind, n_agents=5), Gains(), np.random.default_rng(22)
    policy, worst, checked = Expert(scenario), 0.0, 0

    def cost(team):
        return ref.V(ref.lambda2_v2(ref.weights(team, scenario.camera, kind))[0], scenario, gains)

    while checked < few(6, 3):
        team = draw_team(rng, 5, box=(6, 6, 3), tilt=tilt)
        A = ref.weights(team, scenario.camera, kind)
        (lambda2, v2), values = ref.lambda2_v2(A), np.linalg.eigvalsh(ref.laplacian(A))
        inside = scenario.lambda2_min + gains.clamp + KINK < lambda2 < scenario.lambda2_max - KINK
        if not inside or values[2] - values[1] < GAP or not smooth_here(team, scenario.camera):
            continue
        wanted = np.array([[difference(cost, team, i, k) for k in range(4)] for i in range(5)])
        if np.linalg.norm(wanted) < 1e-3:
            continue
        checked += 1
        velocity = np.full((5, 4), np.nan)
        descend(*rows(team, scenario, lambda2, v2), policy._params, policy._gains, velocity)
        worst = max(worst, np.linalg.norm(-velocity - wanted) / np.linalg.norm(wanted))
    print(f"worst relative error {worst:.1e}")  # pytest -rP shows it
    assert worst < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_both_ends_of_a_link_push_alike(kind):
    """What i's motion changes of A_ij, j's motion the other way changes too: the two gradients are opposite."""
    scenario, rng, checked = small(weight=kind), np.random.default_rng(23), 0
    params = scenario.params()
    while checked < few(200, 40):
        team = draw_team(rng, 2, box=(10, 10, 5), tilt=0.3)
        if ref.weight(*team, scenario.camera, kind) == 0.0:
            continue
        checked += 1
        out = np.full((2, 4), np.nan)
        for i in (0, 1):
            p_ij = ref.relative(team[i], team[1 - i])
            d = np.linalg.norm(p_ij)
            gradient(p_ij / d, d, *axes(team, i, 1 - i, scenario.camera), params, out[i])
        push = [ref.Rz(pose.yaw) @ g[:3] for pose, g in zip(team, out, strict=True)]
        np.testing.assert_allclose(push[0], -push[1], rtol=0, atol=1e-12)
