"""The world's half of `kernel.step.run`, for robots that are processes of their own.

It calls what `run` calls, in the same order; where `run` goes on to a robot, a frame goes out or comes in. The state
holds what robots have on board only as they report it, for the referee and for recordings: nothing here gives one robot
what another one has.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fovconn_env.kernel import step
from fovconn_env.kernel.jit import kernel, large_entry, stage
from fovconn_env.kernel.maths import random
from fovconn_env.kernel.onboard import power_iteration
from fovconn_env.kernel.onboard.flooding import copy_table
from fovconn_env.kernel.world.camera import build_contacts, find_active, measure_relative_position
from fovconn_env.kernel.world.faults import clear_faults
from fovconn_env.kernel.world.odometry import measure_ego_motion
from fovconn_env.kernel.world.operator import update_stick
from fovconn_env.kernel.world.outcome import check_termination, write_infos, write_rewards
from fovconn_env.kernel.world.radio import draw_losses
from fovconn_env.kernel.world.rangefinder import scan

# what the world does between two exchanges with its robots
BEGIN, TICK, DELIVER, COLLECT, LOOK, REPORT, COMPILE = range(7)


class Mail(NamedTuple):
    """The messages that reach each robot in a round, those from robots with small numbers first: [receiver, place]."""

    count: np.ndarray  # (N,) int64, how many
    sender: np.ndarray  # (N, N) int64
    broadcast: np.ndarray  # (N, N) BROADCAST_RECORD
    unicast: np.ndarray  # (N, N) UNICAST_RECORD
    beats: np.ndarray  # (N, N, N) int64
    table: np.ndarray  # (N, N, N, N + 1), or without size


class Sent(NamedTuple):
    """What each robot has sent in a round: [sender]."""

    broadcast: np.ndarray  # (N,) BROADCAST_RECORD
    unicast: np.ndarray  # (N, N) UNICAST_RECORD: [sender, receiver]
    beats: np.ndarray  # (N, N) int64
    table: np.ndarray  # (N, N, N + 1), or without size


@large_entry
def advance_world(state, world, scratch, params, actions, draws, mail, sent, answered, phase, tick, k, warm_ticks):
    """Bring a world (of a batch of one) to its next exchange.

    draws: (N,) the robots' start draws, which the beginning of an episode writes. answered: (N,) bool, which robots
    have sent in this round. tick: of the step, or of the warm-up; k: the round in it.
    """
    p, b, moves = params[0], 0, warm_ticks == 0
    last = tick == (p.ticks if moves else warm_ticks) - 1
    slots = state.unicast.shape[1]
    if phase == BEGIN:
        begin_step(state, scratch, b, actions, draws, moves, p)
    elif phase == TICK:
        advance_tick(state, world, scratch, b, tick, moves, last, p)
    elif phase == DELIVER:
        deliver(state, b, state.episode[b].n_rounds % slots, mail, p)
    elif phase == COLLECT:
        number = state.episode[b].n_rounds
        collect(state, scratch, b, number % slots, step.round_of(number, k, slots, p), sent, answered, p)
        state.episode[b].n_rounds += 1
    elif phase == LOOK:
        look_about(state, world, b, actions, moves, p)
    elif phase == REPORT:  # after the robots have reported what they have on board
        bodies, infos = state.body[b], state.info[b]
        write_infos(bodies, state.peer[b], state.belief[b], infos, scratch.col, scratch.indptr, state.episode[b], p)


@stage
def begin_step(state, scratch, b, actions, draws, moves, p):
    """Set the commands of a step, or put robots at their places for an episode."""
    episode, bodies = state.episode[b], state.body[b]
    if moves:
        step.set_commands(bodies, actions[b], episode, p)
    else:
        episode.leader = p.leader_index
        for i in range(bodies.shape[0]):
            clear_faults(bodies[i])
            step.reset_body(bodies[i], state.flight[b, i], p)
            draws[i] = 2.0 * random.uniform(random.draw(episode.key, 0, i, random.START)) - 1.0
    step.clear_traffic(state.info[b])
    find_active(state.pair[b], scratch.active, p)
    build_contacts(scratch.active, scratch.row, scratch.col, scratch.indptr)


@stage
def advance_tick(state, world, scratch, b, tick, moves, last, p):
    """Move the bodies by a tick, bring the truth up to date, and measure what each robot senses."""
    episode, bodies, pairs, peers, n = (
        state.episode[b],
        state.body[b],
        state.pair[b],
        state.peer[b],
        state.body.shape[1],
    )
    if moves:
        step.step_dynamics(bodies, state.flight[b], episode, p)
    step.update_true_pairs(state, world, scratch, b, p)
    if moves and world.fault.shape[1] > 0:
        now = (episode.step * p.ticks + tick + 1) * p.tick
        step.update_faults(state, world.fault[b], b, now, p)
    step.detect_collisions(bodies, world.piece[b], world.vertex[b], episode, p)
    if last:
        step.update_true_lambda2(state, scratch, b, p)
    for i in range(n):
        measure_ego_motion(bodies[i], state.ego[b, i], i, episode, p)
    for k in range(scratch.indptr[n]):
        i, j = scratch.row[k], scratch.col[k]
        sight = peers[i, j].sight
        measure_relative_position(bodies[i], bodies[j], pairs[i, j], state.ego[b, i], sight, i * n + j, episode, p)


@stage
def deliver(state, b, slot, mail, p):
    """List the messages that reach each robot in this round; nothing of those that do not."""
    n = state.body.shape[1]
    for i in range(n):
        place = 0
        for j in range(n):
            if j == i or not state.unicast[b, slot, j, i].arrives:
                continue
            mail.sender[i, place] = j
            copy_broadcast(mail.broadcast[i, place], state.broadcast[b, slot, j])
            copy_unicast(mail.unicast[i, place], state.unicast[b, slot, j, i])
            mail.unicast[i, place].arrives = True
            copy_beats(mail.beats[i, place], state.beat_air[b, slot, j])
            if p.lambda2 == power_iteration.FLOODING:
                copy_table(mail.table[i, place], state.air[b, slot, j])
            place += 1
        mail.count[i] = place


@stage
def collect(state, scratch, b, slot, turn, sent, answered, p):
    """Put on the air what the robots have sent, nothing of others; the radio decides which of it will arrive."""
    n, episode, pairs, infos = state.body.shape[1], state.episode[b], state.pair[b], state.info[b]
    n_bytes = step.message_bytes(n, turn.first, state.unicast.shape[1], p)
    for i in range(n):
        if not answered[i]:
            for j in range(n):
                state.unicast[b, slot, i, j].sent = state.unicast[b, slot, i, j].arrives = False
            continue
        copy_broadcast(state.broadcast[b, slot, i], sent.broadcast[i])
        if turn.first:
            copy_beats(state.beat_air[b, slot, i], sent.beats[i])
            if p.lambda2 == power_iteration.FLOODING:
                copy_table(state.air[b, slot, i], sent.table[i])
    for k in range(scratch.indptr[n] if turn.writes else 0):
        i, j = scratch.row[k], scratch.col[k]
        if not answered[i]:
            continue
        unicast = state.unicast[b, slot, i, j]
        draw_losses(unicast, pairs[i, j], i * n + j, episode, p)
        if unicast.sent:
            infos[i].bytes_sent += n_bytes
            copy_unicast(unicast, sent.unicast[i, j])


@stage
def look_about(state, world, b, actions, moves, p):
    """Once a step, after its ticks: how it ended, the operator's next stick, and what the range finders measure."""
    episode, bodies, infos = state.episode[b], state.body[b], state.info[b]
    stick = episode.stick_x, episode.stick_y, episode.stick_z  # of this step
    if moves:
        episode.step += 1
    else:
        step.clear_traffic(infos)
    lead, waypoints = bodies[episode.leader], world.waypoint[b]
    arrived = update_stick(lead, waypoints, world.n_waypoints[b], world.stick, episode, p)
    for i in range(bodies.shape[0]):
        scan(bodies, i, world.piece[b], world.vertex[b], state.range_row[b, i], episode, p)
    if moves:
        check_termination(episode, arrived, p)
        write_rewards(bodies, infos, state.reward[b], actions[b], episode, stick, p)


@kernel
def copy_beats(to, source):
    """Copy beats (N,)."""
    for j in range(to.shape[0]):
        to[j] = source[j]


@kernel
def copy_broadcast(to, source):
    """Copy the part of a message that is the same for all."""
    to.vx, to.vy, to.vz, to.yaw_rate = source.vx, source.vy, source.vz, source.yaw_rate
    to.roll, to.pitch, to.x, to.degree = source.roll, source.pitch, source.x, source.degree
    to.y1, to.y2, to.y3 = source.y1, source.y2, source.y3
    to.q1, to.q2, to.q3 = source.q1, source.q2, source.q3


@kernel
def copy_unicast(to, source):
    """Copy the part of a message that is for one robot."""
    to.seen, to.px, to.py, to.pz = source.seen, source.px, source.py, source.pz
    to.gamma, to.f = source.gamma, source.f
    to.cos_yaw, to.sin_yaw, to.yaw_valid = source.cos_yaw, source.sin_yaw, source.yaw_valid
