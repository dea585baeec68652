"""A ROS 2 node that flies one robot of `fovconn fleet ... --ros` by what that robot knows.

    python docs/examples/ros_pilot.py uav_3

It keeps the middle of the neighbours that the robot knows in front of the camera, 4 m away. It needs rclpy and
fovconn_msgs (docs/fleet.md), but not fovconn_env.
"""

import contextlib
import math
import sys

import rclpy
from fovconn_msgs.msg import Observation
from geometry_msgs.msg import TwistStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

AWAY = 4.0  # m
SPEED, TURN = 0.5, 1.0  # 1/s, of what is missing


class Pilot(Node):
    """Answers each observation with a command."""

    def __init__(self, robot: str) -> None:
        super().__init__("pilot")
        self.commands = self.create_publisher(TwistStamped, f"/{robot}/cmd_vel", 10)
        self.create_subscription(Observation, f"/{robot}/observation", self.fly, qos_profile_sensor_data)

    def fly(self, observation: Observation) -> None:
        """Fly towards the middle of the neighbours; hover where none is known."""
        command = TwistStamped(header=observation.header)  # its frame is that of the command: the robot's yaw frame
        known = [row for row in observation.neighbors if row.bearing_x or row.bearing_y or row.bearing_z]
        if known:
            x = sum(row.distance * row.bearing_x for row in known) / len(known)
            y = sum(row.distance * row.bearing_y for row in known) / len(known)
            z = sum(row.distance * row.bearing_z for row in known) / len(known)
            share = 1.0 - AWAY / max(math.hypot(x, y, z), 1.0)
            linear = command.twist.linear
            linear.x, linear.y, linear.z = (SPEED * share * value for value in (x, y, z))
            command.twist.angular.z = TURN * math.atan2(y, x)
        self.commands.publish(command)


if __name__ == "__main__":
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Pilot(sys.argv[1]))
