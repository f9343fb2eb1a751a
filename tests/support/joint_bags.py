"""ROS 2 bags of JointState messages as real drivers publish them, written by rosbags."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

KIND = "sensor_msgs/msg/JointState"
EPOCH_NS = 1_760_000_000 * 10**9
RATE_HZ = 30
ROWS = 300


@dataclass(frozen=True, kw_only=True)
class State:
    """One message; arrays may be of any lengths."""

    received_ns: int
    names: Sequence[str]
    position: Sequence[float]
    effort: Sequence[float]
    stamp_ns: int | None = None  # None: as received

    def later(self, by_ns: int) -> "State":
        """Return the message without change, received later."""
        return State(**(self.__dict__ | {"received_ns": self.received_ns + by_ns}))


def at(k: int) -> tuple[int, list[float], list[float]]:
    """Return time [ns], positions and efforts of two joints; efforts of j2 are near 5."""
    t = k / RATE_HZ
    q = [0.1 * np.sin(t), 0.2 * np.cos(t)]
    return EPOCH_NS + k * 10**9 // RATE_HZ, q, [0.5 + 0.1 * np.sin(3 * t), 5 + 0.1 * np.cos(2 * t)]


def whole(k: int) -> State:
    """Return a message of both joints."""
    t_ns, q, tau = at(k)
    return State(received_ns=t_ns, names=["j1", "j2"], position=q, effort=tau)


def changed(change: Callable[[int, State], dict[str, object]]) -> list[State]:
    """Return messages of both joints, each with the changes that the function returns."""
    every = map(whole, range(ROWS))
    return [State(**(state.__dict__ | change(k, state))) for k, state in enumerate(every)]


def write(path: Path, states: Iterable[State], topic: str = "/joint_states") -> Path:
    """Write a bag of one topic."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as out:
        connection = out.add_connection(topic, KIND, typestore=store)
        for state in states:
            ns = state.received_ns if state.stamp_ns is None else state.stamp_ns
            stamp = kinds["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            message = kinds[KIND](
                header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
                name=list(state.names),
                position=np.array(state.position, float),
                velocity=np.zeros(0),
                effort=np.array(state.effort, float),
            )
            out.write(connection, state.received_ns, store.serialize_cdr(message, KIND))
    return path
