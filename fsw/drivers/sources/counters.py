"""Counters that every source keeps."""

from fsw.drivers.codecs.framing import Framer
from fsw.drivers.wire import Reject


class Counters:
    """Samples and bytes of one source; accepted + rejected (+ skipped + pending) = received."""

    __slots__ = (
        "accepted",
        "accepted_bytes",
        "lost",
        "received_bytes",
        "rejected",
        "rejected_bytes",
        "rejects",
        "skipped_bytes",
    )

    def __init__(self) -> None:
        self.accepted = 0
        self.accepted_bytes = 0
        self.rejected = 0
        self.rejected_bytes = 0
        self.skipped_bytes = 0
        self.received_bytes = 0
        self.lost = 0
        self.rejects = dict.fromkeys(Reject, 0)

    def reject(self, reason: Reject, length: int) -> None:
        """Count one rejected item of `length` bytes."""
        self.rejected += 1
        self.rejected_bytes += length
        self.rejects[reason] += 1

    def as_dict(self) -> dict[str, int]:
        """Return the counters by name."""
        out = {
            "received": self.accepted + self.rejected,
            "accepted": self.accepted,
            "rejected": self.rejected,
            "lost": self.lost,
            "received_bytes": self.received_bytes,
            "accepted_bytes": self.accepted_bytes,
            "rejected_bytes": self.rejected_bytes,
            "skipped_bytes": self.skipped_bytes,
        }
        out.update({f"reject_{reason}": count for reason, count in self.rejects.items()})
        return out


def serial_counters(counters: Counters, framer: Framer) -> dict[str, int]:
    """Return a serial source's counters joined with those of its framing."""
    out = counters.as_dict()
    for reason, count in framer.rejects.items():
        out[f"reject_{reason}"] += count
        out["rejected"] += count
        out["received"] += count
    out["received_bytes"] = framer.received_bytes
    out["skipped_bytes"] = framer.skipped_bytes
    out["pending_bytes"] = framer.pending_bytes
    return out
