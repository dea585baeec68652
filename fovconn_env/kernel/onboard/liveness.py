"""Liveness by flooded heartbeats: a robot notices a split of the team, because beats stop arriving.

A beat is the tick, counted from 1, in which a robot wrote it. Every robot holds the newest beat of each (N,), and sends
them with its first message of a tick, so that a beat travels one link a tick.
"""

from __future__ import annotations

from fovconn_env.kernel.jit import disjoint, kernel


@disjoint
def send_beats(sent, beats, i, tick):
    """Renew robot i's own beat, and copy all beats that it holds into its message."""
    beats[i] = tick
    for k in range(beats.shape[0]):
        sent[k] = beats[k]


@disjoint
def merge_beats(beats, received):
    """Keep the newer beat of each robot, held or received."""
    for k in range(beats.shape[0]):
        beats[k] = max(beats[k], received[k])


@kernel
def live_share(beats, now, p):
    """Share of the team, robot i included, whose newest beat is at most `liveness` seconds old in tick `now`."""
    alive = 0
    for k in range(beats.shape[0]):
        alive += (now - beats[k]) * p.tick <= p.liveness + 1e-9
    return alive / beats.shape[0]
