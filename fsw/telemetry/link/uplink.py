"""Converts a client's bytes to telecommand packets, in clear or authenticated."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Protocol

from fsw.telemetry.dictionary.codes import APID_ESTIMATOR, Error
from fsw.telemetry.link.sdls import Accepted, FrameReceiver, FrameSplitter, Rejected, Role
from fsw.telemetry.link.splitter import PacketSplitter, Uplinked

KNOWN_ID = 0x1800 | APID_ESTIMATOR


class Uplink(Protocol):
    """Reads the packets in one client's bytes."""

    @property
    def skipped_bytes(self) -> int:
        """Return the number of skipped bytes, which belong to no packet."""
        ...

    @property
    def resyncs(self) -> int:
        """Return the number of times that invalid bytes began."""
        ...

    def feed(self, chunk: bytes, now_ns: int) -> list[Uplinked]:
        """Return the packets that end in this chunk, accepted or rejected."""
        ...

    def expire(self, now_ns: int) -> list[Uplinked]:
        """Discard an item whose rest did not arrive in time; return the packets after it."""
        ...


class ClearUplink(PacketSplitter):
    """Reads packets in clear, on a link that is bound to loopback."""

    def __init__(self) -> None:
        super().__init__(KNOWN_ID)


class LookUplink(ClearUplink):
    """Rejects every packet, because the client may only observe."""

    def feed(self, chunk: bytes, now_ns: int) -> list[Uplinked]:
        """Return the packets that end in this chunk, all rejected."""
        return [_unauthorised(item) for item in super().feed(chunk, now_ns)]

    def expire(self, now_ns: int) -> list[Uplinked]:
        """Discard an item whose rest did not arrive; return the packets after it, all rejected."""
        return [_unauthorised(item) for item in super().expire(now_ns)]


class SecureUplink:
    """Reads the packets in authenticated frames; rejects everything else."""

    def __init__(self, receiver: FrameReceiver) -> None:
        self._splitter = FrameSplitter(receiver)

    @property
    def skipped_bytes(self) -> int:
        """Return the number of skipped bytes, which belong to no frame."""
        return self._splitter.skipped_bytes

    @property
    def resyncs(self) -> int:
        """Return the number of times that invalid bytes began."""
        return self._splitter.resyncs

    def feed(self, chunk: bytes, now_ns: int) -> list[Uplinked]:
        """Return the packets of accepted frames, and rejected items for all other frames."""
        return _reported(self._splitter.feed(chunk, now_ns), now_ns)

    def expire(self, now_ns: int) -> list[Uplinked]:
        """Discard an item whose rest did not arrive in time; return the packets after it."""
        return _reported(self._splitter.expire(now_ns), now_ns)


def _reported(outcomes: Iterable[Accepted | Rejected], now_ns: int) -> list[Uplinked]:
    """Return the packets of frames; the value of a repeated frame is the next valid number."""
    found: list[Uplinked] = []
    for outcome in outcomes:
        if isinstance(outcome, Accepted):
            source = f"SPI {outcome.spi}"
            packets = [replace(item, source=source) for item in _packets(outcome.packet, now_ns)]
            may_command = outcome.role is Role.COMMAND
            found += packets if may_command else [_unauthorised(item) for item in packets]
        else:
            refused = Uplinked(
                packet=outcome.packet or b"",
                error=Error[outcome.reason.name],
                text=outcome.text,
                value=float(outcome.next_number or 0),
            )
            found.append(refused)
    return found


def _unauthorised(item: Uplinked) -> Uplinked:
    """Return a packet as rejected, because its sender may only observe."""
    return replace(item, error=Error.NOT_AUTHORISED, text="may look, not command")


def _packets(data: bytes, now_ns: int) -> list[Uplinked]:
    """Return the packets in an authentic frame; add BAD_LENGTH if bytes are left over."""
    inner = ClearUplink()
    found = inner.feed(data, now_ns)
    if inner.pending_bytes or inner.skipped_bytes:
        found.append(Uplinked(packet=data, error=Error.BAD_LENGTH, text="not whole packets"))
    return found


def security_counters(receiver: FrameReceiver | None) -> Mapping[str, int]:
    """Return the counts of accepted, failed and replayed frames; zeros without a receiver."""
    if receiver is None:
        return {"sdls_accepted": 0, "sdls_failed": 0, "sdls_replayed": 0}
    rejected = {reason.name: count for reason, count in receiver.rejected.items()}
    replayed = rejected.pop("REPLAY", 0)
    return {
        "sdls_accepted": receiver.accepted,
        "sdls_failed": sum(rejected.values()),
        "sdls_replayed": replayed,
    }
