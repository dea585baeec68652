"""Faults: which cameras, radios and robots work in a tick. Of a dead robot nothing works, and it is at rest."""

from __future__ import annotations

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.world.camera import BY_SIGHT

CAMERA, RADIO, ROBOT = range(3)  # settings.FAULTS


@kernel
def clear_faults(body):
    """Set camera, radio and robot to working."""
    body.alive = body.sees = body.talks = True


@kernel
def count_living(bodies):
    """How many robots are alive."""
    count = 0
    for i in range(bodies.shape[0]):
        count += bodies[i].alive
    return count


@kernel
def apply_faults(bodies, unicast, faults, now):
    """Set what works at the time `now`, s on the clock; messages in the air from or to a dead radio are dropped.

    faults (F,) FAULT; unicast (L, N, N).
    """
    for i in range(bodies.shape[0]):
        clear_faults(bodies[i])
    for k in range(faults.shape[0]):
        fault = faults[k]
        if not fault.at - 1e-9 <= now < fault.until - 1e-9:
            continue
        body = bodies[fault.robot]
        body.alive = body.alive and fault.kind != ROBOT
        body.sees = body.sees and fault.kind == RADIO
        body.talks = body.talks and fault.kind == CAMERA
        if not body.talks:
            for slot in range(unicast.shape[0]):
                for j in range(bodies.shape[0]):
                    unicast[slot, fault.robot, j].arrives = unicast[slot, j, fault.robot].arrives = False


@kernel
def mask_pairs(bodies, pairs, p):
    """Remove sight and links that dead cameras, radios or robots cannot have; called after `update_pairs`.

    `idle_ticks` still counts geometry alone: visiting an idle pair changes nothing.
    """
    n = bodies.shape[0]
    for i in range(n):
        a = bodies[i]
        for j in range(i + 1, n):
            b, ij, ji = bodies[j], pairs[i, j], pairs[j, i]
            before = ij.seen or ji.seen
            ij.seen = ij.seen and a.sees and b.alive
            ji.seen = ji.seen and b.sees and a.alive
            after = ij.seen or ji.seen
            ij.broken = ji.broken = before and not after
            ij.linked = ji.linked = (after if p.link == BY_SIGHT else ij.linked) and a.talks and b.talks
