"""What a robot consists of: nine functions, each on its own slices of the arrays.

    start                      once an episode: nothing is heard or seen yet
    sense, see                 every tick: own motion <- odometry, IMU; the track of a contact <- camera
    look                       between them, unless the camera is ideal: who is seen, and what has no name <- frames
    receive                    every message round, for each contact: inbox, beats, table <- its message
    send, send_note            every message round: messages <- what is on board; the part for one contact
    estimate_yaw               every tick, after its rounds, for each contact: relative yaw <- sight, odometry, inbox
    observe                    every step: observation <- what is on board

`kernel.step` calls them for each robot of a world, and for each contact in one loop over all robots; a robot that is a
process of its own calls the same for itself. No function takes a pose, the truth about a pair, the episode or its noise
key. Before `sense` the first six fields of `ego` and the `sights` hold what the sensors measured, before `observe` the
range rows do. Times are counts that all robots share: `tick` from 1, since the reset.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fovconn_env.kernel.jit import stage
from fovconn_env.kernel.onboard import relative_yaw
from fovconn_env.kernel.onboard.detections import (
    carry_blobs,
    carry_report,
    match_blobs,
    name_blobs,
    store_motion,
    write_detections,
)
from fovconn_env.kernel.onboard.flooding import build_laplacian, copy_table, merge_table, solve_table, write_own_row
from fovconn_env.kernel.onboard.liveness import live_share, merge_beats, send_beats
from fovconn_env.kernel.onboard.messages import receive_message, write_broadcast, write_unicast
from fovconn_env.kernel.onboard.observation import clip, sort_present, write_neighbors, write_self
from fovconn_env.kernel.onboard.power_iteration import (
    FLOODING,
    POWER,
    agree_weight,
    init_estimate,
    power_round,
    read_estimate,
)


class Robot(NamedTuple):
    """What robot i has on board. N robots; index j is another robot's number."""

    index: int  # i
    ego: np.record  # EGO
    peers: np.ndarray  # (N,) PEER
    belief: np.record  # BELIEF
    beats: np.ndarray  # (N,) int64, see liveness.py
    table: np.ndarray  # (N, N + 1), see flooding.py; with another estimator its sizes are 0
    mode: np.ndarray  # (N,) eigenvector v2 of the table
    flat: np.ndarray  # (D,) float32, the observation; the two below are views into it
    own_row: np.record  # SELF
    neighbor_rows: np.ndarray  # (M,) NEIGHBOR
    # of a camera that is not ideal; of another their sizes are 0
    motions: np.ndarray  # (L,) MOTION, own motion of the last ticks
    blobs: np.ndarray  # (S,) BLOB, what the camera follows
    detection_rows: np.ndarray  # (Q,) DETECTION


@stage
def start(me, x, p):
    """Empty what is on board; x in (-1, 1): the robot's start draw, its first entry of the eigenvector."""
    if p.lambda2 == POWER:
        init_estimate(me.belief, x)
    for j in range(me.peers.shape[0]):
        peer = me.peers[j]
        peer.inbox.age = p.memory
        peer.track.cos_yaw = peer.track.cos_used = 1.0


@stage
def sense(me, p):
    """Take in a tick's own motion."""
    relative_yaw.dead_reckon(me.ego, p)


@stage
def look(me, report, contacts, tick, p):
    """Take in a tick's report of the camera, (N,) SIGHT of a frame some ticks ago: sights, and what has no name.

    Places are those at the time of the frame. `report` is used up. tick: from 0.
    """
    store_motion(me.motions[tick % me.motions.shape[0]], me.ego, p)
    carry_report(report, me.index, contacts, me.motions, tick)
    carry_blobs(me.blobs, me.ego, p)
    for j in contacts:
        sight, seen = me.peers[j].sight, report[j]
        sight.seen = p.identify == 0.0 and seen.seen
        if sight.seen:
            sight.x, sight.y, sight.z = seen.x, seen.y, seen.z
            seen.seen = False
    match_blobs(me.blobs, report, me.index, contacts, p)
    if p.identify > 0.0:
        name_blobs(me.blobs, me.index, p)
        for blob in me.blobs:
            if blob.matched and blob.name >= 0:
                sight = me.peers[blob.name].sight
                sight.seen, sight.x, sight.y, sight.z = True, blob.x, blob.y, blob.z


@stage
def see(me, j, p):
    """Take in a tick's sight of robot j, or that there is none, after `sense`."""
    peer = me.peers[j]
    relative_yaw.update_track(peer.track, peer.sight, me.ego, p)


@stage
def receive(me, outbox, j, message, turn, p):
    """Take in the message of j that arrives in this round, or that none does; `outbox` holds what met it."""
    peer = me.peers[j]
    receive_message(message.broadcast, message.unicast, peer.inbox, turn.news, p)
    agree_weight(peer.track, outbox.unicast[j], peer.inbox, p)
    if turn.news and message.unicast.arrives:
        merge_beats(me.beats, message.beats)
        if p.lambda2 == FLOODING:
            merge_table(me.table, message.table)


@stage
def send(me, outbox, contacts, turn, p):
    """Run a round of the power iteration on what was received, then write the part of this round's messages for all."""
    if turn.estimates and p.lambda2 == POWER:
        power_round(me.belief, me.peers, outbox.broadcast, contacts, p)
    if turn.first:
        send_beats(outbox.beats, me.beats, me.index, turn.tick)
        if p.lambda2 == FLOODING:
            write_own_row(me.table, me.peers, me.index, turn.tick)
            copy_table(outbox.table, me.table)
    write_broadcast(outbox.broadcast, me.ego, me.belief)


@stage
def send_note(me, outbox, j):
    """Write the part of a message that is for robot j alone, in a round in which such parts are written."""
    write_unicast(outbox.unicast[j], me.peers[j].track)


@stage
def estimate_yaw(me, j, p):
    """Relative yaw of robot j, after a tick's messages."""
    peer = me.peers[j]
    relative_yaw.estimate_yaw(peer.track, peer.sight, me.ego, peer.inbox, p)


@stage
def observe(me, contacts, tick, leads, stick, work, bounds, p):
    """Write the observation after `tick`; returns how many neighbours found no row.

    leads: the operator's stick (x, y, z; m/s) reaches this robot; it is 0 for others. work: (laplacian, spectrum,
    nearest) of Scratch. bounds: (low, high) of `flat`, (D,) each.
    """
    if p.lambda2 == POWER:
        read_estimate(me.belief, me.peers.shape[0])
    elif p.lambda2 == FLOODING:
        build_laplacian(me.table, work[0], tick, p)
        solve_table(me.belief, me.mode, work[0], work[1], me.index)
    write_self(me.own_row, me.ego, me.belief, live_share(me.beats, tick, p), leads, stick)
    present = sort_present(work[2], me.peers, contacts)
    if me.detection_rows.shape[0] > 0:
        write_detections(me.detection_rows, me.blobs)
    write_neighbors(me.neighbor_rows, work[2][:present], me.peers, me.belief, me.mode, p)
    clip(me.flat, bounds[0], bounds[1])
    return max(present - me.neighbor_rows.shape[0], 0)
