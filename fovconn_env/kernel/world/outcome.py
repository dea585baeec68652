"""Outcome: true weights and lambda2, termination, rewards and infos. No robot reads any of it."""

from __future__ import annotations

import math

from fovconn_env.kernel.jit import kernel
from fovconn_env.kernel.maths.spectrum import fiedler
from fovconn_env.kernel.maths.weights import range_weight, sight_weight
from fovconn_env.kernel.world.faults import count_living
from fovconn_env.kernel.world.operator import NOBODY
from fovconn_env.layout import LOST_LINK

RANGE = LOST_LINK.index("range")
OWN_VIEW, ITS_VIEW = LOST_LINK.index("own field of view"), LOST_LINK.index("its field of view")
OCCLUSION, FAULT = LOST_LINK.index("occlusion"), LOST_LINK.index("fault")


@kernel
def update_true_weights(pairs, infos, row, col, p):
    """True f*_ij (10) and A_ij (6), (11) of all pairs; infos get why links were lost. Returns the number of links.

    row, col: the contacts of `build_contacts`; other pairs have no link, and had none at the end of the last step.
    """
    n_edges = 0
    for i in range(infos.shape[0]):
        infos[i].lost_link_cause = 0.0
    for k in range(row.shape[0]):
        i, j = row[k], col[k]
        if i > j:
            continue
        ij, ji = pairs[i, j], pairs[j, i]
        before, seen_by_i, seen_by_j = ij.weight, ij.f_star > 0.0, ji.f_star > 0.0
        ij.f_star = sight_weight(ij.cosine, p) if ij.seen else 0.0
        ji.f_star = sight_weight(ji.cosine, p) if ji.seen else 0.0
        view = ij.f_star + ji.f_star - ij.f_star * ji.f_star  # (11), whatever weight the robots use
        ij.weight = ji.weight = range_weight(ij.distance, p) * view if view > 0.0 else 0.0  # (6)
        if ij.weight > 0.0:
            n_edges += 1
        elif before > 0.0:
            infos[i].lost_link_cause = lost_link(ij, OWN_VIEW if seen_by_i else ITS_VIEW, p)
            infos[j].lost_link_cause = lost_link(ij, OWN_VIEW if seen_by_j else ITS_VIEW, p)
    return n_edges


@kernel
def lost_link(pair, view, p):
    """Cause of a lost link: RANGE, FAULT or OCCLUSION, else `view`, which names the camera that turned away."""
    if not p.d_min < pair.distance < p.d_max:
        return RANGE
    if pair.broken:
        return FAULT
    return OCCLUSION if pair.blocked else view


@kernel
def build_true_laplacian(laplacian, pairs, row, col):
    """Laplacian (N, N) of the weights of `update_true_weights`, with the same contacts."""
    n = laplacian.shape[0]
    for i in range(n):
        for j in range(n):
            laplacian[i, j] = 0.0
    for k in range(row.shape[0]):
        i, j = row[k], col[k]
        laplacian[i, i] += pairs[i, j].weight
        laplacian[i, j] = -pairs[i, j].weight


@kernel
def true_lambda2(bodies, v2, laplacian, scratch):
    """True lambda2 of the living robots, from `build_true_laplacian`; v2 (N,) gets the unit eigenvector.

    v2 is 0 for the dead, lambda2 of fewer than two is 0. The rest is scratch.
    """
    n = v2.shape[0]
    living = count_living(bodies)
    if living < n:
        isolate_dead(bodies, v2, laplacian)
    lambda2 = fiedler(laplacian, v2, scratch) if living > 1 else 0.0
    if living < n:
        isolate_dead(bodies, v2, laplacian)  # rounding errors in v2
    return lambda2


@kernel
def isolate_dead(bodies, v2, laplacian):
    """Mark dead robots as isolated for `fiedler`: diagonal -1, v2 entry 0; with fewer than two alive, every robot."""
    alone = count_living(bodies) < 2
    for i in range(v2.shape[0]):
        if alone or not bodies[i].alive:
            laplacian[i, i], v2[i] = -1.0, 0.0


@kernel
def check_termination(episode, arrived, p):
    """Termination and truncation, from the true lambda2 and the collisions detected in this step."""
    dt, connected = p.step_time, episode.lambda2 > p.lambda2_min
    episode.split = 0.0 if connected else episode.split + dt
    if p.leader == NOBODY:
        episode.held = episode.held + dt if episode.lambda2 >= p.goal_lambda2 else 0.0
        episode.success = episode.held > 0.0 and episode.held >= p.goal_hold - 1e-9
    else:
        episode.success = arrived
    episode.disconnected = episode.split > p.patience + 1e-9
    episode.success = episode.success and connected and not episode.collision
    episode.terminated = episode.collision or episode.disconnected or episode.success
    episode.truncated = episode.step >= episode.max_steps and not episode.terminated
    episode.over = episode.terminated or episode.truncated


@kernel
def write_rewards(bodies, infos, rewards, actions, episode, stick, p):
    """Named reward terms of every robot and their sum; running terms are rates times the step.

    stick: (x, y, z), m/s, leader's yaw frame, of this step.
    """
    lead, dt = bodies[episode.leader], p.step_time
    margin = (episode.lambda2 - p.lambda2_min) / (p.lambda2_max - p.lambda2_min)
    stick_x, stick_y, stick_z = stick
    along = lead.vx * stick_x + lead.vy * stick_y + lead.vz * stick_z
    pushed = stick_x * stick_x + stick_y * stick_y + stick_z * stick_z
    episode.pushed += dt * pushed
    episode.travelled += dt * along
    for i in range(bodies.shape[0]):
        info, effort = infos[i], 0.0
        for k in range(4):
            share = min(max(actions[i, k], -1.0), 1.0)
            effort += share * share
        works = 1.0 if bodies[i].alive else 0.0  # a dead robot neither acts nor chose where it is
        info.reward_connectivity = p.reward_connectivity * dt * min(max(margin, 0.0), 1.0)
        info.reward_progress = p.reward_progress * dt * along / (p.stick_speed * p.stick_speed) if pushed > 0.0 else 0.0
        info.reward_proximity = -p.reward_proximity * dt * crowding(bodies[i], p) * works
        info.reward_effort = -p.reward_effort * dt * effort * works
        info.reward_success = p.reward_success if episode.success else 0.0
        info.reward_collision = -p.reward_collision if episode.collision else 0.0
        info.reward_disconnected = -p.reward_disconnected if episode.disconnected else 0.0
        running = info.reward_connectivity + info.reward_progress + info.reward_proximity + info.reward_effort
        rewards[i] = running + info.reward_success + info.reward_collision + info.reward_disconnected


@kernel
def crowding(body, p):
    """How much closer than `near` the nearest surface is, squared, 0 to 1."""
    distance = min(body.nearest - 0.5 * p.collision_robot, body.clearance)
    return min(max(1.0 - distance / p.reward_near, 0.0), 1.0) ** 2


@kernel
def write_infos(bodies, peers, beliefs, infos, col, indptr, episode, p):
    """Write the infos that are not reward terms, causes of lost links, bytes or dropped rows."""
    n = bodies.shape[0]
    for i in range(n):
        info = infos[i]
        info.lambda2, info.lambda2_hat = episode.lambda2, beliefs[i].lambda2_hat if bodies[i].alive else 0.0
        info.alive = 1.0 if bodies[i].alive else 0.0
        info.connected = 1.0 if episode.lambda2 > p.lambda2_min else 0.0
        info.n_edges = episode.n_edges
        info.min_distance, info.clearance = bodies[i].nearest, min(bodies[i].clearance, 1e3)
        largest = 0.0
        for j in col[indptr[i] : indptr[i + 1]]:
            track = peers[i, j].track
            if track.present and track.valid:
                largest = max(largest, yaw_error(bodies[i], bodies[j], track))
        info.yaw_error = 2.0 * math.atan(largest)
        info.success = 1.0 if episode.success else 0.0
        info.collision = 1.0 if episode.collision else 0.0
        info.disconnected = 1.0 if episode.disconnected else 0.0


@kernel
def yaw_error(a, b, track):
    """Tangent of half the error of the estimated relative yaw of b seen from a, at least 0 (1e9 at pi)."""
    c, s = a.cos_yaw * b.cos_yaw + a.sin_yaw * b.sin_yaw, a.cos_yaw * b.sin_yaw - a.sin_yaw * b.cos_yaw
    cos_error, sin_error = track.cos_used * c + track.sin_used * s, track.sin_used * c - track.cos_used * s
    return abs(sin_error) / max(1.0 + cos_error, 1e-9)


@kernel
def count_swaps(blobs):
    """How many names a robot has in this tick passed on to something else than the robot that they are of."""
    swaps = 0
    for blob in blobs:
        wrong = blob.used and blob.name >= 0 and blob.name != blob.code
        swaps += wrong and not blob.wrong
        blob.wrong = wrong
    return swaps
