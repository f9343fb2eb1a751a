"""Send the drives of an EtherCAT master to the estimator as a live feed, from its cycle task.

Needs pysoem.
"""

import math
import socket
import struct
import time
from collections.abc import Sequence

import pysoem

Values = Sequence[float]
HEAD = struct.Struct("<4sIIBBHQqq")
JOINTS, DEVICE = 1, 3  # kind of the values, clock of the times
SOURCE, PLACE = 7, ("127.0.0.1", 45454)  # feed.source, channel and port of the bus
INPUTS = struct.Struct("<ih")  # TPDO: 0x6064 position [counts], 0x6077 torque [per mille of rated]


class Feed:
    """Packs and sends the values of all joints; it never blocks the cycle."""

    def __init__(self) -> None:
        self.sequence = 0
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)

    def send(self, valid_ns: int, sent_ns: int, positions_rad: Values, torques_nm: Values) -> None:
        """Send one sample of all joints; a value of NaN is not valid."""
        values = [*positions_rad, *torques_nm]
        mask = sum(1 << k for k, value in enumerate(values) if math.isfinite(value))
        numbers = SOURCE, self.sequence, JOINTS, DEVICE, len(values), mask, valid_ns, sent_ns
        self.sequence = (self.sequence + 1) % 2**32
        try:
            self.socket.sendto(
                HEAD.pack(b"FSW1", *numbers) + struct.pack(f"<{len(values)}d", *values), PLACE
            )
        except OSError:
            return  # lost: the estimator counts it by the sequence number


def exchange(master: pysoem.Master, feed: Feed, counts_per_turn: Values, rated_nm: Values) -> None:
    """Run one cycle of process data: send, receive, and only then feed."""
    master.send_processdata()
    master.receive_processdata(2000)
    received_ns, valid_ns = time.monotonic_ns(), master.dc_time
    rows = [INPUTS.unpack_from(slave.input) for slave in master.slaves]
    turns = [count / own for (count, _), own in zip(rows, counts_per_turn, strict=True)]
    torques = [share / 1000 * own for (_, share), own in zip(rows, rated_nm, strict=True)]
    sent_ns = valid_ns + time.monotonic_ns() - received_ns
    feed.send(valid_ns, sent_ns, [2 * math.pi * turn for turn in turns], torques)
