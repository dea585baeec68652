"""`fovconn fleet`."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from fovconn_env import Recorder, Scenario, scenario
from fovconn_env.baselines import find_policy
from fovconn_env.errors import MachineError, closest, rule
from fovconn_env.fleet import Crew, FleetSimulator, Gathering, RealTimeFleet, make_hub
from fovconn_env.fleet.gathering import check_scenario
from fovconn_env.fleet.ros.bridge import Bridge, command_topics
from fovconn_env.fleet.ros.dds import Participant
from fovconn_env.fleet.ros.dds_topics import DdsInbox, DdsSink
from fovconn_env.fleet.ros.foxglove_server import ADDRESS, FoxgloveServer
from fovconn_env.fleet.ros.publisher import Publisher
from fovconn_env.flights.log import Logger, save_log
from fovconn_env.flights.metrics import Meter, compile_ahead
from fovconn_env.flights.recording import outcome
from fovconn_env.flights.rollout import Observer, steps
from fovconn_env.training.commands.options import (
    Foxglove,
    FoxgloveAt,
    RecordFile,
    Replace,
    Settings,
    check_recording,
    parse,
)
from fovconn_env.training.commands.screen import err, measures, out, progress
from fovconn_env.training.evaluation import Evaluation

Policies = Annotated[
    list[str] | None,
    typer.Option(
        "--policy", help="What flies each robot, or one of them: uav_3=follow; repeatable.  [default: expert]"
    ),
]


def command(
    scenario_name: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Scenario id, as fovconn scenarios has them.")
    ],
    policies: Policies = None,
    clock: Annotated[
        Literal["lockstep", "real"], typer.Option(help="As the simulator, bit for bit; or in real time.")
    ] = "lockstep",
    seed: Annotated[int, typer.Option(help="Seed of the flight.", min=0)] = 0,
    transport: Annotated[
        Literal["local", "zenoh", "dds"], typer.Option(help="What carries the messages: sockets, zenoh, or DDS.")
    ] = "local",
    endpoint: Annotated[
        str | None,
        typer.Option(
            help="Where robots connect: unix:PATH or tcp:HOST:PORT; zenoh:LOCATOR; dds:HOST:DOMAIN."
            "  [default: a free one of this machine]"
        ),
    ] = None,
    wait: Annotated[
        list[str] | None, typer.Option("--wait", help="Leave this robot to a `fovconn robot` of yours; repeatable.")
    ] = None,
    on_loss: Annotated[
        Literal["end", "dead"], typer.Option(help="In lockstep: what a robot that is lost does to the flight.")
    ] = "end",
    hold: Annotated[
        float,
        typer.Option(help="In real time: s of silence until a robot hovers. And s that a ROS command lasts.", min=0.0),
    ] = 0.2,
    dead_after: Annotated[float, typer.Option(help="In real time: s of silence until it is dead.", min=0.0)] = 3.0,
    recording_file: RecordFile = None,
    fresh: Replace = False,
    live: Foxglove = False,
    address: FoxgloveAt = None,
    ros: Annotated[
        bool,
        typer.Option("--ros", help="ROS 2 nodes hear the flight, and may fly robots. Always with dds."),
    ] = False,
    domain: Annotated[
        int | None, typer.Option(help="The same, in this ROS domain.  [default: ROS_DOMAIN_ID, or 0]")
    ] = None,
    settings: Settings = None,
) -> None:
    """Fly a team whose robots are processes of their own: a world and N robots, joined by nothing but messages."""
    base = scenario(scenario_name, **parse(settings))
    flown = _policies(base, policies or ["expert"])
    free = _places(base, wait or [])
    check_recording(recording_file, fresh)
    needed_by = "--ros" if ros or domain is not None else "the transport dds"
    with_ros = ros or domain is not None or transport == "dds"
    sink, inbox = _ros(domain, base, needed_by) if with_ros else (None, None)
    hub = make_hub(transport, endpoint)
    gathering = Gathering(base, hub)
    own = {robot: policy for robot, policy in flown.items() if robot not in free}
    plugin = [f"--plugin={base.own.plugin}"] if base.own is not None and base.own.id else []
    program = [sys.executable, "-m", "fovconn_env.training.cli", "robot", *plugin]
    commands = {robot: [*program, robot, "--connect", hub.endpoint, "--policy", own[robot]] for robot in own}
    shown = FoxgloveServer(address or ADDRESS) if live or address is not None else nullcontext()
    with shown as server, Crew(commands, stdout=subprocess.DEVNULL) as crew, _ended(gathering) as world:
        compile_ahead(find_policy(flown[base.agents[0]]), base)  # what measures the flight, too, while robots start
        _gather(gathering, crew, free)
        if clock == "real":
            fleet = RealTimeFleet(gathering, starts=base, hold=hold, dead_after=dead_after)
        else:
            fleet = FleetSimulator(gathering, starts=base, losses_end=on_loss == "end")
        world.append(fleet)
        if server is not None:
            err.print(f"Foxglove: open a connection to ws://{server.address}", highlight=False)
        viewers = [Publisher(each) for each in (server, sink) if each is not None]
        bridge = Bridge(fleet, inbox, hold=hold, drop=gathering.drop) if inbox is not None else None
        _fly(fleet, seed, recording_file, viewers, bridge)
    if recording_file is not None:
        out.print(f"recorded in {recording_file}", highlight=False, soft_wrap=True)


def _policies(base: Scenario, given: Sequence[str]) -> dict[str, str]:
    """What flies each robot; raises for what is no policy, and no robot."""
    flown: dict[str, str] = {}
    for word in given:
        robot, equals, policy = word.partition("=")
        if not equals:
            flown |= dict.fromkeys(base.agents, word)
            continue
        rule(robot in base.agents, "--policy", f"of {base.agents[0]} to {base.agents[-1]}", robot, "NAME=POLICY")
        flown[robot] = policy
    for policy in dict.fromkeys(flown.values()):
        check_scenario(find_policy(policy).equip(base))
    return dict.fromkeys(base.agents, "expert") | flown


def _places(base: Scenario, wait: Sequence[str]) -> list[str]:
    """Names of the robots that somebody else starts."""
    names = [f"uav_{word}" if word.isdecimal() else word for word in wait]
    for word in names:
        rule(word in base.agents, "--wait", "a robot of the team", word, closest(word, base.agents))
    return names


@contextmanager
def _ended(gathering: Gathering) -> Iterator[list[FleetSimulator]]:
    """Whatever happens, every robot is told that the flight is over, and why."""
    flying: list[FleetSimulator] = []
    why = "the flight is over"
    try:
        yield flying
        why = f"the flight ended by {outcome(flying[0])}"
    except BaseException as problem:
        why = str(problem) or type(problem).__name__
        raise
    finally:
        if flying:
            flying[0].end(why)
        else:
            gathering.refuse(why)


def _gather(gathering: Gathering, crew: Crew, free: Sequence[str]) -> None:
    """Wait for all robots; raises `MachineError` if one of ours has ended."""
    for robot in free:
        err.print(f"waiting for: fovconn robot {robot} --connect {gathering.hub.endpoint}", soft_wrap=True)
    with progress() as bar:
        task = bar.add_task("robots join", total=gathering.base.n_agents)

        def broken_off() -> bool:
            bar.update(task, completed=len(gathering.members))
            return bool(crew.ended())

        gathering.wait(broken_off)
        bar.update(task, completed=len(gathering.members))
    for robot, status in crew.ended().items():
        why = "; ".join(gathering.strangers) or "see above"
        raise MachineError(f"{robot} has ended with status {status} before the flight: {why}")


def _ros(domain: int | None, base: Scenario, needed_by: str) -> tuple[DdsSink, DdsInbox]:
    """What ROS 2 nodes hear of a flight, and what they say."""
    participant = Participant(domain, needed_by)
    return DdsSink(participant, base), DdsInbox(participant, command_topics(base))


def _fly(
    fleet: FleetSimulator,
    seed: int,
    recording_file: Path | None,
    viewers: Sequence[Observer],
    bridge: Bridge | None,
) -> None:
    meter, real = Meter(), isinstance(fleet, RealTimeFleet)
    recorder: Any = Logger() if real else Recorder(policies=fleet.policies)
    observers: list[Observer] = [meter, *viewers, *([recorder] if recording_file is not None else [])]
    fleet.reset(seed)
    with progress() as bar:
        task = bar.add_task("flying", total=fleet.max_cycles)
        act = fleet.actions.copy if bridge is None else lambda: bridge.actions(fleet.actions)
        for done, _ in enumerate(steps(fleet, lambda _: act(), observers)):
            bar.update(task, completed=done)
        bar.update(task, total=done, completed=done)
    flown = Evaluation(
        " ".join(dict.fromkeys(fleet.policies)), fleet.scenario, [seed], meter.results(), meter.histograms()
    )
    out.print(measures(flown))
    took = done * fleet.scenario.step_time
    out.print(f"outcome: {outcome(fleet)} after {took:.1f} s, {done} steps", highlight=False)
    if isinstance(fleet, RealTimeFleet):
        kept = fleet.punctuality()
        p50, p99 = 1e3 * kept.answer_p50, 1e3 * kept.answer_p99
        line = f"real-time factor {kept.real_time_factor:.3f}; actions missed {kept.actions_missed:.2%}"
        line += f"; rounds answered {kept.rounds_answered:.2%}, after {p50:.2f} ms (p50), {p99:.2f} ms (p99)"
        out.print(line, highlight=False, soft_wrap=True)
    for robot, count in bridge.flown.items() if bridge is not None else ():
        out.print(f"{robot} was flown from outside in {count} steps", highlight=False)
    for what, count in fleet.strangers.items():
        err.print(f"dropped {count} times: {what}", style="yellow", soft_wrap=True)
    if recording_file is not None:
        if isinstance(fleet, RealTimeFleet):
            values = {name: float(value[0]) for name, value in meter.results().items()} | fleet.punctuality()._asdict()
            finite = {name: value for name, value in values.items() if math.isfinite(value)}
            save_log(recorder.log(tuple(fleet.policies), finite), recording_file)
        else:
            recorder.recording().save(recording_file)
