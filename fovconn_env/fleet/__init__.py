"""Robots as processes of their own: a world, robots, and the links between them (docs/fleet.md).

A `Gathering` lets robots in at a hub, which `make_hub` makes; a `FleetSimulator` or a `RealTimeFleet` then flies them,
as any simulator.
A `Robot` is one of them, at the other end of a link.
"""

from fovconn_env.fleet.crew import Crew
from fovconn_env.fleet.gathering import Gathering, Member
from fovconn_env.fleet.local_link import LocalHub
from fovconn_env.fleet.realtime import Punctuality, RealTimeFleet
from fovconn_env.fleet.robot import Ended, Refused, Robot
from fovconn_env.fleet.transport import Hub, Link, Lost, connect, make_hub
from fovconn_env.fleet.world import FleetSimulator, RobotLost

__all__ = [
    "Crew",
    "Ended",
    "FleetSimulator",
    "Gathering",
    "Hub",
    "Link",
    "LocalHub",
    "Lost",
    "Member",
    "Punctuality",
    "RealTimeFleet",
    "Refused",
    "Robot",
    "RobotLost",
    "connect",
    "make_hub",
]
