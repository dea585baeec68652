"""One step of the environment: dynamics, pairs, sensors, messages, estimators, outcome, observations; world by world.

`run` lists the stages; a stage loops over the robots of one world. Functions that run on board get robot i's own
slices and nothing else.
"""

from __future__ import annotations

from fovconn_env import layout
from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.kernel.maths import random
from fovconn_env.kernel.maths.geometry import clearance
from fovconn_env.kernel.onboard import power_iteration, relative_yaw
from fovconn_env.kernel.onboard.flooding import build_laplacian, copy_table, merge_table, solve_table, write_own_row
from fovconn_env.kernel.onboard.liveness import live_share, merge_beats, send_beats
from fovconn_env.kernel.onboard.messages import receive_message, write_broadcast, write_unicast
from fovconn_env.kernel.onboard.observation import clip, write_neighbors, write_self
from fovconn_env.kernel.onboard.power_iteration import (
    agree_weight,
    init_estimate,
    power_round,
    read_estimate,
    set_estimate,
)
from fovconn_env.kernel.onboard.relative_yaw import dead_reckon, estimate_yaw, update_track
from fovconn_env.kernel.world.camera import (
    broad_phase,
    build_contacts,
    measure_relative_position,
    update_pairs,
)
from fovconn_env.kernel.world.faults import apply_faults, clear_faults, mask_pairs
from fovconn_env.kernel.world.kinematics import cache_half_turn, reset_kinematic, set_command, step_kinematic
from fovconn_env.kernel.world.odometry import measure_ego_motion
from fovconn_env.kernel.world.operator import NOBODY, update_stick
from fovconn_env.kernel.world.outcome import (
    check_termination,
    true_lambda2,
    update_true_weights,
    write_infos,
    write_rewards,
)
from fovconn_env.kernel.world.quadrotor import reset_quadrotor, step_quadrotor
from fovconn_env.kernel.world.radio import draw_losses
from fovconn_env.kernel.world.rangefinder import scan

ADVANCE, BEGIN = range(2)
KINEMATIC, QUADROTOR = range(2)  # scenarios.params.SWITCHES["dynamics"]
bytes_per_table, bytes_per_beats = kernel(layout.bytes_per_table), kernel(layout.bytes_per_beats)


@entry
def run(task, state, world, scratch, params, actions, mask, warm_ticks, first, last):
    """ADVANCE the worlds first..last-1 by a step of actions (B, N, 4), or BEGIN an episode in the masked (B,) ones.

    Worlds whose episode is over do not advance. Before BEGIN the caller clears a world's records and sets pose (x, y,
    z, yaw), key and max_steps; the estimators then warm up for `warm_ticks`, bodies held, the clock at 0. One entry
    for both, because each entry compiles everything below it.
    """
    p = params[0]
    n, order, row, col, indptr = state.body.shape[1], scratch.order, scratch.row, scratch.col, scratch.indptr
    for b in range(first, last):
        episode = state.episode[b]
        if (task == BEGIN and not mask[b]) or (task == ADVANCE and episode.over):
            continue
        bodies, flights, pairs, infos = state.body[b], state.flight[b], state.pair[b], state.info[b]
        ego, sights, inboxes = state.ego[b], state.sight[b], state.inbox[b]
        tracks, beliefs, v2 = state.track[b], state.belief[b], state.fiedler[b]
        tables, modes, beats = state.table[b], state.mode[b], state.beat[b]
        piece, vertex, faults = world.piece[b], world.vertex[b], world.fault[b]
        stick_x, stick_y, stick_z = episode.stick_x, episode.stick_y, episode.stick_z
        ticks = p.ticks if task == ADVANCE else warm_ticks
        slots = state.unicast.shape[1]  # rounds a message travels
        repeats = slots == 1 and p.loss == 0.0  # a tick's first notes lie in the slot until its last round
        if task == ADVANCE:
            set_commands(bodies, actions[b], episode, p)
        else:
            episode.leader = p.leader_index
            init_robots(bodies, flights, inboxes, tracks, beliefs, episode.key, p)
        for i in range(infos.shape[0]):
            infos[i].bytes_sent = 0.0

        build_contacts(pairs, row, col, indptr, p)
        for tick in range(ticks):
            if task == ADVANCE:
                step_dynamics(bodies, flights, episode, p)
            n_near = broad_phase(bodies, order, row, col, indptr[n], scratch.near, p)
            if update_pairs(bodies, pairs, scratch.near, n_near, piece, vertex, p):
                build_contacts(pairs, row, col, indptr, p)
            if task == ADVANCE and faults.shape[0] > 0:
                now = (episode.step * p.ticks + tick + 1) * p.tick
                update_faults(bodies, flights, pairs, state.unicast[b], faults, now, p)
            detect_collisions(bodies, piece, vertex, episode, p)
            if tick == ticks - 1:
                episode.n_edges = update_true_weights(pairs, infos, p)
                episode.lambda2 = true_lambda2(bodies, pairs, v2, scratch.laplacian, scratch.spectrum)
                if p.lambda2 == power_iteration.TRUE:
                    reveal_lambda2(beliefs, episode.lambda2, v2)
            sense(bodies, pairs, ego, sights, tracks, row, col, indptr[n], episode, p)
            for k in range(p.rounds):
                slot = episode.n_rounds % slots
                broadcast, unicast, air = state.broadcast[b, slot], state.unicast[b, slot], state.air[b, slot]
                beat_air = state.beat_air[b, slot]
                news = (episode.n_rounds - slots) % p.rounds == 0  # the first messages of a tick arrive
                receive_messages(broadcast, unicast, inboxes, tracks, row, col, indptr[n], news, p)
                if slot == 0 and p.lambda2 == power_iteration.POWER:
                    estimate_lambda2(beliefs, tracks, broadcast, inboxes, col, indptr, p)
                n_bytes = layout.BYTES_PER_MESSAGE * (p.rounds if repeats else 1)
                if news:
                    receive_beats(beats, beat_air, unicast, row, col, indptr[n])
                if k == 0:
                    for i in range(n):
                        send_beats(beat_air[i], beats[i], i, episode.n_rounds // p.rounds + 1)
                    n_bytes += bytes_per_beats(n)
                if p.lambda2 == power_iteration.FLOODING:
                    if news:
                        receive_tables(tables, air, unicast, row, col, indptr[n])
                    if k == 0:
                        send_tables(tables, air, tracks, episode.n_rounds // p.rounds + 1)
                        n_bytes += bytes_per_table(n)
                for i in range(n):
                    write_broadcast(broadcast[i], ego[i], beliefs[i])
                if k == 0 or not repeats:
                    send_messages(unicast, tracks, pairs, infos, row, col, indptr[n], n_bytes, episode, p)
                episode.n_rounds += 1
            estimate_yaws(tracks, sights, ego, inboxes, row, col, indptr[n], p)
            if p.relative_yaw != relative_yaw.ESTIMATED:
                override_yaw(bodies, tracks, p)

        if task == ADVANCE:
            episode.step += 1
        else:
            for i in range(infos.shape[0]):
                infos[i].bytes_sent = 0.0  # the warm-up's
        if p.lambda2 == power_iteration.POWER:
            for i in range(n):
                read_estimate(beliefs[i], n)
        elif p.lambda2 == power_iteration.FLOODING:
            solve_tables(beliefs, tables, modes, scratch, episode.n_rounds // p.rounds, p)
        arrived = update_stick(bodies[episode.leader], world.waypoint[b], world.n_waypoints[b], world.stick, episode, p)
        own_rows, neighbor_rows = state.own_row[b], state.neighbor_row[b]
        write_observations(
            ego, tracks, inboxes, beliefs, beats, modes, col, indptr, own_rows, neighbor_rows, infos, episode, p
        )
        write_ranges(bodies, piece, vertex, state.range_row[b], episode, p)
        if faults.shape[0] > 0:
            zero_dead(bodies, state.flat[b])
        clip(state.flat[b], world.low, world.high)
        if task == ADVANCE:
            check_termination(episode, arrived, p)
            write_rewards(bodies, infos, state.reward[b], actions[b], episode, stick_x, stick_y, stick_z, p)
        write_infos(bodies, tracks, beliefs, infos, col, indptr, episode, p)


@kernel
def init_robots(bodies, flights, inboxes, tracks, beliefs, key, p):
    """Robots stand or hover at their poses; estimators are empty."""
    n = bodies.shape[0]
    for i in range(n):
        clear_faults(bodies[i])
        reset_body(bodies[i], flights[i], p)
        if p.lambda2 == power_iteration.POWER:
            init_estimate(beliefs[i], 2.0 * random.uniform(random.draw(key, 0, i, random.START)) - 1.0)
        for j in range(n):
            inboxes[i, j].age = p.memory
            tracks[i, j].cos_yaw = tracks[i, j].cos_used = 1.0


@kernel
def reset_body(body, flight, p):
    """Put a robot at rest at its pose."""
    if p.dynamics == QUADROTOR:
        reset_quadrotor(body, flight, p)
    else:
        reset_kinematic(body, p)


@kernel
def set_commands(bodies, actions, episode, p):
    """Turn actions (N, 4) into commands; the stick (m/s, leader's yaw frame) is added to the leader's."""
    for i in range(bodies.shape[0]):
        pull = 1.0 if i == episode.leader else 0.0
        set_command(bodies[i], actions[i], pull * episode.stick_x, pull * episode.stick_y, pull * episode.stick_z, p)
        if p.dynamics == KINEMATIC:
            cache_half_turn(bodies[i], p)


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


@kernel
def update_faults(bodies, flights, pairs, unicast, faults, now, p):
    """Apply the faults at the time `now`, s on the clock; a dead robot is at rest, level. One call: two are slower."""
    apply_faults(bodies, unicast, faults, now)
    mask_pairs(bodies, pairs, p)
    for i in range(bodies.shape[0]):
        if not bodies[i].alive:
            reset_body(bodies[i], flights[i], p)


@kernel
def detect_collisions(bodies, piece, vertex, episode, p):
    """Detect collisions between robots and with obstacles."""
    for i in range(bodies.shape[0]):
        body = bodies[i]
        body.clearance = clearance(body.x, body.y, body.z, piece, vertex)
        if body.nearest < p.collision_robot or body.clearance < p.collision_obstacle:
            episode.collision = True


@kernel
def sense(bodies, pairs, ego, sights, tracks, row, col, count, episode, p):
    """Odometry, IMU and camera of every robot."""
    n = bodies.shape[0]
    for i in range(n):
        measure_ego_motion(bodies[i], ego[i], i, episode.key, episode.n_rounds, p)
        dead_reckon(ego[i], p)
    for k in range(count):
        i, j = row[k], col[k]
        measure_relative_position(
            bodies[i], bodies[j], pairs[i, j], ego[i], sights[i, j], i * n + j, episode.key, episode.n_rounds, p
        )
        update_track(tracks[i, j], sights[i, j], ego[i], p)


@kernel
def receive_messages(broadcast, unicast, inboxes, tracks, row, col, count, news, p):
    """Deliver the messages that arrive in this round; both ends of a link update its agreed weight."""
    for k in range(count):
        i, j = row[k], col[k]
        receive_message(broadcast[j], unicast[j, i], inboxes[i, j], news, p)
        agree_weight(tracks[i, j], unicast[i, j], inboxes[i, j], p)


@kernel
def estimate_lambda2(beliefs, tracks, broadcast, inboxes, col, indptr, p):
    """On board of every robot: one round of the power iteration."""
    for i in range(beliefs.shape[0]):
        power_round(beliefs[i], tracks[i], broadcast[i], inboxes[i], col[indptr[i] : indptr[i + 1]], p)


@kernel
def receive_beats(beats, air, unicast, row, col, count):
    """On board of every robot: take over the beats that arrive in this round."""
    for k in range(count):
        i, j = row[k], col[k]
        if unicast[j, i].arrives:
            merge_beats(beats[i], air[j])


@kernel
def receive_tables(tables, air, unicast, row, col, count):
    """On board of every robot: merge the tables that arrive in this round."""
    for k in range(count):
        i, j = row[k], col[k]
        if unicast[j, i].arrives:
            merge_table(tables[i], air[j])


@kernel
def send_tables(tables, air, tracks, tick):
    """On board of every robot: write its links into its table, and send a copy with a tick's first messages."""
    for i in range(tables.shape[0]):
        write_own_row(tables[i], tracks[i], i, tick)
        copy_table(air[i], tables[i])


@kernel
def solve_tables(beliefs, tables, modes, scratch, now, p):
    """On board of every robot: lambda2 and v2 of the team as its table has it in tick `now`."""
    for i in range(beliefs.shape[0]):
        build_laplacian(tables[i], scratch.laplacian, now, p)
        solve_table(beliefs[i], modes[i], scratch.laplacian, scratch.spectrum, i)


@kernel
def send_messages(unicast, tracks, pairs, infos, row, col, count, n_bytes, episode, p):
    """Every robot writes its unicast messages into the slot just emptied, where they go on the air.

    n_bytes: of the messages from one robot to another until it writes again.
    """
    n = pairs.shape[0]
    for k in range(count):
        i, j = row[k], col[k]
        draw_losses(unicast[i, j], pairs[i, j], i * n + j, episode.key, episode.n_rounds, p)
        if unicast[i, j].sent:
            write_unicast(unicast[i, j], tracks[i, j])
            infos[i].bytes_sent += n_bytes


@kernel
def estimate_yaws(tracks, sights, ego, inboxes, row, col, count, p):
    """On board of every robot: relative yaw of each of its contacts."""
    for k in range(count):
        i, j = row[k], col[k]
        estimate_yaw(tracks[i, j], sights[i, j], ego[i], inboxes[i, j], p)


@kernel
def reveal_lambda2(beliefs, lambda2, v2):
    """Switch lambda2 = "true": an oracle puts the truth into every robot's belief."""
    for i in range(beliefs.shape[0]):
        set_estimate(beliefs[i], lambda2, v2[i], v2.shape[0])


@kernel
def override_yaw(bodies, tracks, p):
    """Switch relative_yaw: "true" puts the truth in the estimate's place (an oracle), "none" leaves no estimate."""
    n = bodies.shape[0]
    for i in range(n):
        for j in range(n):
            a, b, track = bodies[i], bodies[j], tracks[i, j]
            track.valid = track.present and p.relative_yaw == relative_yaw.TRUE
            track.cos_yaw, track.sin_yaw = 1.0, 0.0
            if p.relative_yaw == relative_yaw.TRUE:
                track.cos_yaw = a.cos_yaw * b.cos_yaw + a.sin_yaw * b.sin_yaw
                track.sin_yaw = a.cos_yaw * b.sin_yaw - a.sin_yaw * b.cos_yaw
            track.cos_used, track.sin_used = track.cos_yaw, track.sin_yaw


@kernel
def write_observations(
    ego, tracks, inboxes, beliefs, beats, modes, col, indptr, own_rows, neighbor_rows, infos, episode, p
):
    """Write the observation of every robot from what it has on board."""
    for i in range(ego.shape[0]):
        there = live_share(beats[i], episode.n_rounds // p.rounds, p)
        leads, known = i == episode.leader and p.leader != NOBODY, col[indptr[i] : indptr[i + 1]]
        write_self(own_rows[i], ego[i], beliefs[i], there, leads, episode.stick_x, episode.stick_y, episode.stick_z)
        dropped = write_neighbors(neighbor_rows[i], tracks[i], inboxes[i], beliefs[i], modes[i], known, p)
        infos[i].neighbors_dropped = dropped


@kernel
def write_ranges(bodies, piece, vertex, range_rows, episode, p):
    """Write every robot's range points into its observation."""
    for i in range(bodies.shape[0]):
        scan(bodies, i, piece, vertex, range_rows[i], episode.key, episode.n_rounds, p)


@kernel
def zero_dead(bodies, flat):
    """A dead robot observes nothing: zeros."""
    for i in range(bodies.shape[0]):
        if not bodies[i].alive:
            for k in range(flat.shape[1]):
                flat[i, k] = 0.0
