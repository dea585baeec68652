"""Who may join a flight: each robot once, by its name, of the same version, and with a processor that rounds alike."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

from fovconn_env.errors import SettingError, rule
from fovconn_env.fields import check_texts
from fovconn_env.fleet import frames
from fovconn_env.fleet.canary import canary
from fovconn_env.fleet.frames import Stranger, parse, text_frame
from fovconn_env.fleet.transport import Hub, Link, Lost
from fovconn_env.flights.recording import versions
from fovconn_env.scenarios.presets import scenario
from fovconn_env.scenarios.scenario import ON_BOARD, Scenario

_COMPARED = ("fovconn_env", "kernels")
MOST_NEW, MOST_KINDS = 256, 100  # links whose robot is unknown; kinds of strangers that are told apart


class Member(NamedTuple):
    """A robot that has joined."""

    name: str
    link: Link
    policy: str
    overrides: Mapping[str, Any]  # what its policy needs of the scenario


class Gathering:
    """Lets robots join a flight of a scenario, each at its own name."""

    def __init__(self, base: Scenario, hub: Hub) -> None:
        """Raises `SettingError` for a scenario whose robots know more than they have on board."""
        check_scenario(base)
        self.base, self.hub = base, hub
        self.members: dict[str, Member] = {}
        self.strangers: Counter[str] = Counter()  # what came in and was no robot of this flight, and how often
        self.task: Scenario | None = None  # what is being flown; from then on no policy may need anything else
        self._new: list[Link] = []

    def wait(self, broken_off: Callable[[], bool] = lambda: False, poll: float = 0.1) -> None:
        """Return when all robots have joined, or when `broken_off`, which is asked every `poll`, s."""
        while len(self.members) < self.base.n_agents and not broken_off():
            self.take_in(poll)

    def take_in(self, timeout: float) -> None:
        """Let in who comes within `timeout`, s."""
        link = self.hub.accept(0.0 if self._new else timeout)
        if link is not None:
            self._new.append(link)
        for silent in self._new[:-MOST_NEW]:
            self.drop("a link that says nothing")
            silent.close()
        self._new = self._new[-MOST_NEW:]
        for ready in self.hub.ready(self._new, timeout) if self._new else []:
            self._new.remove(ready)
            self._greet(ready)

    def _greet(self, link: Link) -> None:
        try:
            data = link.receive(0.0)
            if data is None:
                self._new.append(link)  # the rest of its first frame is on its way
                return
            frame = parse(data, frames.MOST_TEXT)
            if frame.kind != frames.HELLO:
                raise Stranger("a frame of somebody who has not said hello")
            member = self._member(frames.content(frame), link)
        except (Stranger, Lost) as problem:
            self.drop(str(problem))
            link.close()
        except SettingError as problem:
            self.drop(str(problem))
            say(link, text_frame(frames.REFUSED, 0, 0, {"reason": str(problem)}))
            link.close()
        else:
            link.name = member.name
            self.members[member.name] = member

    def drop(self, why: str) -> None:
        """Count what came in and was dropped."""
        full = len(self.strangers) >= MOST_KINDS and why not in self.strangers
        self.strangers["others" if full else why] += 1

    def _member(self, told: Mapping[str, Any], link: Link) -> Member:
        """The robot that says these things of itself; raises `SettingError` if it may not join."""
        name, policy, overrides = told.get("robot"), told.get("policy"), told.get("overrides")
        check_texts("robot and policy", [name, policy])
        rule(isinstance(overrides, dict), "overrides", "an object", type(overrides).__name__, "settings by name")
        name, policy, overrides = cast("tuple[str, str, dict[str, Any]]", (name, policy, overrides))
        for field in overrides:
            known = field.partition(".")[0] in ON_BOARD
            rule(known, f"overrides of {name}", f"of {', '.join(ON_BOARD)}", field, "what a robot computes itself")
        agents = self.base.agents
        rule(name in agents, "robot", f"one of {agents[0]} to {agents[-1]}", name, f"{self.base.name} has no other")
        rule(name not in self.members, "robot", "a name of its own", name, "such a robot has joined already")
        given = told.get("versions")
        theirs, ours = given if isinstance(given, dict) else {}, versions()
        for part in _COMPARED:
            rule(theirs.get(part) == ours[part], f"{part} of {name}", ours[part], theirs.get(part), "all fly the same")
        hint = "its processor, or its numba, rounds otherwise than the world's"
        rule(told.get("canary") == canary(), f"canary flight of {name}", canary()[:12], told.get("canary"), hint)
        for other in self.members.values():
            for field in sorted(overrides.keys() & other.overrides.keys()):
                hint = f"{other.name} flies {other.policy}, which needs that"
                same = overrides[field] == other.overrides[field]
                rule(same, f"{field} of {name}", repr(other.overrides[field]), overrides[field], hint)
        equipped = self.equipped(overrides)
        check_scenario(equipped)
        hint = "its team flies already, with other equipment than this policy needs"
        rule(self.task in (None, equipped), f"overrides of {name}", "those of the flight", overrides, hint)
        return Member(name, link, policy, overrides)

    def equipped(self, more: Mapping[str, Any] | None = None) -> Scenario:
        """The scenario with what the policies of its robots need, and with `more`."""
        overrides = {name: value for member in self.members.values() for name, value in member.overrides.items()}
        return scenario(self.task or self.base, **overrides | dict(more or {}))

    def refuse(self, reason: str) -> None:
        """Send everybody away."""
        for link in [*(member.link for member in self.members.values()), *self._new]:
            say(link, text_frame(frames.END, 0, 0, {"reason": reason}))
            link.close()
        self.members, self._new = {}, []
        self.hub.close()


def check_scenario(task: Scenario) -> None:
    """Raise `SettingError` unless robots can fly the scenario by what they have on board."""
    hint = "an oracle flies in the simulator alone"
    rule(task.lambda2 != "true", "Scenario.lambda2", "estimated on board", task.lambda2, hint)
    good = task.relative_yaw == "estimated"
    rule(good, "Scenario.relative_yaw", "'estimated'", task.relative_yaw, "any other flies in the simulator alone")
    hint = f"{task.name} has another, which flies in the simulator alone"
    rule(task.camera.is_ideal, "Scenario.camera", "one that knows who is who and sees at once", "another", hint)


def say(link: Link, frame: bytes) -> None:
    """Send a frame to somebody who may be gone, or not listen."""
    with contextlib.suppress(Lost):
        link.send(frame, wait=False)
