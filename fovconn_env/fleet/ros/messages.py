"""What is known of a flight as ROS 2 messages: what each robot knows, and under /truth what only viewers may see.

    /uav_0/observation     fovconn_msgs/Observation         all that the robot's policy gets
    /uav_0/lambda2_hat     std_msgs/Float64                 its estimate
    /uav_0/bearings        visualization_msgs/Marker        to its neighbours, of that: as it measures or is told
    /uav_0/ranges          sensor_msgs/PointCloud2          of that
    /truth/uav_0/odom      nav_msgs/Odometry                where it is
    /tf, /tf_static        tf2_msgs/TFMessage               the same, as frames
    /truth/links           visualization_msgs/MarkerArray   width by weight, colour by who sees whom
    /truth/robots          visualization_msgs/MarkerArray   bodies and cameras
    /truth/scene           visualization_msgs/MarkerArray   obstacles and the leader's course
    /truth/lambda2         std_msgs/Float64
    /truth/stick           geometry_msgs/TwistStamped       the operator's, in the leader's frame

Frames (REP-105): `map` is the world, `uav_0/base_stabilized` a robot's yaw frame, `uav_0/base_link` its body,
`uav_0/camera_link` its camera, which looks along x. SI units, radians; x forward, y left, z up (REP-103). Time is that
of the flight, from 0. A message is plain data, so no ROS and no library is needed here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from fovconn_env import layout
from fovconn_env.fleet.ros import definitions
from fovconn_env.fleet.ros.markers import bearing_marker, link_markers, point, robot_markers, scene_markers
from fovconn_env.fleet.ros.view import NANO, Instant, Scene
from fovconn_env.render import palette
from fovconn_env.render.shapes3d import attitudes
from fovconn_env.scenarios.scenario import Scenario
from fovconn_env.sim.simulator import Simulator

MAP = "map"
Content = dict[str, Any]  # a message by its fields; those that are left out are 0, "" or empty


class Message(NamedTuple):
    """A message on a topic."""

    topic: str
    kind: str  # "nav_msgs/msg/Odometry"
    content: Content
    lasting: bool = False  # it holds until the next one: who comes later gets it, too ("transient local")


def topics(scenario: Scenario) -> dict[str, Message]:
    """An empty message of each topic of a flight, by topic: what kind it is of, and whether it lasts."""
    markers = "visualization_msgs/msg/MarkerArray"
    kinds = {"/truth/links": markers, "/truth/lambda2": "std_msgs/msg/Float64"}
    kinds |= dict.fromkeys(("/tf", "/tf_static"), "tf2_msgs/msg/TFMessage")
    kinds |= dict.fromkeys(("/truth/robots", "/truth/scene"), markers)
    if palette.leader_of(scenario) is not None:
        kinds["/truth/stick"] = "geometry_msgs/msg/TwistStamped"
    for agent in scenario.agents:
        kinds[f"/{agent}/observation"] = "fovconn_msgs/msg/Observation"
        kinds[f"/{agent}/lambda2_hat"] = "std_msgs/msg/Float64"
        kinds[f"/{agent}/bearings"] = "visualization_msgs/msg/Marker"
        kinds[f"/{agent}/ranges"] = "sensor_msgs/msg/PointCloud2"
        kinds[f"/truth/{agent}/odom"] = "nav_msgs/msg/Odometry"
    lasting = "/tf_static", "/truth/robots", "/truth/scene"
    return {topic: Message(topic, kind, {}, topic in lasting) for topic, kind in kinds.items()}


def is_reliable(topic: str) -> bool:
    """Whether messages of a topic are sent until they arrive: what viewers and tf2 take; the rest is sensor data."""
    return topic.startswith(("/truth/", "/tf"))


def base(agent: str) -> str:
    """The robot's yaw frame."""
    return f"{agent}/base_stabilized"


def link(agent: str) -> str:
    """The frame of the robot's body."""
    return f"{agent}/base_link"


def scene_messages(scene: Scene, time: int = 0) -> Iterator[Message]:
    """What holds for a whole flight, from a time, ns: the scene and the cameras' frames."""
    stamp, scenario = _stamp(time), scene.scenario
    yield _markers("/truth/scene", scene_markers(scene), _header(stamp, MAP))
    x, y, z = scenario.camera.unit_axis
    turn = _quaternion(np.arctan2(y, x), 0.0, -np.arcsin(np.clip(z, -1.0, 1.0)))
    cameras = [_transform(stamp, link(agent), f"{agent}/camera_link", (0, 0, 0), turn) for agent in scenario.agents]
    yield Message("/tf_static", "tf2_msgs/msg/TFMessage", {"transforms": cameras}, lasting=True)


def robots_message(scenario: Scenario, now: Instant) -> Message:
    """Bodies and cameras; to be sent again when another robot leads or works."""
    headers = [_header(_stamp(now.time), link(agent)) for agent in scenario.agents]
    return _markers("/truth/robots", robot_markers(scenario, now), *headers)


# ----------------------------------------------------------------------------------------------------- on board
def robot_messages(simulator: Simulator, i: int, time: int, world: int = 0) -> Iterator[Message]:
    """What robot i of a world knows at a time, ns, by its observation alone."""
    agent, state = simulator.scenario.agents[i], simulator.state
    header = _header(_stamp(time), base(agent))
    rows = {name: getattr(state, f"{name}_row")[world, i] for name in ("own", "neighbor", "range", "detection")}
    used = {name: rows[name][rows[name]["present"] > 0] for name in ("neighbor", "range", "detection")}
    content: Content = {"header": header, "own": _fields(rows["own"], layout.SELF)}
    for name, table in (("neighbor", layout.NEIGHBOR), ("range", layout.RANGE), ("detection", layout.DETECTION)):
        content[f"{name}s"] = [_fields(row, table) for row in used[name]]
    yield Message(f"/{agent}/observation", "fovconn_msgs/msg/Observation", content)
    bearings = bearing_marker(used["neighbor"]) | {"header": header}
    yield Message(f"/{agent}/bearings", "visualization_msgs/msg/Marker", bearings)
    points = np.stack([used["range"][axis] for axis in "xyz"], axis=-1)
    yield Message(f"/{agent}/ranges", "sensor_msgs/msg/PointCloud2", {"header": header} | _cloud(points))


def _fields(row: Any, table: tuple[layout.Column, ...]) -> Content:
    return {column.name: row[column.name].item() for column in definitions.columns(table)}


def flat_observation(message: Any, scenario: Scenario) -> np.ndarray:
    """The flat observation, (D,) float32, of a fovconn_msgs/Observation, as rclpy or rosbags read it: for a policy."""
    sizes = scenario.max_neighbors, scenario.max_ranges, scenario.n_detections
    flat = np.zeros(layout.observation_size(*sizes), np.float32)
    own, neighbors, ranges = layout.rows(flat, *sizes)
    _read(own, message.own, layout.SELF)
    rows = (neighbors, message.neighbors, layout.NEIGHBOR), (ranges, message.ranges, layout.RANGE)
    found = layout.detections(flat, scenario.n_detections), message.detections, layout.DETECTION
    for array, items, table in (*rows, found):
        for row, item in zip(array, items, strict=False):  # more than there are rows are left out
            row["present"] = 1.0
            _read(row, item, table)
    return flat


def _read(row: Any, item: Any, table: tuple[layout.Column, ...]) -> None:
    for column in definitions.columns(table):
        row[column.name] = getattr(item, column.name)


# ---------------------------------------------------------------------------------------------------- the truth
def truth_messages(scenario: Scenario, now: Instant) -> Iterator[Message]:
    """Poses, velocities, links, lambda2 with its estimates, and the stick."""
    stamp, transforms = _stamp(now.time), []
    tilts = attitudes(np.zeros(len(now.poses)), now.tilt)  # body to yaw frame
    for i, agent in enumerate(scenario.agents):
        (*place, yaw), (roll, pitch) = now.poses[i], now.tilt[i]
        transforms.append(_transform(stamp, MAP, base(agent), place, _quaternion(yaw)))
        transforms.append(_transform(stamp, base(agent), link(agent), (0, 0, 0), _quaternion(0.0, roll, pitch)))
        linear = now.velocity[i, :3] @ tilts[i]
        angular = np.array([0.0, 0.0, now.velocity[i, 3]]) @ tilts[i]  # of the heading, not of roll and pitch
        content = {"header": _header(stamp, MAP), "child_frame_id": link(agent)}
        content["pose"] = {"pose": {"position": point(*place), "orientation": _quaternion(yaw, roll, pitch)}}
        content["twist"] = {"twist": {"linear": point(*linear), "angular": point(*angular)}}
        yield Message(f"/truth/{agent}/odom", "nav_msgs/msg/Odometry", content)
        if now.alive[i]:
            yield Message(f"/{agent}/lambda2_hat", "std_msgs/msg/Float64", {"data": float(now.lambda2_hat[i])})
    yield Message("/tf", "tf2_msgs/msg/TFMessage", {"transforms": transforms})
    yield _markers("/truth/links", link_markers(now), _header(stamp, MAP), lasting=False)
    yield Message("/truth/lambda2", "std_msgs/msg/Float64", {"data": now.lambda2})
    if now.leader is not None:
        content = {"header": _header(stamp, base(scenario.agents[now.leader]))}
        content["twist"] = {"linear": point(*now.stick)}
        yield Message("/truth/stick", "geometry_msgs/msg/TwistStamped", content)


# --------------------------------------------------------------------------------------------------- parts of them
def _stamp(nanoseconds: int) -> Content:
    return {"sec": nanoseconds // NANO, "nanosec": nanoseconds % NANO}


def _header(stamp: Content, frame: str) -> Content:
    return {"stamp": stamp, "frame_id": frame}


def _transform(stamp: Content, parent: str, child: str, place: Sequence[float], turn: Content) -> Content:
    motion = {"translation": point(*place), "rotation": turn}
    return {"header": _header(stamp, parent), "child_frame_id": child, "transform": motion}


def _quaternion(yaw: float, roll: float = 0.0, pitch: float = 0.0) -> Content:
    """Of the rotation body to parent, Rz(yaw) Ry(pitch) Rx(roll)."""
    (cy, cp, cr), (sy, sp, sr) = (function(np.array([yaw, pitch, roll]) / 2) for function in (np.cos, np.sin))
    x, y, z = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return point(x, y, z) | {"w": float(cr * cp * cy + sr * sp * sy)}


def _cloud(points: np.ndarray) -> Content:
    """A PointCloud2 of points (n, 3)."""
    fields = [{"name": axis, "offset": 4 * k, "datatype": 7, "count": 1} for k, axis in enumerate("xyz")]  # FLOAT32
    data = np.ascontiguousarray(points, "<f4").reshape(-1).view(np.uint8)
    sizes = {"height": 1, "width": len(points), "point_step": 12, "row_step": len(data)}
    return sizes | {"fields": fields, "data": data, "is_dense": True}


def _markers(topic: str, markers: list[Content], *headers: Content, lasting: bool = True) -> Message:
    """Markers on a topic, with the header of their frame: one for all, or by their `robot`."""
    content = [
        {name: value for name, value in marker.items() if name != "robot"} | {"header": headers[marker.get("robot", 0)]}
        for marker in markers
    ]
    return Message(topic, "visualization_msgs/msg/MarkerArray", {"markers": content}, lasting)
