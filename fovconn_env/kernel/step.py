"""One step of the environment: move > look > sense > talk > estimate > judge > observe, world by world.

`run` lists the stages; a stage loops over the robots of one world. Functions that run on board get robot i's own
slices and nothing else.
"""

from __future__ import annotations

from fovconn_env import layout
from fovconn_env.kernel.jit import entry, kernel
from fovconn_env.kernel.maths import random
from fovconn_env.kernel.maths.geometry import clearance
from fovconn_env.kernel.onboard import power_iteration, relative_yaw
from fovconn_env.kernel.onboard.flooding import assemble, enter, merge, put, solve
from fovconn_env.kernel.onboard.liveness import hear_beats, share_there, tell_beats
from fovconn_env.kernel.onboard.observation import clip, observe_neighbors, observe_self
from fovconn_env.kernel.onboard.power_iteration import agree, awaken, conclude, know, power_round
from fovconn_env.kernel.onboard.relative_yaw import attend, estimate_yaw, reckon
from fovconn_env.kernel.world.camera import feel, list_near, look, muster, see
from fovconn_env.kernel.world.faults import cut, repair, wear
from fovconn_env.kernel.world.kinematics import command, glide, stand, steady
from fovconn_env.kernel.world.operator import NOBODY, steer
from fovconn_env.kernel.world.outcome import connectivity, end, reward, tell, weigh
from fovconn_env.kernel.world.quadrotor import fly, hover
from fovconn_env.kernel.world.radio import address, announce, receive, transmit
from fovconn_env.kernel.world.rangefinder import scan

ADVANCE, BEGIN = range(2)
KINEMATIC, QUADROTOR = range(2)  # scenarios.SWITCHES["dynamics"]
bytes_per_table, bytes_per_beats = kernel(layout.bytes_per_table), kernel(layout.bytes_per_beats)


@entry
def run(task, state, world, scratch, params, actions, mask, warm_ticks, first, last):
    """ADVANCE the worlds first..last-1 by a step of actions (B, N, 4), or BEGIN an episode in the masked (B,) ones.

    Worlds whose episode is over do not advance. Before BEGIN the caller clears a world's records and sets pose (x, y,
    z, yaw), key and max_steps; the estimators then warm up for `warm_ticks`, bodies held, the clock at 0. One entry
    for both, because each entry compiles everything below it.
    """
    p = params[0]
    n, order, who, whom, first_of = state.body.shape[1], scratch.order, scratch.who, scratch.whom, scratch.first
    for b in range(first, last):
        episode = state.episode[b]
        if (task == BEGIN and not mask[b]) or (task == ADVANCE and episode.over):
            continue
        bodies, flights, pairs, infos = state.body[b], state.flight[b], state.pair[b], state.info[b]
        own, sights, inboxes = state.own[b], state.sight[b], state.inbox[b]
        tracks, beliefs, v2 = state.track[b], state.belief[b], state.fiedler[b]
        tables, modes, beats = state.table[b], state.mode[b], state.beat[b]
        piece, vertex, faults = world.piece[b], world.vertex[b], world.fault[b]
        stick_x, stick_y, stick_z = episode.stick_x, episode.stick_y, episode.stick_z
        ticks = p.ticks if task == ADVANCE else warm_ticks
        slots = state.mail.shape[1]  # rounds a message travels
        repeats = slots == 1 and p.loss == 0.0  # a tick's first notes lie in the slot until its last round
        if task == ADVANCE:
            obey(bodies, actions[b], episode, p)
        else:
            episode.leader = p.leader_index
            start(bodies, flights, inboxes, tracks, beliefs, episode.key, p)
        for i in range(infos.shape[0]):
            infos[i].bytes_sent = 0.0

        muster(pairs, who, whom, first_of, p)
        for tick in range(ticks):
            if task == ADVANCE:
                move(bodies, flights, episode, p)
            n_near = list_near(bodies, order, who, whom, first_of[n], scratch.near, p)
            if look(bodies, pairs, scratch.near, n_near, piece, vertex, p):
                muster(pairs, who, whom, first_of, p)
            if task == ADVANCE and faults.shape[0] > 0:
                now = (episode.step * p.ticks + tick + 1) * p.tick
                fail(bodies, flights, pairs, state.mail[b], faults, now, p)
            touch(bodies, piece, vertex, episode, p)
            if tick == ticks - 1:
                episode.n_edges = weigh(pairs, infos, p)
                episode.lambda2 = connectivity(bodies, pairs, v2, scratch.laplacian, scratch.spectrum)
                if p.lambda2 == power_iteration.TRUE:
                    reveal_lambda2(beliefs, episode.lambda2, v2)
            sense(bodies, pairs, own, sights, tracks, who, whom, first_of[n], episode, p)
            for k in range(p.rounds):
                slot = episode.n_rounds % slots
                post, mail, air = state.post[b, slot], state.mail[b, slot], state.air[b, slot]
                beat_air = state.beat_air[b, slot]
                news = (episode.n_rounds - slots) % p.rounds == 0  # the first messages of a tick arrive
                exchange(post, mail, inboxes, tracks, who, whom, first_of[n], news, p)
                if slot == 0 and p.lambda2 == power_iteration.POWER:
                    estimate_lambda2(beliefs, tracks, post, inboxes, whom, first_of, p)
                n_bytes = layout.BYTES_PER_MESSAGE * (p.rounds if repeats else 1)
                if news:
                    listen(beats, beat_air, mail, who, whom, first_of[n])
                if k == 0:
                    for i in range(n):
                        tell_beats(beat_air[i], beats[i], i, episode.n_rounds // p.rounds + 1)
                    n_bytes += bytes_per_beats(n)
                if p.lambda2 == power_iteration.FLOODING:
                    if news:
                        gather(tables, air, mail, who, whom, first_of[n])
                    if k == 0:
                        flood(tables, air, tracks, episode.n_rounds // p.rounds + 1)
                        n_bytes += bytes_per_table(n)
                for i in range(n):
                    announce(post[i], own[i], beliefs[i])
                if k == 0 or not repeats:
                    write(mail, tracks, pairs, infos, who, whom, first_of[n], n_bytes, episode, p)
                episode.n_rounds += 1
            orient(tracks, sights, own, inboxes, who, whom, first_of[n], p)
            if p.relative_yaw != relative_yaw.ESTIMATED:
                override_yaw(bodies, tracks, p)

        if task == ADVANCE:
            episode.step += 1
        else:
            for i in range(infos.shape[0]):
                infos[i].bytes_sent = 0.0  # the warm-up's
        if p.lambda2 == power_iteration.POWER:
            for i in range(n):
                conclude(beliefs[i], n)
        elif p.lambda2 == power_iteration.FLOODING:
            solve_tables(beliefs, tables, modes, scratch, episode.n_rounds // p.rounds, p)
        arrived = steer(bodies[episode.leader], world.waypoint[b], world.n_waypoints[b], world.stick, episode, p)
        own_rows, neighbor_rows = state.own_row[b], state.neighbor_row[b]
        inform(own, tracks, inboxes, beliefs, beats, modes, whom, first_of, own_rows, neighbor_rows, infos, episode, p)
        measure(bodies, piece, vertex, state.range_row[b], episode, p)
        if faults.shape[0] > 0:
            darken(bodies, state.flat[b])
        clip(state.flat[b], world.low, world.high)
        if task == ADVANCE:
            end(episode, arrived, p)
            reward(bodies, infos, state.reward[b], actions[b], episode, stick_x, stick_y, stick_z, p)
        tell(bodies, tracks, beliefs, infos, whom, first_of, episode, p)


@kernel
def start(bodies, flights, inboxes, tracks, beliefs, key, p):
    """Robots stand or hover where they are; estimators know nothing yet."""
    n = bodies.shape[0]
    for i in range(n):
        repair(bodies[i])
        rest(bodies[i], flights[i], p)
        if p.lambda2 == power_iteration.POWER:
            awaken(beliefs[i], 2.0 * random.uniform(random.draw(key, 0, i, random.START)) - 1.0)
        for j in range(n):
            inboxes[i, j].age = p.memory
            tracks[i, j].cos_yaw = tracks[i, j].cos_used = 1.0


@kernel
def rest(body, flight, p):
    """A robot stands or hovers where it is."""
    if p.dynamics == QUADROTOR:
        hover(body, flight, p)
    else:
        stand(body, p)


@kernel
def obey(bodies, actions, episode, p):
    """Turn actions (N, 4) into commands; the stick (m/s, leader's yaw frame) is added to the leader's."""
    for i in range(bodies.shape[0]):
        pull = 1.0 if i == episode.leader else 0.0
        command(bodies[i], actions[i], pull * episode.stick_x, pull * episode.stick_y, pull * episode.stick_z, p)
        if p.dynamics == KINEMATIC:
            steady(bodies[i], p)


@kernel
def move(bodies, flights, episode, p):
    """Move every robot by one tick along its command; a dead one stays where it is."""
    for i in range(bodies.shape[0]):
        if not bodies[i].alive:
            continue
        if p.dynamics == QUADROTOR:
            fly(bodies[i], flights[i], p, episode.key, episode.n_rounds, i)
        else:
            glide(bodies[i], p)


@kernel
def fail(bodies, flights, pairs, mail, faults, now, p):
    """What works at the time `now`, s on the clock; a dead robot is at rest, level. One call: two cost speed."""
    wear(bodies, mail, faults, now)
    cut(bodies, pairs, p)
    for i in range(bodies.shape[0]):
        if not bodies[i].alive:
            rest(bodies[i], flights[i], p)


@kernel
def touch(bodies, piece, vertex, episode, p):
    """Note collisions between robots and with obstacles."""
    for i in range(bodies.shape[0]):
        body = bodies[i]
        body.clearance = clearance(body.x, body.y, body.z, piece, vertex)
        if body.nearest < p.collision_robot or body.clearance < p.collision_obstacle:
            episode.collision = True


@kernel
def sense(bodies, pairs, own, sights, tracks, who, whom, count, episode, p):
    """Odometry, IMU and camera of every robot."""
    n = bodies.shape[0]
    for i in range(n):
        feel(bodies[i], own[i], i, episode.key, episode.n_rounds, p)
        reckon(own[i], p)
    for k in range(count):
        i, j = who[k], whom[k]
        see(bodies[i], bodies[j], pairs[i, j], own[i], sights[i, j], i * n + j, episode.key, episode.n_rounds, p)
        attend(tracks[i, j], sights[i, j], own[i], p)


@kernel
def exchange(post, mail, inboxes, tracks, who, whom, count, news, p):
    """Deliver the messages that arrive in this round, those written longest ago; both ends agree on their link."""
    for k in range(count):
        i, j = who[k], whom[k]
        receive(post[j], mail[j, i], inboxes[i, j], news, p)
        agree(tracks[i, j], mail[i, j], inboxes[i, j], p)


@kernel
def estimate_lambda2(beliefs, tracks, post, inboxes, whom, first, p):
    """On board of every robot: one round of the power iteration."""
    for i in range(beliefs.shape[0]):
        power_round(beliefs[i], tracks[i], post[i], inboxes[i], whom[first[i] : first[i + 1]], p)


@kernel
def listen(beats, air, mail, who, whom, count):
    """On board of every robot: what arrives in this round about who is there."""
    for k in range(count):
        i, j = who[k], whom[k]
        if mail[j, i].arrives:
            hear_beats(beats[i], air[j])


@kernel
def gather(tables, air, mail, who, whom, count):
    """On board of every robot: what is new in the tables that arrive in this round."""
    for k in range(count):
        i, j = who[k], whom[k]
        if mail[j, i].arrives:
            merge(tables[i], air[j])


@kernel
def flood(tables, air, tracks, tick):
    """Every robot enters its links in its table and sends a copy of it with its first messages of a tick."""
    for i in range(tables.shape[0]):
        enter(tables[i], tracks[i], i, tick)
        put(air[i], tables[i])


@kernel
def solve_tables(beliefs, tables, modes, scratch, now, p):
    """On board of every robot: lambda2 and v2 of the team as its table has it in tick `now`."""
    for i in range(beliefs.shape[0]):
        assemble(tables[i], scratch.laplacian, now, p)
        solve(beliefs[i], modes[i], scratch.laplacian, scratch.spectrum, i)


@kernel
def write(mail, tracks, pairs, infos, who, whom, count, n_bytes, episode, p):
    """Every robot writes its notes into the slot just emptied; those that do not go on the air need no text.

    n_bytes: of the messages from one robot to another until it writes again.
    """
    n = pairs.shape[0]
    for k in range(count):
        i, j = who[k], whom[k]
        transmit(mail[i, j], pairs[i, j], i * n + j, episode.key, episode.n_rounds, p)
        if mail[i, j].sent:
            address(mail[i, j], tracks[i, j])
            infos[i].bytes_sent += n_bytes


@kernel
def orient(tracks, sights, own, inboxes, who, whom, count, p):
    """On board of every robot: relative yaw of every robot that it has to do with."""
    for k in range(count):
        i, j = who[k], whom[k]
        estimate_yaw(tracks[i, j], sights[i, j], own[i], inboxes[i, j], p)


@kernel
def reveal_lambda2(beliefs, lambda2, v2):
    """Switch lambda2 = "true": an oracle puts the truth into every robot's belief."""
    for i in range(beliefs.shape[0]):
        know(beliefs[i], lambda2, v2[i], v2.shape[0])


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
def inform(own, tracks, inboxes, beliefs, beats, modes, whom, first, own_rows, neighbor_rows, infos, episode, p):
    """Write what every robot has on board into its observation."""
    for i in range(own.shape[0]):
        there = share_there(beats[i], episode.n_rounds // p.rounds, p)
        leads, known = i == episode.leader and p.leader != NOBODY, whom[first[i] : first[i + 1]]
        observe_self(own_rows[i], own[i], beliefs[i], there, leads, episode.stick_x, episode.stick_y, episode.stick_z)
        dropped = observe_neighbors(neighbor_rows[i], tracks[i], inboxes[i], beliefs[i], modes[i], known, p)
        infos[i].neighbors_dropped = dropped


@kernel
def measure(bodies, piece, vertex, range_rows, episode, p):
    """Write every robot's range points into its observation."""
    for i in range(bodies.shape[0]):
        scan(bodies, i, piece, vertex, range_rows[i], episode.key, episode.n_rounds, p)


@kernel
def darken(bodies, flat):
    """A dead robot observes nothing: zeros."""
    for i in range(bodies.shape[0]):
        if not bodies[i].alive:
            for k in range(flat.shape[1]):
                flat[i, k] = 0.0
