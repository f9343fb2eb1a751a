"""The age of samples and estimates when their telemetry packet reaches a client."""

import socket
import threading
import time
from contextlib import suppress

import numpy as np
from spacepackets.ccsds.spacepacket import PacketId, PacketType, parse_space_packets

from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.link.packets import Decoder

APPLICATIONS = sorted({packet.apid for packet in DICTIONARY.packets})


class LinkDelays:
    """A telemetry client on the daemon's machine, so that both use the same clock.

    Parameters
    ----------
    port : TCP port of the daemon's telemetry
    lag_s : time from the end of a window to its closing
    """

    def __init__(self, port: int, lag_s: float) -> None:
        self._lag_s = lag_s
        self._link = socket.create_connection(("127.0.0.1", port))
        self._ages_s: dict[str, list[float]] = {"science": [], "estimate": []}
        self._newest_s = {"science": 0.0, "estimate": 0.0}
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def p99_ms(self, packet: str) -> float:
        """Return the 99th percentile of a packet's age [ms]; 0 if none was received.

        The age of "science" is that of the newest joint sample. The age of "estimate" is the time
        since the closing of its window. Only the first packet with a new value counts.
        """
        ages_s = self._ages_s[packet]
        return 1e3 * float(np.percentile(ages_s, 99)) if ages_s else 0.0

    def join(self) -> None:
        """Wait until the daemon has closed the connection."""
        self._thread.join()

    def close(self) -> None:
        """End the connection."""
        with suppress(OSError):  # the daemon has closed it
            self._link.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._link.close()

    def _follow(self) -> None:
        decoder, waiting = Decoder(), b""
        identifiers = [
            PacketId(PacketType.TM, has_time, apid)
            for apid in APPLICATIONS
            for has_time in (True, False)
        ]
        while received := self._receive():
            now_s = 1e-9 * time.monotonic_ns()
            waiting += received
            found = parse_space_packets(waiting, identifiers)
            waiting = waiting[found.scanned_bytes :]
            for packet in found.tm_list:
                self._look(decoder, packet, now_s)

    def _receive(self) -> bytes:
        try:
            return self._link.recv(1 << 16)
        except OSError:
            return b""

    def _look(self, decoder: Decoder, raw: bytes, now_s: float) -> None:
        found = decoder.decode(raw)
        name = found.packet.name
        key = {"science": "joint_time_s", "estimate": "estimate_time_s"}.get(name)
        if key is None:
            return
        valid_s = float(found.values[key])
        if valid_s > self._newest_s[name] and self._newest_s[name] > 0.0:
            closed_s = valid_s + (self._lag_s if name == "estimate" else 0.0)
            self._ages_s[name].append(now_s - closed_s)
        self._newest_s[name] = valid_s
