"""What a recording must keep, whether it was flown or read from a file. Raises `SettingError`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from fovconn_env.errors import rule
from fovconn_env.fields import check_array, check_texts, check_whole
from fovconn_env.flights.state_hash import FORMATS
from fovconn_env.scenarios.params import SWITCHES
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.seeds import MAX_SEED

OUTCOMES = ("success", "collision", "disconnected", "time", "unfinished")
_LEADERS = (*SWITCHES["leader"], "recorded")
_DIGITS = 64  # of a SHA-256
_MOST_VERSIONS = 64


def check_recording(recording: Any) -> None:
    """Check a `Recording`, whose module imports this one."""
    task, n = recording.scenario, recording.scenario.n_agents
    rule(recording.starts.n_agents == n, "starts.n_agents", f"{n}", recording.starts.n_agents, "one team flies")
    check_whole("seed", recording.seed, 0, MAX_SEED, "of the episode")
    check_array("actions", recording.actions, "f8", (-1, n, 4))
    steps = len(recording.actions)
    rule(steps <= task.max_cycles, "actions", f"of at most {task.max_cycles} steps", steps, "Scenario.max_cycles")
    check_array("sticks", recording.sticks, "f8", (steps, 3))
    if recording.poses is not None:
        check_array("poses", recording.poses, "f8", (n, 4))
    check_texts("policies", recording.policies, (0, n))
    check_versions(recording.versions)
    check_outcome(recording.outcome, task)
    hint = "is it of a newer fovconn_env?"
    check_whole("hash_format", recording.hash_format, FORMATS[0], FORMATS[-1], hint)
    _check_events(recording.events, steps, n)
    _check_hashes(recording.hashes, steps)


def check_outcome(outcome: Any, scenario: Scenario) -> None:
    """How a flight ended must be one of `OUTCOMES`, or where own functions end flights a text."""
    if scenario.own is not None and scenario.own.termination is not None:
        check_texts("outcome", [outcome])
        return
    rule(outcome in OUTCOMES, "outcome", f"one of {', '.join(OUTCOMES)}", outcome, "how it ended")


def check_versions(versions: Any) -> None:
    """Versions must be texts by name."""
    rule(isinstance(versions, dict), "versions", "an object", type(versions).__name__, "a package and its version")
    rule(len(versions) <= _MOST_VERSIONS, "versions", f"at most {_MOST_VERSIONS}", len(versions), "a flight has seven")
    check_texts("versions", [*versions, *versions.values()])


def _check_events(events: Sequence[Any], steps: int, n_agents: int) -> None:
    rule(len(events) <= steps, "events", f"at most {steps}", len(events), "one a step")
    for k, (step, robot, kind) in enumerate(events):
        check_whole(f"events[{k}].step", step, 0, steps - 1, "before which step of the flight")
        check_whole(f"events[{k}].robot", robot, 0, n_agents - 1, "robots are counted from 0")
        known = isinstance(kind, str) and kind in _LEADERS
        rule(known, f"events[{k}].kind", f"one of {', '.join(_LEADERS)}", kind, "what moves the stick")
    _check_order("events", [event[0] for event in events])


def _check_hashes(hashes: Sequence[Any], steps: int) -> None:
    rule(1 <= len(hashes) <= steps + 1, "hashes", f"1 to {steps + 1}", len(hashes), "of the start and the last state")
    for k, (step, digest) in enumerate(hashes):
        check_whole(f"hashes[{k}].step", step, 0, steps, "after which step of the flight")
        fine = isinstance(digest, str) and len(digest) == _DIGITS and set(digest) <= set("0123456789abcdef")
        rule(fine, f"hashes[{k}]", f"{_DIGITS} hexadecimal digits", digest, "a SHA-256")
    places = [step for step, _ in hashes]
    ends = [places[0], places[-1]]
    rule(ends == [0, steps], "hashes", f"those of step 0 to step {steps}", ends, "of the start and the last state")
    _check_order("hashes", places)


def _check_order(name: str, steps: Sequence[int]) -> None:
    falls = [step for before, step in itertools.pairwise(steps) if step <= before]
    rule(not falls, name, "in the order of their steps, one each", falls[:1], "a flight goes forward")
