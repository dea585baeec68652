"""`fovconn play` without a window: keys and sticks, who flies what, handovers without a jump, pace, score."""

import itertools
import math

import numpy as np
import pygame
import pytest

from fovconn_env import Simulator, scenario
from fovconn_env.baselines import POLICIES, load_policy
from fovconn_env.flights.recording import load, replay, state_hash
from fovconn_env.flights.rollout import Observer
from fovconn_env.training.play import gamepad, keyboard
from fovconn_env.training.play.cockpit import Cockpit
from fovconn_env.training.play.handover import Handover
from fovconn_env.training.play.keyboard import FALL, RISE, Keyboard, ramp
from fovconn_env.training.play.pace import MOST, Pace
from fovconn_env.training.play.session import Session
from fovconn_env.training.play.stick import REST, Stick, add_sticks, velocity

STEP = 0.05
QUICK = {"warmup": 0.5, "patience": 1e3}
JUMP = 0.1  # m/s between two steps, the bar


def session(name="LeaderFollow-v0", policy="expert", **changes):
    return Session(name, policy, 3, changes={**QUICK, **changes})


def fly(one, steps, *stick, **names):
    for _ in range(steps):
        one.step(Stick(*stick, **names))
    return one


def commands(one):
    """Commanded velocities (N, 3), m/s, each in its robot's yaw frame."""
    body = one.simulator.state.body[0]
    return np.stack([body[f"command_v{axis}"] for axis in "xyz"], axis=-1)


# ------------------------------------------------------------------------------------------------------------ keyboard
def test_a_held_key_ramps_up_and_back_and_a_tap_is_a_part_of_the_stick():
    keys = Keyboard()
    assert keys.press("w")
    rise = [keys.update(STEP).forward for _ in range(12)]
    assert rise == pytest.approx(np.minimum(STEP / RISE * np.arange(1, 13), 1.0))
    keys.release("w")
    fall = [keys.update(STEP).forward for _ in range(6)]
    assert fall == pytest.approx(np.maximum(1.0 - STEP / FALL * np.arange(1, 7), 0.0), abs=1e-12)
    keys.press("a")
    keys.update(STEP)
    keys.release("a")
    assert 0.0 < keys.update(0.0).left < 0.2
    assert keys.update(1.0) == REST


@pytest.mark.parametrize("parts", [1, 2, 7])
def test_ramps_do_not_depend_on_how_time_is_cut(parts):
    """From one end to the other: the way back takes FALL, the way out RISE."""
    for now, goal, duration in ((1.0, -1.0, 0.5), (0.3, 0.8, 0.1), (0.9, 0.2, 0.1), (-0.5, 1.0, 2.0)):
        cut = now
        for _ in range(parts):
            cut = ramp(cut, goal, duration / parts)
        assert cut == pytest.approx(ramp(now, goal, duration), abs=1e-12)
    assert [ramp(1.0, -1.0, time) for time in (FALL, FALL + RISE)] == pytest.approx([0.0, -1.0], abs=1e-12)


def test_keys_together():
    keys = Keyboard()
    for name in ("up", "w", "shift+a", "q"):
        assert keys.press(name)
    assert keys.update(10.0) == Stick(1.0, 1.0, 0.0, 1.0)
    keys.release("a")  # Shift may be up again by then
    keys.press("s")
    assert keys.update(10.0) == Stick(yaw=1.0), "two keys for one thing count once"
    keys.release_all()
    assert keys.update(10.0) == REST
    assert not keys.press("p")
    assert not keys.press("no such key")


def test_every_key_has_a_name_of_pygames_and_does_one_thing_that_there_is():
    table = [key for keys in keyboard.TABLE.values() for key in keys]
    names = [name for key in table for name in key.names]
    assert len(names) == len(set(names))
    pygame.display.init()
    for name in {name.removeprefix("shift+") for name in names}:
        assert pygame.key.name(pygame.key.key_code(name)).lower() == name
    for does in {key.does for key in (*table, *gamepad.BUTTONS)}:
        assert does in Stick._fields or hasattr(Cockpit, f"do_{does}") or hasattr(Session, does), does
    shown = " ".join(keys for group in keyboard.TABLE for keys, _ in keyboard.rows(group))
    for name in ("W", "↑", "1-9", "Tab, Shift+Tab", "P, Shift+P", "Space", "F1", "Esc"):
        assert name in shown


# ------------------------------------------------------------------------------------------------------------- gamepad
@pytest.mark.parametrize("angle", np.linspace(0, 2 * math.pi, 9))
def test_dead_zone(angle):
    """Still in the middle, no step at its edge, whole at the rim, direction kept."""
    direction = np.array([math.cos(angle), math.sin(angle)])
    assert gamepad.dead_zone(*(gamepad.DEAD - 1e-9) * direction) == (0.0, 0.0)
    for length, wanted in ((gamepad.DEAD + 1e-6, 0.0), (gamepad.FULL, 1.0), (1.4, 1.0)):
        assert gamepad.dead_zone(*length * direction) == pytest.approx(wanted * direction, abs=1e-5)
    for share in np.linspace(0.05, 1.0, 20):
        length = gamepad.DEAD + share * (gamepad.FULL - gamepad.DEAD)
        assert gamepad.dead_zone(*length * direction) == pytest.approx(share * direction)


def test_sticks_together_are_one_stick():
    both = add_sticks(Stick(forward=1.0, yaw=0.8), Stick(left=1.0, yaw=0.8))
    assert both == pytest.approx((math.sqrt(0.5), math.sqrt(0.5), 0.0, 1.0))
    assert velocity(Stick(forward=1.0), 2.0, math.pi / 2) == pytest.approx([0.0, 2.0, 0.0])
    assert velocity(Stick(left=0.5, up=0.5), 1.0, math.pi / 2) == pytest.approx([-0.5, 0.0, 0.5])


# ---------------------------------------------------------------------------------------------------------------- pace
@pytest.mark.parametrize("speed, steps", [(1.0, 200), (0.25, 50), (0.0, 0)])
def test_pace_of_a_computer_that_keeps_up(speed, steps):
    pace = Pace(STEP)
    flown = [pace.due(1 / 60, speed) for _ in range(600)]
    assert abs(sum(flown) - steps) <= 1
    assert max(flown) <= 1
    assert pace.warning == "", "slow motion and a pause are no lag"
    assert pace.rate == pytest.approx(60.0)


def test_the_next_seed_of_a_small_integer_type():
    session = Session("ScaleUp-v0", "expert", np.uint8(255), changes=QUICK)
    assert session.new_seed() == "flight 256"
    assert session.simulator.seeds == [256]


@pytest.mark.parametrize("step, most", [(0.001, 200), (0.05, 4), (0.1, 2), (0.5, 1)])
def test_pace_of_other_clocks(step, most):
    """Short steps make no computer slow, and long ones do not come several at once."""
    pace = Pace(step)
    assert sum(pace.due(1 / 30) for _ in range(300)) == pytest.approx(10.0 / step, abs=1)
    assert pace.warning == ""
    assert max(pace.due(9.0) for _ in range(3)) == most


def test_pace_says_when_it_cannot_keep_up():
    pace = Pace(STEP)
    assert max(pace.due(0.5) for _ in range(20)) == round(MOST / 0.05) == 4
    assert pace.share == pytest.approx(0.4)
    assert pace.warning == "too slow a computer: 0.40 of real time, 2 pictures/s"
    for _ in range(300):
        pace.due(1 / 60)
    assert pace.warning == "", "it is told about the last second"


# ----------------------------------------------------------------------------------------------------------- handovers
def wild(k):
    """A person who throws the stick from one end to the other."""
    axes = (math.copysign(0.57, math.sin(1.7 * k + axis)) for axis in range(3))
    return Stick(*axes, yaw=math.copysign(1.0, k % 7 - 3))


CHANGES = {
    "take a follower": lambda one: one.fly(2),
    "another": lambda one: one.fly(4),
    "it leads": lambda one: one.lead(),
    "the first leader": lambda one: one.fly(0),
    "back to the policy": lambda one: one.hands_off(),
    "take the leader": lambda one: one.fly(4),
    "to the script": lambda one: one.hands_off(),
    "no script": lambda one: one.script(),
    "the script again": lambda one: one.script(),
    "leader again": lambda one: one.fly(4),
    "a gamepad is gone": lambda one: one.release(),
}


def jump(one, stick):
    """Step; the greatest change of a commanded velocity of robots that are handed over, m/s."""
    before, handed = commands(one), one.handover.active.copy()
    one.step(stick)
    assert not one.over
    return (np.linalg.norm(commands(one) - before, axis=1) * handed).max()


def jumps(one):
    """The greatest jump after each change."""
    fly(one, 40, forward=1.0)
    for number, (name, change) in enumerate(CHANGES.items()):
        change(one)
        assert one.handover.active.any(), name
        yield max(jump(one, REST if "gone" in name else wild(number)) for _ in range(30))


@pytest.mark.parametrize("name", ["LeaderFollow-v0", "LeaderAggressive-v0", "TiltDynamics-v0"])
@pytest.mark.parametrize("policy", POLICIES)
def test_no_handover_makes_a_command_jump(policy, name):
    """Taken over, given back, leading or not: at most 0.1 m/s between steps, with every policy and a wild stick."""
    found = dict(zip(CHANGES, jumps(session(name, policy, collision_robot=0.01)), strict=True))
    assert max(found.values()) <= JUMP, found
    assert max(found.values()) > 0.05, "they do change hands"


def test_without_rate_limits_they_would_jump(monkeypatch):
    monkeypatch.setattr(Handover, "limit_rates", lambda *_: None)
    assert max(jumps(session(collision_robot=0.01))) > 1.0


def test_a_change_of_policy_in_flight_is_no_jump_either():
    one = fly(session(policy="recovery"), 40, forward=1.0)
    for direction, name in ((-1, "augmented"), (1, "recovery")):
        one.next_policy(direction)
        while one.policy != name:
            one.next_policy(direction)
        assert max(jump(one, Stick(left=1.0)) for _ in range(20)) <= JUMP


def test_a_handover_ends():
    one = session()
    one.fly(3)
    fly(one, 60, forward=1.0)
    assert not one.handover.active.any()
    assert commands(one)[3] == pytest.approx([one.scenario.speed_limit, 0.0, 0.0])
    one.hands_off()
    assert not fly(one, 60).handover.active.any()


# ------------------------------------------------------------------------------------------------------------- session
def test_the_person_flies_one_and_the_policy_the_others():
    """The follower does what the stick says and nothing else; the others do what the policy says, bit for bit."""
    one = session()
    one.fly(2)
    for k in range(50):
        actions = one._policy.act(one.simulator.observations)[0].astype(float)
        one.step(Stick(forward=0.5, up=0.2, yaw=-0.3))
        if k > 40:
            assert commands(one)[2] == pytest.approx([0.75, 0.0, 0.3])
            assert one.simulator.state.body["command_yaw_rate"][0, 2] == pytest.approx(-0.3)
            top = one.scenario.speed_limit + one.scenario.stick_speed
            assert commands(one)[3] == pytest.approx(actions[3, :3] * top, abs=1e-6)
    assert one.leader == 0
    assert one.speed == pytest.approx(math.hypot(0.75, 0.3))


def test_the_script_pulls_as_the_scenario_does():
    """Hands off from the beginning is the flight that nobody plays: the same bits."""
    one = session(patience=0.0)
    one.hands_off()
    one.handover.active[:] = False
    plain = Simulator(scenario("LeaderFollow-v0", **{**QUICK, "patience": 0.0}))
    plain.reset(3)
    policy = load_policy("expert", plain)
    for _ in range(200):
        one.step()
        plain.step(policy.act(plain.observations))
        assert np.array_equal(one.simulator.poses(), plain.poses())
    assert one.score().progress > 0.5
    one.script()
    fly(one, 80)
    assert not any(one.simulator.state.episode[f"stick_{axis}"][0] for axis in "xyz")


def test_sentences_about_who_flies():
    one = session(n_agents=3)
    assert one.fly(7) == "there are 3 robots"
    assert one.lead() == "take over another robot (1-9); then it can lead"
    assert [one.fly(1), one.fly(1)] == ["you fly robot 2", "you fly robot 2 already"]
    assert one.lead() == "robot 2 leads"
    one.step()
    assert (one.leader, one.full_stick) == (1, 1.0)
    for step, robot in ((1, 3), (1, 1), (-1, 3)):
        assert one.next_robot(step) == f"you fly robot {robot}"
    assert one.full_stick == 1.5
    hands_off = [one.hands_off(), one.hands_off()]
    assert hands_off == ["robot 3 is handed back to expert", "you fly none; 1-9 takes one over"]
    assert one.next_robot(1) == "you fly robot 1"
    one.simulator.state.body["alive"][0, 1] = False
    assert one.fly(1) == "robot 2 is down"
    assert one.next_robot(1) == "you fly robot 3"
    one.again()
    assert (one.leader, one.flown) == (0, 0)


def test_a_scenario_without_leader():
    one = session("Regroup-v0")
    assert (one.led, one.flown) == (False, None)
    assert one.lead() == one.script() == "Regroup-v0 has no leader"
    fly(one, 1, forward=1.0)
    assert one.fly(0) == "you fly robot 1"
    assert fly(one, 40, forward=1.0).speed == pytest.approx(1.5)
    assert math.isnan(one.score().progress)


def test_the_goal_is_told_and_how_far_it_is():
    one = session()
    simulator = one.simulator
    place = np.array([*simulator.world.waypoint[0, 2], 0.0])
    simulator.state.episode["waypoint"] = 2
    for axis, value in zip("xyz", place - [0.0, 3.0, 0.0, 0.0], strict=False):
        simulator.state.body[axis][0, 0] = value
    assert one.goal() == "goal: leader to star 3, 3.0 m away   the team together"
    free = session("Regroup-v0")
    free.simulator.state.episode["held"] = 1.25
    assert free.goal() == "goal: hold λ₂ at 1 or more, 1.2 of 5 s"


def test_policies_and_scenarios_in_turn():
    one = fly(session(n_agents=3), 1)
    policies, names = [one.policy], [one.scenario.name]
    for _ in range(len(POLICIES)):
        one.next_policy(1)
        policies.append(fly(one, 1).policy)
    assert set(policies) == set(POLICIES)
    assert policies[0] == policies[-1]
    for _ in range(4):
        one.next_scenario(-1)
        names.append(fly(one, 1, forward=1.0).scenario.name)
    assert len(set(names)) == 5
    assert one.scenario.n_agents == 3, "settings stay"


def test_a_flight_ends_with_a_score():
    one = session(max_cycles=60)
    while not one.over:
        fly(one, 1, forward=0.5)
    score = one.score()
    assert (score.outcome, score.time, score.kept) == ("time", pytest.approx(3.0), 1.0)
    assert 0.0 < score.least_lambda2 < 6.0
    assert fly(one, 1, forward=1.0).steps == 60
    assert one.again() == "flight 3 from its start"
    assert (one.steps, one.over) == (0, False)
    assert one.new_seed() == "flight 4"


def test_observers_look_on_at_every_flight():
    class Seen(Observer):
        flights, steps = 0, 0

        def begin(self, simulator):
            self.flights += 1

        def update(self):
            self.steps += 1

    one = Session("LeaderFollow-v0", "expert", 3, changes=QUICK, observers=[seen := Seen()])
    fly(one, 3)
    assert (seen.flights, seen.steps) == (1, 3)
    one.again()
    fly(one, 2)
    one.next_scenario(1)
    assert (seen.flights, seen.steps) == (3, 5)


def test_recordings(tmp_path):
    """Each flight has a file of its own, which flies again to the same bits; nothing flown is lost."""
    with pytest.raises(ValueError, match=r"must name a file in \.npz"):
        Session(record=tmp_path / "mine.txt")
    file = tmp_path / "mine.npz"
    one = Session("TiltDynamics-v0", seed=5, changes={**QUICK, "max_cycles": 50, "n_agents": 4}, record=file)
    for k in itertools.count():
        if k == 20:
            one.fly(2)
        if k == 30:
            one.lead()
        one.step(wild(k // 5), heading=0.3)
        if one.over:
            break
    hashes = [state_hash(one.simulator)]
    (tmp_path / "mine-2.npz").write_text("of another session")
    one.new_seed()
    fly(one, 7, forward=1.0)
    hashes.append(state_hash(one.simulator))
    one.next_scenario(1)
    assert one.save() is None, "nothing was flown yet"
    assert one.files == [file, tmp_path / "mine-3.npz"]
    assert (tmp_path / "mine-2.npz").read_text() == "of another session"
    first, second = map(load, one.files)
    assert [state_hash(replay(recording)) for recording in (first, second)] == hashes
    assert (first.policies[0], first.policies[2], first.policies[3]) == ("expert, human", "expert, human", "expert")
    assert (first.outcome, second.outcome, len(second.actions)) == ("time", "unfinished", 7)
    assert first.leaders[[0, -1]].tolist() == [0, 2]
