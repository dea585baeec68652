"""What the settings of a scenario must keep together; `scenario` is a `Scenario`, whose module imports this one.

Every check raises `SettingError` for a setting that does not fit the others.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fovconn_env.bounds import check_order
from fovconn_env.errors import SettingTypeError, closest, rule, shown
from fovconn_env.maps.corridor import Corridor
from fovconn_env.maps.forest import Forest
from fovconn_env.maps.obstacles import Map
from fovconn_env.scenarios.leader import Recorded
from fovconn_env.scenarios.params import SWITCHES
from fovconn_env.scenarios.settings import Fault
from fovconn_env.scenarios.sizes import MAX_WORLD_BYTES, world_bytes

NAME_LENGTH = 100  # characters
MAX_WARM_TICKS = 60_000  # of a reset
MAX_SUBSTEPS = 20_000  # of a step
MAX_FLOODED = 128  # robots; each solves the eigenproblem of the whole team in every step


def check_scenario(scenario: Any) -> None:
    """All checks, in the order of the settings; the numbers keep their own bounds already."""
    check_words(scenario)
    check_team(scenario)
    check_heights(scenario)
    check_times(scenario)
    check_camera(scenario)
    check_faults(scenario)
    check_map(scenario)
    size = world_bytes(scenario)
    hint = "lower n_agents, radio.delay, max_neighbors or max_ranges, or simplify the map"
    rule(size <= MAX_WORLD_BYTES, "Scenario", f"of at most {MAX_WORLD_BYTES} bytes a world", size, hint)


def check_words(scenario: Any) -> None:
    """The name, and the words of the switches."""
    name = scenario.name
    valid = isinstance(name, str) and name.isprintable() and 0 < len(name) <= NAME_LENGTH
    says, hint = f"a text of 1 to {NAME_LENGTH} printable characters", "it is shown in tables and titles"
    rule(valid, "Scenario.name", says, name, hint)
    for switch, words in SWITCHES.items():
        value = getattr(scenario, switch)
        if switch == "leader" and isinstance(value, Recorded):
            speed = float(np.linalg.norm(value.sticks, axis=1).max(initial=0.0))
            says, hint = f"at most stick_speed ({scenario.stick_speed:g})", "m/s; raise Scenario.stick_speed"
            rule(speed <= scenario.stick_speed * (1 + 1e-6), "Recorded.sticks", says, speed, hint)
            continue
        if not (isinstance(value, str) and value in words):
            rule(False, f"Scenario.{switch}", "one of " + ", ".join(words), value, closest(value, words))


def check_team(scenario: Any) -> None:
    """Who leads, when the team counts as split, and that robots may be as close as they start."""
    n = scenario.n_agents
    hint = "robots are counted from 0"
    rule(scenario.leader_index < n, "Scenario.leader_index", f"in 0..{n - 1}", scenario.leader_index, hint)
    hint = "each robot solves the eigenproblem of the whole team in every step"
    few = scenario.lambda2 != "flooding" or n <= MAX_FLOODED
    rule(few, "Scenario.n_agents", f'at most {MAX_FLOODED} with lambda2="flooding"', n, hint)
    hint = "lambda2_min is where the team counts as split, lambda2_max where more links stop to matter"
    check_order(scenario, "lambda2_min", "lambda2_max", hint)
    spacing, apart = scenario.start.spacing, scenario.collision_robot
    hint = "robots would collide before they may meet"
    rule(spacing > apart, "Start.spacing", f"above collision_robot ({apart:g})", spacing, hint)


def check_heights(scenario: Any) -> None:
    """Robots can start between floor and ceiling."""
    (low, high), half, margin = scenario.heights, scenario.start.box[2] / 2, scenario.margin
    floor, ceiling = scenario.floor, scenario.ceiling
    hint = f"robots start between them, {margin:g} m from both (Start.clearance)"
    rule(low <= high, "Scenario.floor", f"{2 * margin:g} m below ceiling ({ceiling})", floor, hint)
    hint = f"z = 0 is the middle of Start.box, whose robots start {margin:g} m away (Start.clearance)"
    rule(low <= half, "Scenario.floor", f"at most {half - margin:g}", floor, hint)
    rule(high >= -half, "Scenario.ceiling", f"at least {margin - half:g}", ceiling, hint)


def check_times(scenario: Any) -> None:
    """Estimators that are stable with the tick, and the number of ticks and substeps in a reset and in a step."""
    tick, ticks, substep = scenario.clock.tick, scenario.clock.ticks, scenario.airframe.substep
    for name in ("k2", "k3"):
        gain, hint = getattr(scenario.yaw, name), "a correction above 2 / Clock.tick diverges"
        rule(gain * tick <= 2, f"YawEstimator.{name}", f"at most {2 / tick:g}", gain, hint)
    turn, hint = scenario.yaw_rate_limit, "robots turn by a radian a tick at most; lower Clock.tick"
    rule(turn * tick <= 1, "Scenario.yaw_rate_limit", f"at most {1 / tick:g}", turn, hint)
    most, hint = MAX_WARM_TICKS * tick, f"a reset takes {MAX_WARM_TICKS} ticks at most"
    rule(scenario.warmup <= most, "Scenario.warmup", f"at most {most:g}", scenario.warmup, hint)
    least, hint = ticks * tick / MAX_SUBSTEPS, f"a step takes {MAX_SUBSTEPS} of them at most"
    rule(substep >= least, "Airframe.substep", f"at least {least:g}", substep, hint)


def check_camera(scenario: Any) -> None:
    """Chances from frame to frame that are at most 1."""
    camera, frame_time = scenario.camera, scenario.camera.frame_time(scenario.clock.tick)
    hint = f"one a frame at most, and a frame takes {frame_time:g} s"
    rate = camera.false_rate
    rule(rate * frame_time <= 1, "Camera.false_rate", f"at most {1 / frame_time:g}", rate, hint)
    if camera.burst and camera.miss not in (0.0, 1.0):
        least = frame_time * max(camera.miss / (1 - camera.miss), 1.0)
        hint = f"a frame takes {frame_time:g} s, and a share of {camera.miss:g} is missed"
        rule(camera.burst >= least, "Camera.burst", f"0 or at least {least:g}", camera.burst, hint)


def check_faults(scenario: Any) -> None:
    """A tuple of faults of robots that there are."""
    faults = scenario.faults
    if not isinstance(faults, (tuple, list)) or not all(isinstance(fault, Fault) for fault in faults):
        hint = "write faults=(Fault(...),)"
        raise SettingTypeError(f"Scenario.faults must be a tuple of Faults, got {shown(faults)}: {hint}")
    for k, fault in enumerate(faults):
        inside, says = fault.robot is None or fault.robot < scenario.n_agents, f"in 0..{scenario.n_agents - 1}"
        rule(inside, f"Scenario.faults[{k}].robot", says, fault.robot, "robots are counted from 0")


def check_map(scenario: Any) -> None:
    """A map, and a leader for a corridor."""
    if not isinstance(scenario.map, (Map, Forest, Corridor, type(None))):
        says, hint = "a Map, a Forest, a Corridor or None", "a file, .json or .svg, goes through Map.from_file"
        raise SettingTypeError(f"Scenario.map must be {says}, got {shown(scenario.map)}: {hint}")
    if isinstance(scenario.map, Corridor):
        hint = "a Corridor stands across the second leg of the leader's course"
        rule(scenario.leader != "none", "Scenario.leader", "any but none with a Corridor", scenario.leader, hint)
        rule(scenario.course.legs >= 2, "Course.legs", "at least 2 with a Corridor", scenario.course.legs, hint)
