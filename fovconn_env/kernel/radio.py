"""Messages: written on board, carried by the environment, delivered some rounds later or lost."""

from __future__ import annotations

from fovconn_env.kernel import random
from fovconn_env.kernel.jit import kernel
from fovconn_env.layout import BYTES_PER_MESSAGE


@kernel
def exchange(mail, inboxes, p):
    """Deliver the messages that arrive in this round. mail: [sender, receiver], the slot written longest ago."""
    n = mail.shape[0]
    for i in range(n):
        for j in range(n):
            letter, box = mail[j, i], inboxes[i, j]
            box.fresh = letter.arrives
            if not letter.arrives:
                box.age = min(box.age + p.round_time, p.memory)
                continue
            box.age = 0.0
            box.seen, box.px, box.py, box.pz = letter.seen, letter.px, letter.py, letter.pz
            box.gamma, box.f = letter.gamma, letter.f
            box.cos_yaw, box.sin_yaw, box.yaw_valid = letter.cos_yaw, letter.sin_yaw, letter.yaw_valid
            box.vx, box.vy, box.vz, box.yaw_rate = letter.vx, letter.vy, letter.vz, letter.yaw_rate
            box.roll, box.pitch = letter.roll, letter.pitch
            box.x, box.degree = letter.x, letter.degree
            box.y1, box.y2, box.y3 = letter.y1, letter.y2, letter.y3
            box.q1, box.q2, box.q3 = letter.q1, letter.q2, letter.q3


@kernel
def speak(letter, own, track, belief):
    """Write robot i's message to j from what i has on board: its own motion, its record of j, its belief."""
    seen = 1.0 if track.held else 0.0
    letter.seen, letter.px, letter.py, letter.pz = seen, track.x * seen, track.y * seen, track.z * seen
    letter.gamma, letter.f = track.gamma, track.f
    letter.cos_yaw, letter.sin_yaw, letter.yaw_valid = track.cos_yaw, track.sin_yaw, 1.0 if track.valid else 0.0
    letter.vx, letter.vy, letter.vz, letter.yaw_rate = own.vx, own.vy, own.vz, own.yaw_rate
    letter.roll, letter.pitch = own.roll, own.pitch
    letter.x, letter.degree = belief.x, belief.degree
    letter.y1, letter.y2, letter.y3 = belief.y1, belief.y2, belief.y3
    letter.q1, letter.q2, letter.q3 = belief.q1, belief.q2, belief.q3


@kernel
def transmit(mail, pairs, infos, key, number, p):
    """Decide which messages of this round go on the air (linked pairs) and which of them get through; count bytes."""
    n = mail.shape[0]
    for i in range(n):
        for j in range(n):
            letter = mail[i, j]
            letter.sent = i != j and pairs[i, j].linked
            letter.arrives = letter.sent
            if not letter.sent:
                continue
            infos[i].bytes_sent += BYTES_PER_MESSAGE
            if p.loss > 0.0:
                letter.arrives = random.uniform(random.draw(key, number, i * n + j, random.LOSS)) >= p.loss
