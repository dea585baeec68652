"""Messages: written on board, carried by the environment, delivered some rounds later or lost.

A message has two parts: a POST, the same for all, and a note for one receiver (MAIL). What a robot says changes once a
tick except for its part in the consensus, so the later messages of a tick repeat the rest.
"""

from __future__ import annotations

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths import random


@kernel
def receive(post, letter, box, first, p):
    """Deliver one message, or note that none came. first: of those its sender wrote in one tick.

    A message that repeats the one before it is not copied again, but for the consensus.
    """
    if not letter.arrives:
        box.fresh = box.news = False
        box.age = min(box.age + p.round_time, p.memory)
        return
    box.news = first or not box.fresh
    box.fresh = True
    box.age = 0.0
    box.x, box.degree = post.x, post.degree
    box.y1, box.y2, box.y3 = post.y1, post.y2, post.y3
    box.q1, box.q2, box.q3 = post.q1, post.q2, post.q3
    if not box.news:
        return
    box.seen, box.px, box.py, box.pz = letter.seen, letter.px, letter.py, letter.pz
    box.gamma, box.f = letter.gamma, letter.f
    box.cos_yaw, box.sin_yaw, box.yaw_valid = letter.cos_yaw, letter.sin_yaw, letter.yaw_valid
    box.vx, box.vy, box.vz, box.yaw_rate = post.vx, post.vy, post.vz, post.yaw_rate
    box.roll, box.pitch = post.roll, post.pitch


@kernel
def announce(post, own, belief):
    """Write the part of robot i's messages that is the same for all: its motion and its part in the consensus."""
    post.vx, post.vy, post.vz, post.yaw_rate = own.vx, own.vy, own.vz, own.yaw_rate
    post.roll, post.pitch = own.roll, own.pitch
    post.x, post.degree = belief.x, belief.degree
    post.y1, post.y2, post.y3 = belief.y1, belief.y2, belief.y3
    post.q1, post.q2, post.q3 = belief.q1, belief.q2, belief.q3


@kernel
def address(letter, track):
    """Write robot i's note to j: what i has on board about j."""
    letter.seen, letter.px, letter.py, letter.pz = track.held, 0.0, 0.0, 0.0
    if track.held:
        letter.px, letter.py, letter.pz = track.x, track.y, track.z
    letter.gamma, letter.f = track.gamma, track.f
    letter.cos_yaw, letter.sin_yaw, letter.yaw_valid = track.cos_yaw, track.sin_yaw, track.valid


@kernel
def transmit(letter, pair, index, key, number, p):
    """Decide whether a message goes on the air (linked pairs) and whether it gets through."""
    letter.sent = letter.arrives = pair.linked
    if letter.sent and p.loss > 0.0:
        letter.arrives = random.uniform(random.draw(key, number, index, random.LOSS)) >= p.loss
