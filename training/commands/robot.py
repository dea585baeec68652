"""`fovconn robot`."""

from __future__ import annotations

from typing import Annotated

import typer

from fovconn_env.baselines import find_policy
from fovconn_env.errors import missing_package
from fovconn_env.fleet import Robot, connect
from fovconn_env.fleet.robot import PolicyKind
from fovconn_env.training.commands.options import PolicyName
from fovconn_env.training.commands.screen import out

JOIN = 10.0  # s, in which a world must answer


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Which robot of the team, e.g. uav_3.")],
    endpoint: Annotated[str, typer.Option("--connect", help="Where the world is, as fovconn fleet prints it.")],
    policy: PolicyName = "expert",
    person: Annotated[
        bool, typer.Option("--person", help="Fly it yourself: a window with what the robot knows, keys as in play.")
    ] = False,
) -> None:
    """Fly one robot of a fleet, in this process: its sensors, what it hears, and a policy, or you."""
    kind = _person() if person else find_policy(policy)
    ended = Robot(name, kind, connect(endpoint, JOIN)).fly()
    out.print(f"{name}: {ended.reason}, after {ended.steps} actions", soft_wrap=True)


def _person() -> PolicyKind:
    try:
        from fovconn_env.training.play.person import Person
    except ImportError as missing:
        raise missing_package("robot --person", missing) or missing from missing
    return Person
