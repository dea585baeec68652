"""One step of the environment: what the world does, and what every robot computes, world by world.

`run` lists the stages, and each line reads what the lines above it wrote. A stage loops over the robots of one world.
What runs on board is in `kernel.onboard.robot`; its functions get a `Robot`, an `Outbox` or a `Message`, which
`robot_of`, `outbox_of` and `message_of` cut out of the state, and plain numbers.
"""

from __future__ import annotations

from fovconn_env import layout
from fovconn_env.kernel.jit import kernel, large_entry, stage, view
from fovconn_env.kernel.maths import random
from fovconn_env.kernel.maths.geometry import clearance, headroom
from fovconn_env.kernel.onboard import power_iteration, relative_yaw, robot
from fovconn_env.kernel.onboard.messages import Message, Outbox, Round
from fovconn_env.kernel.onboard.power_iteration import set_estimate
from fovconn_env.kernel.onboard.robot import Robot
from fovconn_env.kernel.prefetch import prefetch
from fovconn_env.kernel.world.camera import (
    broad_phase,
    build_contacts,
    find_active,
    measure_relative_position,
    update_pairs,
)
from fovconn_env.kernel.world.faults import apply_faults, clear_faults, mask_pairs
from fovconn_env.kernel.world.frames import expose, start_misses
from fovconn_env.kernel.world.kinematics import cache_half_turn, reset_kinematic, set_command, step_kinematic
from fovconn_env.kernel.world.odometry import measure_ego_motion
from fovconn_env.kernel.world.operator import NOBODY, update_stick
from fovconn_env.kernel.world.outcome import (
    build_true_laplacian,
    check_termination,
    count_swaps,
    true_lambda2,
    update_true_weights,
    write_infos,
    write_rewards,
)
from fovconn_env.kernel.world.quadrotor import reset_quadrotor, step_quadrotor
from fovconn_env.kernel.world.radio import draw_losses
from fovconn_env.kernel.world.rangefinder import scan

KINEMATIC, QUADROTOR = range(2)  # scenarios.SWITCHES["dynamics"]
bytes_per_beats, bytes_per_table = kernel(layout.bytes_per_beats), kernel(layout.bytes_per_table)


@large_entry
def run(state, world, scratch, params, actions, mask, warm_ticks, worlds, frames):
    """Advance worlds by a step of actions (B, N, 4); with warm_ticks > 0, begin an episode in the masked (B,) ones.

    worlds: (first, last), those first..last-1 are visited; one whose episode is over does not advance. frames: True, or
    None where cameras are ideal, for which what other cameras need is not compiled. Before an
    episode begins the caller clears the world's records and sets pose (x, y, z, yaw), key and max_steps; the estimators
    then warm up for `warm_ticks`, bodies held, the clock at 0. One entry for both, because each entry compiles
    everything below it.
    """
    p, moves = params[0], warm_ticks == 0
    for b in range(worlds[0], worlds[1]):
        episode, bodies, infos = state.episode[b], state.body[b], state.info[b]
        if episode.over if moves else not mask[b]:
            continue
        following = min(b + 1, worlds[1] - 1)
        prefetch_robots(state, following)
        stick = episode.stick_x, episode.stick_y, episode.stick_z  # of this step
        if moves:
            set_commands(bodies, actions[b], episode, p)  # command <- action, stick
        else:
            start_robots(state, b, p, frames)  # velocity, what is on board <- pose
        clear_traffic(infos)
        find_active(state.pair[b], scratch.active, p)
        build_contacts(scratch.active, scratch.row, scratch.col, scratch.indptr)
        ticks = p.ticks if moves else warm_ticks
        for tick in range(ticks):
            if moves:
                step_dynamics(bodies, state.flight[b], episode, p)  # pose <- command
            update_true_pairs(state, world, scratch, b, p)  # pairs, contacts <- pose, obstacles
            if moves and world.fault.shape[1] > 0:
                now = (episode.step * p.ticks + tick + 1) * p.tick
                update_faults(state, world.fault[b], b, now, p)  # bodies, pairs, messages in the air <- faults
            detect_collisions(bodies, world.piece[b], world.vertex[b], episode, p)
            if tick == ticks - 1:
                update_true_lambda2(state, scratch, b, p)  # true weights, lambda2, v2 <- pairs
            sense(state, scratch, b, p, frames)  # ego, sights <- bodies, pairs; tracks <- ego, sights
            for k in range(p.rounds):
                turn = round_of(episode.n_rounds, k, state.unicast.shape[1], p)
                slot = episode.n_rounds % state.unicast.shape[1]
                receive_messages(state, scratch, b, slot, turn, p)  # inboxes, beats, tables <- messages
                send_messages(state, scratch, b, slot, turn, p)  # messages <- tracks, beliefs, beats, tables
                episode.n_rounds += 1
            estimate_yaws(state, scratch, b, p)  # relative yaws <- sights, ego, inboxes
        prefetch_contacts(state, following, p)
        if moves:
            episode.step += 1
        else:
            clear_traffic(infos)  # the warm-up's
        lead, waypoints = bodies[episode.leader], world.waypoint[b]
        arrived = update_stick(lead, waypoints, world.n_waypoints[b], world.stick, episode, p)
        write_observations(state, world, scratch, b, p)  # observations <- what is on board, stick, range points
        if moves:
            check_termination(episode, arrived, p)
            write_rewards(bodies, infos, state.reward[b], actions[b], episode, stick, p)
        write_infos(bodies, state.peer[b], state.belief[b], infos, scratch.col, scratch.indptr, episode, p)


# ------------------------------------------------------------------------------------------- one robot's slices
@view
def robot_of(state, b, i):
    """What robot i of world b has on board."""
    return Robot(
        i,
        state.ego[b, i],
        state.peer[b, i],
        state.belief[b, i],
        state.beat[b, i],
        state.table[b, i],
        state.mode[b, i],
        state.flat[b, i],
        state.own_row[b, i],
        state.neighbor_row[b, i],
        state.motion[b, i],
        state.blob[b, i],
        state.detection_row[b, i],
    )


@view
def outbox_of(state, b, slot, i):
    """What robot i of world b sent when a slot was written last."""
    return Outbox(
        state.broadcast[b, slot, i], state.unicast[b, slot, i], state.beat_air[b, slot, i], state.air[b, slot, i]
    )


@view
def message_of(state, b, slot, j, i):
    """What robot j of world b sent to i when a slot was written last."""
    return Message(
        state.broadcast[b, slot, j], state.unicast[b, slot, j, i], state.beat_air[b, slot, j], state.air[b, slot, j]
    )


@view
def report_of(state, b, slot, i):
    """The frame of robot i's camera in world b that is in a slot."""
    return state.report[b, slot, i]


@view
def contacts_of(scratch, i):
    """Robots that robot i is or was lately linked to; visiting others as well changes nothing on board."""
    return scratch.col[scratch.indptr[i] : scratch.indptr[i + 1]]


@kernel
def round_of(number, k, slots, p):
    """Round k of a tick, the `number`-th since the reset; a message travels for `slots` rounds."""
    # without loss and delay all unicast parts of a tick are the same: they lie in the slot until its last round
    writes = k == 0 or slots > 1 or p.loss > 0.0
    return Round(number // p.rounds + 1, k == 0, (number - slots) % p.rounds == 0, writes, number % slots == 0)


# ------------------------------------------------------------------------------------------------ the next world
@stage
def prefetch_robots(state, b):
    """Ask for the memory of world b's robots, and of the truth about its pairs."""
    prefetch(state.episode[b])
    prefetch(state.body[b])
    prefetch(state.pair[b])
    prefetch(state.ego[b])
    prefetch(state.broadcast[b])
    prefetch(state.belief[b])
    prefetch(state.beat[b])
    prefetch(state.beat_air[b])
    prefetch(state.info[b])
    prefetch(state.flat[b])


@stage
def prefetch_contacts(state, b, p):
    """Ask for the memory of what is on board of world b's robots, and in the air, about their contacts."""
    n, pairs = state.body.shape[1], state.pair[b]
    for i in range(n):
        for j in range(n):
            if j != i and pairs[i, j].idle_ticks < p.rest_ticks:
                prefetch(state.peer[b, i, j])
                for slot in range(state.unicast.shape[1]):
                    prefetch(state.unicast[b, slot, i, j])


# --------------------------------------------------------------------------------------------- once an episode
@stage
def start_robots(state, b, p, frames):
    """Robots stand or hover at their poses, with nothing on board."""
    bodies, episode = state.body[b], state.episode[b]
    episode.leader = p.leader_index
    for i in range(bodies.shape[0]):
        clear_faults(bodies[i])
        reset_body(bodies[i], state.flight[b, i], p)
        x = 2.0 * random.uniform(random.draw(episode.key, 0, i, random.START)) - 1.0
        robot.start(robot_of(state, b, i), x, p)
        if frames is not None:
            start_misses(i, state.missing[b, i], episode, p)


@kernel
def reset_body(body, flight, p):
    """Put a robot at rest at its pose."""
    if p.dynamics == QUADROTOR:
        reset_quadrotor(body, flight, p)
    else:
        reset_kinematic(body, p)


# ------------------------------------------------------------------------------------------------- once a step
@kernel
def set_commands(bodies, actions, episode, p):
    """Turn actions (N, 4) into commands; the stick (m/s, leader's yaw frame) is added to the leader's."""
    for i in range(bodies.shape[0]):
        leads = 1.0 if i == episode.leader else 0.0
        x, y, z = leads * episode.stick_x, leads * episode.stick_y, leads * episode.stick_z
        set_command(bodies[i], actions[i], x, y, z, p)
        if p.dynamics == KINEMATIC:
            cache_half_turn(bodies[i], p)


@kernel
def clear_traffic(infos):
    """Nothing has been sent in this step, and no name has passed to another robot."""
    for i in range(infos.shape[0]):
        infos[i].bytes_sent = infos[i].name_swaps = 0.0


@stage
def write_observations(state, world, scratch, b, p):
    """Write every robot's observation: range points from the world, the rest on board; of a dead robot zeros."""
    bodies, episode, infos = state.body[b], state.episode[b], state.info[b]
    work, bounds = (scratch.laplacian, scratch.spectrum, scratch.nearest), (world.low, world.high)
    tick = episode.n_rounds // p.rounds
    for i in range(bodies.shape[0]):
        leads = i == episode.leader and p.leader != NOBODY
        stick = (episode.stick_x, episode.stick_y, episode.stick_z) if leads else (0.0, 0.0, 0.0)
        scan(bodies, i, world.piece[b], world.vertex[b], state.range_row[b, i], episode, p)
        dropped = robot.observe(robot_of(state, b, i), contacts_of(scratch, i), tick, leads, stick, work, bounds, p)
        infos[i].neighbors_dropped = dropped
        if not bodies[i].alive:
            state.flat[b, i] = 0.0


# ------------------------------------------------------------------------------------------ once a tick: the world
@kernel
def step_dynamics(bodies, flights, episode, p):
    """Move every robot by one tick along its command; a dead one stays where it is."""
    for i in range(bodies.shape[0]):
        if not bodies[i].alive:
            continue
        if p.dynamics == QUADROTOR:
            step_quadrotor(bodies[i], flights[i], p, episode.key, episode.n_rounds, i)
        else:
            step_kinematic(bodies[i], p)


@stage
def update_true_pairs(state, world, scratch, b, p):
    """Bring the truth about pairs up to date, and the list of contacts where it changes."""
    bodies, pairs, row, col, indptr = state.body[b], state.pair[b], scratch.row, scratch.col, scratch.indptr
    count = broad_phase(bodies, scratch.spectrum, col, indptr, scratch.near, p)
    if update_pairs(bodies, pairs, scratch.active, scratch.near, count, world.piece[b], world.vertex[b], p):
        build_contacts(scratch.active, row, col, indptr)


@stage
def update_faults(state, faults, b, now, p):
    """Apply the faults (F,) at the time `now`, s on the clock; a dead robot is at rest, level."""
    bodies = state.body[b]
    apply_faults(bodies, state.unicast[b], faults, now)
    mask_pairs(bodies, state.pair[b], p)
    for i in range(bodies.shape[0]):
        if not bodies[i].alive:
            reset_body(bodies[i], state.flight[b, i], p)


@kernel
def detect_collisions(bodies, piece, vertex, episode, p):
    """Detect collisions between robots and with obstacles, floor and ceiling."""
    for i in range(bodies.shape[0]):
        body = bodies[i]
        below, above = headroom(body.z, p)
        body.clearance = min(clearance(body.x, body.y, body.z, piece, vertex), below, above)
        if body.nearest < p.collision_robot or body.clearance < p.collision_obstacle:
            episode.collision = True


@stage
def update_true_lambda2(state, scratch, b, p):
    """True weights, lambda2 and v2 of the team."""
    episode, pairs, v2, laplacian = state.episode[b], state.pair[b], state.fiedler[b], scratch.laplacian
    count = scratch.indptr[v2.shape[0]]
    row, col = scratch.row[:count], scratch.col[:count]
    episode.n_edges = update_true_weights(pairs, state.info[b], row, col, p)
    build_true_laplacian(laplacian, pairs, row, col)
    episode.lambda2 = true_lambda2(state.body[b], v2, laplacian, scratch.spectrum)
    if p.lambda2 == power_iteration.TRUE:
        reveal_lambda2(state.belief[b], episode.lambda2, v2)


@kernel
def reveal_lambda2(beliefs, lambda2, v2):
    """Switch lambda2 = "true": an oracle puts the truth into every robot's belief."""
    for i in range(beliefs.shape[0]):
        set_estimate(beliefs[i], lambda2, v2[i], v2.shape[0])


# ----------------------------------------------------------------------------------------- once a tick: the robots
@stage
def sense(state, scratch, b, p, frames):
    """Odometry, IMU and camera of every robot, and what it makes of them."""
    bodies, pairs, ego, peers, episode = state.body[b], state.pair[b], state.ego[b], state.peer[b], state.episode[b]
    n = bodies.shape[0]
    for i in range(n):
        measure_ego_motion(bodies[i], ego[i], i, episode, p)
        robot.sense(robot_of(state, b, i), p)
    if frames is not None:
        look_around(state, scratch, b, p)
    for k in range(scratch.indptr[n]):
        i, j = scratch.row[k], scratch.col[k]
        if frames is None:
            measure_relative_position(
                bodies[i], bodies[j], pairs[i, j], ego[i], peers[i, j].sight, i * n + j, episode, p
            )
        robot.see(robot_of(state, b, i), j, p)


@kernel
def look_around(state, scratch, b, p):
    """Every camera that is not ideal takes its frame, and reports the one of `latency` ago.

    No stage: within `run` it would slow down all that has ideal cameras.
    """
    bodies, pairs, episode, n = state.body[b], state.pair[b], state.episode[b], state.body.shape[1]
    slots, tick = state.report.shape[1], episode.n_rounds // p.rounds
    for i in range(n):
        ego, missing, report = state.ego[b, i], state.missing[b, i], report_of(state, b, tick % slots, i)
        expose(i, bodies, pairs[i], ego, missing, report, contacts_of(scratch, i), episode, p)
        robot.look(robot_of(state, b, i), report_of(state, b, (tick + 1) % slots, i), contacts_of(scratch, i), tick, p)
        keep_named(pairs, i, state.blob[b, i])
        state.info[b, i].name_swaps += count_swaps(state.blob[b, i])


@kernel
def keep_named(pairs, i, blobs):
    """Keep a pair active while something goes by its name on board, be it another robot."""
    for blob in blobs:
        if blob.used and blob.name >= 0:
            pairs[i, blob.name].idle_ticks = pairs[blob.name, i].idle_ticks = 0


@stage
def receive_messages(state, scratch, b, slot, turn, p):
    """Every robot receives the messages that arrive in this round; both ends of a link then agree on its weight."""
    for k in range(scratch.indptr[state.body.shape[1]]):
        i, j = scratch.row[k], scratch.col[k]
        message = message_of(state, b, slot, j, i)
        robot.receive(robot_of(state, b, i), outbox_of(state, b, slot, i), j, message, turn, p)


@stage
def send_messages(state, scratch, b, slot, turn, p):
    """Every robot writes its messages into the slot just emptied; the radio decides which of them will arrive."""
    n, episode, pairs, infos = state.body.shape[1], state.episode[b], state.pair[b], state.info[b]
    n_bytes = message_bytes(n, turn.first, state.unicast.shape[1], p)
    for i in range(n):
        robot.send(robot_of(state, b, i), outbox_of(state, b, slot, i), contacts_of(scratch, i), turn, p)
    for k in range(scratch.indptr[n] if turn.writes else 0):
        i, j = scratch.row[k], scratch.col[k]
        unicast = state.unicast[b, slot, i, j]
        draw_losses(unicast, pairs[i, j], i * n + j, episode, p)
        if unicast.sent:
            infos[i].bytes_sent += n_bytes
            robot.send_note(robot_of(state, b, i), outbox_of(state, b, slot, i), j)


@kernel
def message_bytes(n, first, slots, p):
    """Bytes of the messages of a round to one robot; where all rounds of a tick have the same unicast part, of all."""
    n_bytes = layout.BYTES_PER_MESSAGE * (1 if p.loss > 0.0 or slots > 1 else p.rounds)
    if first:
        n_bytes += bytes_per_beats(n)
        if p.lambda2 == power_iteration.FLOODING:
            n_bytes += bytes_per_table(n)
    return n_bytes


@stage
def estimate_yaws(state, scratch, b, p):
    """Every robot estimates the relative yaws of its contacts; a switch may override them."""
    for k in range(scratch.indptr[state.body.shape[1]]):
        i, j = scratch.row[k], scratch.col[k]
        robot.estimate_yaw(robot_of(state, b, i), j, p)
    if p.relative_yaw != relative_yaw.ESTIMATED:
        override_yaw(state.body[b], state.peer[b], p)


@kernel
def override_yaw(bodies, peers, p):
    """Switch relative_yaw: "true" puts the truth in the estimate's place (an oracle), "none" leaves no estimate."""
    n = bodies.shape[0]
    for i in range(n):
        for j in range(n):
            a, b, track = bodies[i], bodies[j], peers[i, j].track
            track.valid = track.present and p.relative_yaw == relative_yaw.TRUE
            track.cos_yaw, track.sin_yaw = 1.0, 0.0
            if p.relative_yaw == relative_yaw.TRUE:
                track.cos_yaw = a.cos_yaw * b.cos_yaw + a.sin_yaw * b.sin_yaw
                track.sin_yaw = a.cos_yaw * b.sin_yaw - a.sin_yaw * b.cos_yaw
            track.cos_used, track.sin_used = track.cos_yaw, track.sin_yaw
