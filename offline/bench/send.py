"""Sends what the bench reads, in a process of its own: `python -m offline.bench.send`.

Frames of seven nodes carry their number; a sender's last line says how many it has sent.
"""

import argparse
import os
import socket
import sys
from collections.abc import Callable, Sequence

from fsw.clock import MonotonicClock
from fsw.drivers.ports.linux_can import pack_classic
from fsw.drivers.ports.packed_frames import packed

NODES = 7
COB_TPDO1 = 0x180
STEP_S = 1e-3  # between two bursts
WRITE_BYTES = 1024


def frames(
    send: Callable[[bytes], object],
    form: Callable[[int, bytes], bytes],
    rate_hz: float,
    seconds: float,
) -> int:
    """Send numbered frames in bursts; return how many were sent."""
    clock, sent = MonotonicClock(), 0
    began_ns = clock.now_ns()
    while (elapsed_s := (clock.now_ns() - began_ns) * 1e-9) < seconds:
        while sent < elapsed_s * rate_hz:
            send(form(COB_TPDO1 + 1 + sent % NODES, sent.to_bytes(8, "little")))
            sent += 1
        clock.sleep_until_ns(clock.now_ns() + round(STEP_S * 1e9))
    return sent


def main(argv: Sequence[str] | None = None) -> int:
    """Send for the given time, then print the number of frames or bytes sent; return 0."""
    parser = argparse.ArgumentParser(prog="offline.bench.send", description=__doc__)
    parser.add_argument("kind", choices=("socket", "multicast", "line"))
    parser.add_argument("place", help="port; group:port; descriptor of the line")
    parser.add_argument("rate_hz", type=float)
    parser.add_argument("seconds", type=float)
    given = parser.parse_args(argv)
    if given.kind == "line":
        sys.stdout.write(f"{_write_line(int(given.place), given.seconds)}\n")
        return 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        if given.kind == "socket":
            link.connect(("127.0.0.1", int(given.place)))
            form = pack_classic
        else:
            group, port = given.place.rsplit(":", 1)
            link.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            link.connect((group, int(port)))
            form = packed.__wrapped__  # the numbers never repeat
        sys.stdout.write(f"{frames(link.send, form, given.rate_hz, given.seconds)}\n")
    return 0


def _write_line(descriptor: int, seconds: float) -> int:
    """Write as many bytes as the line accepts in `seconds`; return their number."""
    clock, written, data = MonotonicClock(), 0, bytes(range(256)) * (WRITE_BYTES // 256)
    end_ns = clock.now_ns() + round(seconds * 1e9)
    while clock.now_ns() < end_ns:
        written += os.write(descriptor, data)
    return written


if __name__ == "__main__":
    sys.exit(main())
