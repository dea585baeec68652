"""Faults: what of each robot works in a tick. A dead robot has neither camera nor radio, and rests where it is."""

from __future__ import annotations

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.world.camera import BY_SIGHT

CAMERA, RADIO, ROBOT = range(3)  # settings.FAULTS


@kernel
def repair(body):
    """All of a robot works."""
    body.alive = body.sees = body.talks = True


@kernel
def count_living(bodies):
    """How many robots are alive."""
    count = 0
    for i in range(bodies.shape[0]):
        count += bodies[i].alive
    return count


@kernel
def wear(bodies, mail, faults, now):
    """Bring up to date what works at the time `now`, s on the clock; what is on the air to or from dead radios is gone.

    faults (F,) FAULT; mail (L, N, N).
    """
    for i in range(bodies.shape[0]):
        repair(bodies[i])
    for k in range(faults.shape[0]):
        fault = faults[k]
        if not fault.at - 1e-9 <= now < fault.until - 1e-9:
            continue
        body = bodies[fault.robot]
        body.alive = body.alive and fault.kind != ROBOT
        body.sees = body.sees and fault.kind == RADIO
        body.talks = body.talks and fault.kind == CAMERA
        if not body.talks:
            for slot in range(mail.shape[0]):
                for j in range(bodies.shape[0]):
                    mail[slot, fault.robot, j].arrives = mail[slot, j, fault.robot].arrives = False


@kernel
def cut(bodies, pairs, p):
    """Take from the pairs, as `look` leaves them, what their cameras, radios and robots are too dead for.

    Whether a pair is asleep stays a matter of geometry: who visits one that has nothing to do changes nothing.
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
