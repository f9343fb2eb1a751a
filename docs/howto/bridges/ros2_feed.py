#!/usr/bin/env python3
"""Send ROS 2 joint states to the estimator as a live feed: ros2_feed.py JOINT [JOINT ...].

The joints stand in the order of the estimator's configuration. Needs rclpy, nothing else.
"""

import math
import socket
import struct
import sys
import time

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

HEAD = struct.Struct("<4sIIBBHQqq")
JOINTS, UNIX = 1, 1  # kind of the values, clock of the times
SOURCE, PLACE = 7, ("127.0.0.1", 45454)  # feed.source, channel and port of the bus


class Bridge(Node):
    """Sends every message that has one of the joints; what it lacks is marked as not valid."""

    def __init__(self, names: list[str]) -> None:
        super().__init__("inertia_feed")
        self.names, self.sequence = names, 0
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.create_subscription(JointState, "joint_states", self.send, qos_profile_sensor_data)

    def send(self, message: JointState) -> None:
        """Send one message as a datagram: positions, torques, speeds."""
        place = {name: k for k, name in enumerate(message.name)}
        if place.keys().isdisjoint(self.names):
            return  # of another part of the robot
        values = []
        for column in (message.position, message.effort, message.velocity):
            found = (place.get(name, len(column)) for name in self.names)
            values += [column[k] if k < len(column) else math.nan for k in found]
        mask = sum(1 << k for k, value in enumerate(values) if math.isfinite(value))
        valid_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        numbers = SOURCE, self.sequence, JOINTS, UNIX, len(values), mask, valid_ns, time.time_ns()
        data = HEAD.pack(b"FSW1", *numbers) + struct.pack(f"<{len(values)}d", *values)
        self.socket.sendto(data, PLACE)
        self.sequence = (self.sequence + 1) % 2**32


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Bridge(sys.argv[1:]))
