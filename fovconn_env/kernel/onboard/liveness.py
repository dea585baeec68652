"""Who is still there: every robot passes on when it last had word of each, so that a split shows on board.

A beat is the tick, counted from 1, in which a robot said that it is there. Word of it goes from robot to robot, one
link a tick, with the first message of a tick.
"""

from __future__ import annotations

from fovconn_env.kernel.jit import kernel


@kernel
def send_beats(air, beats, i, tick):
    """Robot i is there; what it knows of all beats goes on the air."""
    beats[i] = tick
    for k in range(beats.shape[0]):
        air[k] = beats[k]


@kernel
def merge_beats(beats, heard):
    """Take over what is newer."""
    for k in range(beats.shape[0]):
        beats[k] = max(beats[k], heard[k])


@kernel
def live_share(beats, now, p):
    """Share of the team that robot i has had word of within `liveness`, itself included; nobody is missed earlier."""
    there = 0
    for k in range(beats.shape[0]):
        there += (now - beats[k]) * p.tick <= p.liveness + 1e-9
    return there / beats.shape[0]
