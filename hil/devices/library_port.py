"""Any python-can bus that has a descriptor to wait on (all but python-can's `virtual`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import can

from hil.devices.can_segment import TimedFrame
from hil.devices.canopen import SYNC_ID
from hil.devices.heard import HEARD, READ_LIMIT, HeardFrame, is_heard
from hil.devices.plant_file import BusLink

TAP_WAIT_S = 0.005  # for a SYNC at the host's end that has come to the devices'
TAP_APART_S = 0.05  # stamps of one SYNC at most; its counter comes again much later


class SyncTap:
    """Hears SYNCs at the host's end of a cable, for their stamps.

    A frame on a wire has one time. On a cable between two links of one kernel it is stamped twice,
    and a timer of that kernel in between sets the stamps 50 us apart.
    """

    def __init__(self, channel: str) -> None:
        only = [{"can_id": SYNC_ID, "can_mask": 0x7FF, "extended": False}]
        self._bus = can.Bus(interface="socketcan", channel=channel, can_filters=only)
        self._ahead: can.Message | None = None  # heard here, not yet at the devices' end

    def timestamp(self, sync: can.Message) -> float:
        """Return when a SYNC was on the cable [s, CLOCK_REALTIME]; its own stamp where unheard."""
        while (heard := self._next()) is not None:
            apart_s = heard.timestamp - sync.timestamp
            if heard.data == sync.data and abs(apart_s) < TAP_APART_S:
                return heard.timestamp
            if apart_s > 0.0:
                self._ahead = heard
                break
        return sync.timestamp

    def _next(self) -> can.Message | None:
        heard, self._ahead = self._ahead, None
        if heard is not None:
            return heard
        try:
            return self._bus.recv(TAP_WAIT_S)
        except can.CanError:  # this end was down; it comes back to the same socket
            return None

    def close(self) -> None:
        """Release the link."""
        self._bus.shutdown()


class LibraryPort:
    """One bus, frame by frame."""

    def __init__(self, link: BusLink) -> None:
        options = {"port": link.port, "bitrate": link.bitrate, "data_bitrate": link.data_bitrate}
        given: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
        self._bus = can.Bus(interface=link.interface, channel=link.channel, fd=link.fd, **given)
        if link.interface == "socketcan":  # the kernel filters, as a controller of a node does
            self._bus.set_filters(
                [{"can_id": i, "can_mask": m, "extended": False} for i, m in HEARD]
            )
        self._tap = None if link.stamped_at is None else SyncTap(link.stamped_at)
        self.receive_errors = 0

    def fileno(self) -> int:
        """Return the descriptor that becomes readable with frames."""
        return self._bus.fileno()

    def receive(self) -> list[HeardFrame]:
        """Return the frames that have come and that nodes hear."""
        frames: list[HeardFrame] = []
        for _ in range(READ_LIMIT):
            try:
                message = self._bus.recv(0)
            except can.CanError:  # a link that is down; it comes back to the same socket
                self.receive_errors += 1
                break
            if message is None:
                break
            can_id = message.arbitration_id
            if message.is_error_frame or message.is_extended_id or message.is_remote_frame:
                continue
            if not is_heard(can_id):
                continue
            stamp_s = message.timestamp
            if can_id == SYNC_ID and self._tap is not None:
                stamp_s = self._tap.timestamp(message)
            frames.append((round(stamp_s * 1e9), can_id, bytes(message.data)))
        return frames

    def send(self, frames: Sequence[TimedFrame]) -> int:
        """Send frames; return how many did not go out."""
        failed = 0
        for _, can_id, data, is_fd in frames:
            message = can.Message(
                arbitration_id=can_id,
                data=data,
                is_extended_id=False,
                is_fd=is_fd,
                bitrate_switch=is_fd,
            )
            try:
                self._bus.send(message)
            except can.CanError:
                failed += 1
        return failed

    def close(self) -> None:
        """Release the bus."""
        self._bus.shutdown()
        if self._tap is not None:
            self._tap.close()
