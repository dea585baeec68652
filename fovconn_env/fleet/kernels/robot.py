"""One robot's half of `kernel.step.run`: what it does when a frame arrives, with the functions it consists of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fovconn_env.kernel import step
from fovconn_env.kernel.jit import large_entry, stage, view
from fovconn_env.kernel.onboard import robot
from fovconn_env.kernel.onboard.messages import Message, Outbox
from fovconn_env.kernel.onboard.robot import Robot

START, ROUND, OBSERVE = range(3)  # what a robot does when a frame arrives


class Board(NamedTuple):
    """What one robot of N has on board; as `kernel.records.State`, without the axes of world and robot."""

    ego: np.ndarray  # (1,)
    peer: np.ndarray  # (N,)
    belief: np.ndarray  # (1,)
    beat: np.ndarray  # (N,)
    table: np.ndarray  # (N, N + 1)
    mode: np.ndarray  # (N,)
    flat: np.ndarray  # (D,)
    own_row: np.ndarray  # (1,), a view as the two below
    neighbor_row: np.ndarray  # (M,)
    detection_row: np.ndarray  # (0,)
    motion: np.ndarray  # (1,) none of a camera that is ideal
    blob: np.ndarray  # (0,)
    # what it sent: [slot]
    broadcast: np.ndarray  # (L,)
    unicast: np.ndarray  # (L, N)
    beat_air: np.ndarray  # (L, N)
    air: np.ndarray  # (L, N, N + 1)
    others: np.ndarray  # (N - 1,) uint32, the numbers of the other robots
    blank: np.ndarray  # (1,) UNICAST_RECORD of a message that has not arrived


@large_entry
def advance_robot(i, board, scratch, params, mail, sensed, number, k, phase, start, leads, stick, alive, bounds):
    """Do what robot i does when a frame arrives; returns how many neighbours found no row in the observation.

    mail: `Mail` without the receiver's axis. sensed: of this tick, odometry (6,) and sights (N,). number: rounds since
    the reset; k: the round in its tick. start: the robot's start draw. stick: (x, y, z), 0 for a robot that does not
    lead. bounds: (low, high) of the observation.
    """
    p, me = params[0], robot_on(board, i)
    if phase == START:
        robot.start(me, start, p)
    elif phase == ROUND:
        take_round(me, board, mail, sensed, number, k, p)
    else:
        work = scratch.laplacian, scratch.spectrum, scratch.nearest
        dropped = robot.observe(me, board.others, number // p.rounds, leads, stick, work, bounds, p)
        if not alive:
            board.flat[:] = 0.0
        return dropped
    return 0


@view
def robot_on(board, i):
    """Robot i, whose board it is."""
    return Robot(
        i,
        board.ego[0],
        board.peer,
        board.belief[0],
        board.beat,
        board.table,
        board.mode,
        board.flat,
        board.own_row[0],
        board.neighbor_row,
        board.motion,
        board.blob,
        board.detection_row,
    )


@view
def outbox_on(board, slot):
    """What the robot sent when a slot was written last."""
    return Outbox(board.broadcast[slot], board.unicast[slot], board.beat_air[slot], board.air[slot])


@view
def message_in(mail, place, unicast):
    """The message at a place of the mail; unicast: its own, or that of a message that has not arrived."""
    return Message(mail.broadcast[place], unicast, mail.beats[place], mail.table[place])


@stage
def take_round(me, board, mail, sensed, number, k, p):
    """Sense, if a tick begins, then receive, and write what is sent; after a tick's last round estimate the yaws."""
    slot = number % board.unicast.shape[0]
    turn = step.round_of(number, k, board.unicast.shape[0], p)
    if k == 0:
        odometry, sights = sensed
        ego = me.ego
        ego.vx, ego.vy, ego.vz, ego.yaw_rate = odometry[0], odometry[1], odometry[2], odometry[3]
        ego.roll, ego.pitch = odometry[4], odometry[5]
        robot.sense(me, p)
        for j in board.others:
            sight = me.peers[j].sight
            sight.seen, sight.x, sight.y, sight.z = sights[j].seen, sights[j].x, sights[j].y, sights[j].z
            robot.see(me, j, p)
    place = 0
    for j in board.others:
        arrives = place < mail.count[0] and mail.sender[place] == j
        unicast = mail.unicast[place] if arrives else board.blank[0]
        robot.receive(me, outbox_on(board, slot), j, message_in(mail, place if arrives else 0, unicast), turn, p)
        place += arrives
    robot.send(me, outbox_on(board, slot), board.others, turn, p)
    if turn.writes:
        for j in board.others:
            robot.send_note(me, outbox_on(board, slot), j)
    if k == p.rounds - 1:
        for j in board.others:
            robot.estimate_yaw(me, j, p)
