"""Messages, as robot i writes and reads them: a broadcast part, the same for all, and a unicast part for one receiver.

What a robot sends changes once a tick except for its state of the consensus, so the later messages of a tick repeat the
rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fovconn_env.kernel.jit import kernel


class Round(NamedTuple):
    """A message round, as all robots count it."""

    tick: int  # since the reset, from 1
    first: bool  # of its tick: beats and tables go out with its messages
    news: bool  # what arrives in it is the first that a sender wrote in a tick
    writes: bool  # unicast parts are written; else those of the last round still hold
    estimates: bool  # a round of the power iteration runs


class Outbox(NamedTuple):
    """What robot i sends in a round. Until it writes again, it holds what was sent `delay` rounds ago."""

    broadcast: np.record  # BROADCAST_RECORD
    unicast: np.ndarray  # (N,) UNICAST_RECORD: [receiver]
    beats: np.ndarray  # (N,) int64, see liveness.py
    table: np.ndarray  # (N, N + 1), see flooding.py; with another estimator its sizes are 0


class Message(NamedTuple):
    """What robot j sent to i; valid if `unicast.arrives`."""

    broadcast: np.record  # BROADCAST_RECORD
    unicast: np.record  # UNICAST_RECORD
    beats: np.ndarray  # (N,)
    table: np.ndarray  # (N, N + 1)


@kernel
def receive_message(broadcast, unicast, inbox, is_new, p):
    """Copy a message that arrives into robot i's inbox of its sender, or count that none came.

    is_new: it is the first of those that its sender wrote in a tick. Of the others only the part of the consensus is
    copied, because the rest repeats the first.
    """
    if not unicast.arrives:
        inbox.fresh = inbox.news = False
        inbox.age = min(inbox.age + p.round_time, p.memory)
        return
    inbox.news = is_new or not inbox.fresh
    inbox.fresh = True
    inbox.age = 0.0
    inbox.x, inbox.degree = broadcast.x, broadcast.degree
    inbox.y1, inbox.y2, inbox.y3 = broadcast.y1, broadcast.y2, broadcast.y3
    inbox.q1, inbox.q2, inbox.q3 = broadcast.q1, broadcast.q2, broadcast.q3
    if not inbox.news:
        return
    inbox.seen, inbox.px, inbox.py, inbox.pz = unicast.seen, unicast.px, unicast.py, unicast.pz
    inbox.gamma, inbox.f = unicast.gamma, unicast.f
    inbox.cos_yaw, inbox.sin_yaw, inbox.yaw_valid = unicast.cos_yaw, unicast.sin_yaw, unicast.yaw_valid
    inbox.vx, inbox.vy, inbox.vz, inbox.yaw_rate = broadcast.vx, broadcast.vy, broadcast.vz, broadcast.yaw_rate
    inbox.roll, inbox.pitch = broadcast.roll, broadcast.pitch


@kernel
def write_broadcast(broadcast, ego, belief):
    """Write the part of robot i's messages that is the same for all: its motion and its state of the consensus."""
    broadcast.vx, broadcast.vy, broadcast.vz, broadcast.yaw_rate = ego.vx, ego.vy, ego.vz, ego.yaw_rate
    broadcast.roll, broadcast.pitch = ego.roll, ego.pitch
    broadcast.x, broadcast.degree = belief.x, belief.degree
    broadcast.y1, broadcast.y2, broadcast.y3 = belief.y1, belief.y2, belief.y3
    broadcast.q1, broadcast.q2, broadcast.q3 = belief.q1, belief.q2, belief.q3


@kernel
def write_unicast(unicast, track):
    """Write the part of robot i's message that is for j alone: what i has on board about j."""
    # read first, then chosen: a branch would be foreseen no better than a coin toss
    held, x, y, z = track.held, track.x, track.y, track.z
    unicast.seen = held
    unicast.px, unicast.py, unicast.pz = x if held else 0.0, y if held else 0.0, z if held else 0.0
    unicast.gamma, unicast.f = track.gamma, track.f
    unicast.cos_yaw, unicast.sin_yaw, unicast.yaw_valid = track.cos_yaw, track.sin_yaw, track.valid
