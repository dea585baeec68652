"""The judge and the operator, read again from the truth, step by step. How episodes end is in test_ends.py."""

import math

import numpy as np
import pytest

from fovconn_env.layout import LOST_LINK
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.settings import Airframe, Camera, Course
from fovconn_env.sim.simulator import Simulator
from tests import reference as ref
from tests.helpers import COARSE, few, recorded_actions, small

pytestmark = pytest.mark.nojit

CASES = {
    "kinematic": {},
    "obstacles": {"camera": Camera(occlusion=True)},
    "quadrotor": {"dynamics": "quadrotor", "airframe": Airframe(force_noise=0.3, rotor_noise=0.01)},
}


def build(case, **more):
    obstacles = Map().circle((1.5, 1.0), 0.4).wall((-5.0, 2.0), (-5.0, -2.0), 0.3) if case == "obstacles" else None
    return Simulator(small(n_agents=5, map=obstacles, **CASES[case], **more))


def lost_links(before, after):
    """Causes of what each robot lost in a step, from the pairs before and after: a set a robot."""
    n = len(before)
    causes = [set() for _ in range(n)]
    for i, j in zip(*np.nonzero((before["weight"] > 0) & (after["weight"] == 0)), strict=True):
        if not 1.0 < after["distance"][i, j] < 9.0:
            causes[i].add("range")
        elif after["blocked"][i, j]:
            causes[i].add("occlusion")
        else:
            causes[i].add("own field of view" if before["f_star"][i, j] > 0 else "its field of view")
    return causes


def check_infos(simulator, before):
    state, scenario = simulator.state, simulator.scenario
    infos, pair, episode = state.info[0], state.pair[0], state.episode[0]
    poses, A, found = simulator.poses()[0], simulator.adjacency()[0], set()
    lambda2 = ref.lambda2_v2(A)[0]
    np.testing.assert_allclose(infos["lambda2"], lambda2, rtol=0, atol=1e-9)
    np.testing.assert_allclose(infos["lambda2_hat"], state.belief["lambda2_hat"][0], rtol=0, atol=0)
    assert (infos["connected"] == (lambda2 > scenario.lambda2_min)).all()
    assert (infos["n_edges"] == np.count_nonzero(A) // 2).all()
    gaps = np.linalg.norm(poses[:, None, :3] - poses[None, :, :3], axis=-1) + np.diag(np.full(len(poses), np.inf))
    np.testing.assert_allclose(infos["min_distance"], gaps.min(axis=1), rtol=0, atol=1e-9)
    free = scenario.map.clearance(poses[:, :3]) if scenario.map is not None else np.inf
    np.testing.assert_allclose(infos["clearance"], np.minimum(free, 1e3), rtol=0, atol=1e-6)
    np.testing.assert_allclose(infos["yaw_error"], yaw_errors(state.track[0], poses[:, 3]), rtol=0, atol=1e-9)
    for i, causes in enumerate(lost_links(before, pair)):
        cause = LOST_LINK[int(infos["lost_link_cause"][i])]
        assert cause in (causes or {"none"})
        found.add(cause)
    for name in ("success", "collision", "disconnected"):
        assert (infos[name] == episode[name]).all()
    return found


def yaw_errors(tracks, yaw):
    """Largest error of each robot's valid estimates."""
    hat = np.arctan2(tracks["sin_used"], tracks["cos_used"])
    error = np.abs(ref.wrap(hat - (yaw[None, :] - yaw[:, None])))
    return np.where(tracks["valid"] & tracks["present"] & ~np.eye(len(yaw), dtype=bool), error, 0.0).max(axis=1)


@pytest.mark.parametrize("case", CASES)
def test_infos(case):
    simulator, causes = build(case, patience=1e3, start=small().start, course=Course(settle=0.0)), set()
    for seed in range(few(12, 1)):
        simulator.reset(seed)
        for action in recorded_actions(few(60, 10), 5, seed=seed, size=0.6):
            before = simulator.state.pair[0].copy()
            simulator.step(action)
            causes |= check_infos(simulator, before)
            if simulator.over[0]:
                break
    print(*causes)
    assert len(causes) >= few(4, 1)


# ----------------------------------------------------------------------------------------------------- the ends
@pytest.mark.parametrize("patience", [0.0, 0.3, 1.0, math.inf])
def test_patience(patience):
    """Disconnected: true lambda2 at most lambda2_min at the end of the steps of more than `patience` seconds."""
    simulator = Simulator(small(patience=patience, max_cycles=80, collision_robot=1e-3, **COARSE))
    simulator.reset(3)
    apart = np.zeros((1, 4, 4))
    apart[0, :, 0] = 1.0, -1.0, 0.9, -0.9
    split = 0
    while not simulator.over[0]:
        simulator.step(apart)
        split = 0 if simulator.state.episode["lambda2"][0] > simulator.scenario.lambda2_min else split + 1
        assert simulator.state.episode["disconnected"][0] == (split * 0.05 > patience + 1e-9)
    assert split > 0
    assert simulator.terminated[0] == (patience < 10)
    assert simulator.truncated[0] == (patience > 10)


# ------------------------------------------------------------------------------------------------- the operator
def test_operator_follows_the_course():
    """Waits, pulls straight at the way point, pauses there, and is done at the last one."""
    course = Course(settle=0.5, legs=3, leg=1.0, pause=0.3, goal_radius=0.3)
    simulator = Simulator(small(course=course, patience=math.inf, max_cycles=400, **COARSE))
    simulator.reset(5)
    scenario, state = simulator.scenario, simulator.state
    at, wait, phases = 0, 0.0, []
    still = np.zeros((1, 4, 4))
    for k in range(1, 400):
        if simulator.over[0]:
            break
        simulator.step(still)
        goals, leader = simulator.world.waypoint[0], ref.Pose(simulator.poses()[0, 0, :3], simulator.poses()[0, 0, 3])
        wanted, arrived = np.zeros(3), np.linalg.norm(goals[at] - leader.p) < course.goal_radius
        if k * 0.05 >= course.settle - 1e-9 or (arrived and at == course.legs - 1):
            if arrived:
                at, wait = at + 1, course.pause
            if wait > 1e-9:
                wait -= 0.05
            else:
                away = goals[at] - leader.p
                wanted = scenario.stick_speed * ref.Rz(leader.yaw).T @ away / np.linalg.norm(away)
        stick = np.array([state.episode[f"stick_{axis}"][0] for axis in "xyz"])
        np.testing.assert_allclose(stick, wanted, rtol=0, atol=1e-9)
        phases.append(bool(wanted.any()))
        assert state.episode["success"][0] == (at == course.legs)
    assert state.episode["success"][0]
    assert phases[:8] == [False] * 8
    changes = int(np.abs(np.diff(np.array(phases, int))).sum())
    assert changes == 2 * course.legs  # three pulls, each followed by a pause or the end


def test_leaders_progress():
    """Integrals of v . stick and |stick|^2 over the steps: their ratio is the progress that is reported."""
    simulator = Simulator(small(course=Course(settle=0.0), patience=math.inf))
    simulator.reset(5)
    travelled = pushed = 0.0
    for action in recorded_actions(few(60, 8), 4, size=0.3):
        stick = np.array([simulator.state.episode[f"stick_{axis}"][0] for axis in "xyz"])
        simulator.step(action)
        if simulator.over[0]:
            break
        lead = simulator.state.body[0, 0]
        travelled += 0.05 * stick @ [lead["vx"], lead["vy"], lead["vz"]]
        pushed += 0.05 * stick @ stick
    episode = simulator.state.episode[0]
    assert episode["travelled"] == pytest.approx(travelled, abs=1e-9)
    assert episode["pushed"] == pytest.approx(pushed, abs=1e-9)
    assert pushed > 0
