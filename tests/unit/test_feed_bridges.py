"""The bridges of the documents, beside stand-ins of rclpy and pysoem, feed the daemon's source."""

import importlib.util
import math
import socket
import struct
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from fsw.clock import MonotonicClock
from fsw.drivers.ports.feed_socket import open_feed
from tests.support.feed_cases import counts, on_feed, source_of

BRIDGES = Path(__file__).parents[2] / "docs" / "howto" / "bridges"


class StandIn(ModuleType):
    """A module with the given names."""

    def __init__(self, name: str, **names: object):
        super().__init__(name)
        self.__dict__.update(names)


def bridge(name: str, place: tuple[str, int]) -> ModuleType:
    """Load a bridge that sends to a place."""
    spec = importlib.util.spec_from_file_location(name, BRIDGES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.PLACE = place
    return module


@pytest.fixture
def port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        place = probe.getsockname()
    port = open_feed(place, MonotonicClock())
    yield port, place
    port.close()


class Node:
    """What rclpy.node.Node gives to a bridge."""

    def __init__(self, name: str):
        self.name = name

    def create_subscription(self, kind, topic, callback, qos):
        assert (kind.__name__, topic, qos) == ("JointState", "joint_states", "best effort")
        self.callback = callback


def message(stamp_ns: int, names, position, effort, velocity=()):
    stamp = SimpleNamespace(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    columns = {"position": position, "effort": effort, "velocity": velocity}
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp), name=names, **columns)


def test_ros_joint_states_reach_the_source_in_the_order_of_the_configuration(
    arm, monkeypatch, port
):
    stand_ins = {
        "rclpy": StandIn("rclpy"),
        "rclpy.node": StandIn("rclpy.node", Node=Node),
        "rclpy.qos": StandIn("rclpy.qos", qos_profile_sensor_data="best effort"),
        "sensor_msgs": StandIn("sensor_msgs"),
        "sensor_msgs.msg": StandIn("sensor_msgs.msg", JointState=type("JointState", (), {})),
    }
    for name, module in stand_ins.items():
        monkeypatch.setitem(sys.modules, name, module)
    node = bridge("ros2_feed", port[1]).Bridge(["axis1", "axis2", "axis3"])
    valid_ns = time.time_ns()
    node.callback(message(valid_ns, ["axis3", "axis1", "axis2"], [0.3, 0.1, 0.2], [3.0, 1.0, 2.0]))
    node.callback(message(valid_ns + 1, ["gripper"], [0.0], [0.0]))  # of another part
    node.callback(message(valid_ns + 2, ["axis1", "axis2"], [0.1, 0.2], []))  # no torques
    node.socket.close()
    source = source_of(on_feed(arm, clock="unix"))
    (samples,) = source.feed(port[0].read())
    assert samples.joint.tolist() == [0, 1, 2, 0, 1]
    assert np.allclose(samples.position_rad, [0.1, 0.2, 0.3, 0.1, 0.2])
    assert np.allclose(samples.torque_nm, [1.0, 2.0, 3.0, math.nan, math.nan], equal_nan=True)
    assert (samples.t_ns <= samples.t_receive_ns).all()
    assert (samples.t_receive_ns - samples.t_ns < 10**9).all()
    counted = counts(source)
    assert (counted["accepted"], counted["reject_status"], "lost" in counted) == (5, 1, False)


def test_an_ethercat_cycle_feeds_after_it_has_received(arm, monkeypatch, port):
    class Master:
        """What pysoem.Master gives to a cycle."""

        def __init__(self):
            self.steps, self.dc_time = [], 700_000_000_000
            self.slaves = [SimpleNamespace(input=b"") for _ in range(3)]

        def send_processdata(self):
            self.steps.append("send")

        def receive_processdata(self, timeout_us):
            self.steps.append(timeout_us)
            self.dc_time += 4_000_000
            for k, slave in enumerate(self.slaves):
                slave.input = struct.pack("<ih", 1000 * (k + 1), 100 * (k + 1))

    monkeypatch.setitem(sys.modules, "pysoem", StandIn("pysoem", Master=Master))
    ethercat = bridge("ethercat_feed", port[1])
    master, feed, chunks = Master(), ethercat.Feed(), []
    for _ in range(3):
        ethercat.exchange(master, feed, [1e5, 1e5, -1e5], [40.0, 40.0, 20.0])
        chunks += port[0].read()
        time.sleep(0.004)
    feed.socket.close()
    assert master.steps == ["send", 2000] * 3
    source = source_of(on_feed(arm, clock="device"))
    (samples,) = source.feed(chunks)
    turn = 2 * math.pi
    assert np.allclose(samples.position_rad[:3], [turn * 0.01, turn * 0.02, -turn * 0.03])
    assert np.allclose(samples.torque_nm[:3], [4.0, 8.0, 6.0])
    assert np.diff(samples.t_ns[::3]).tolist() == pytest.approx(
        [4e6, 4e6], abs=2e6
    )  # a first arrival may be late
    assert counts(source) == {"received": 9, "accepted": 9}
