"""Following one telecommand through its verification reports (service 1)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from ground.errors import FAILED, NO_ANSWER, REJECTED
from ground.link import Link
from ground.telemetry import NO_PACKETS, Decoder, Sample

SUCCESS = "_success"
FAILURE = "_failure"
END = "completion"
REFUSED = ("acceptance", "routing")
UNASKED = ("time", "science", *NO_PACKETS)  # packets that come anyhow
HOUSEKEEPING = (3, 25)


class Outcome(StrEnum):
    """What became of a telecommand."""

    COMPLETED = "completed"
    REJECTED = "rejected"
    FAILED = "failed"
    NO_ANSWER = "no answer"
    UNFINISHED = "accepted, not finished in time"


EXIT_CODES = {
    Outcome.COMPLETED: 0,
    Outcome.REJECTED: REJECTED,
    Outcome.FAILED: FAILED,
    Outcome.NO_ANSWER: NO_ANSWER,
    Outcome.UNFINISHED: NO_ANSWER,
}


@dataclass(slots=True)
class Verification:
    """Reports about one telecommand, and what it made the daemon send."""

    request: tuple[int, int]  # first two words of the telecommand
    wanted: str = ""  # a housekeeping packet that was asked for
    reports: list[Sample] = field(default_factory=list)
    answers: list[Sample] = field(default_factory=list)
    outcome: Outcome = Outcome.NO_ANSWER

    def take(self, sample: Sample) -> bool:
        """Take a packet into account; True when it says something about this telecommand."""
        if sample.service != 1:
            if self.reports and (sample.packet == self.wanted or _is_answer(sample)):
                self.answers.append(sample)
                return True
            return False
        named = (sample.values["request_packet_id"], sample.values["request_sequence"])
        if named != self.request:
            return False
        self.reports.append(sample)
        stage, _, word = sample.packet.rpartition("_")
        if word == FAILURE.strip("_"):
            self.outcome = Outcome.REJECTED if stage in REFUSED else Outcome.FAILED
        elif stage == END:
            self.outcome = Outcome.COMPLETED
        else:
            self.outcome = Outcome.UNFINISHED
        return True

    @property
    def over(self) -> bool:
        """Whether nothing more will come."""
        return self.outcome in (Outcome.COMPLETED, Outcome.REJECTED, Outcome.FAILED)

    @property
    def expected_number(self) -> int | None:
        """The next number of the key the daemon takes, when this one was refused as used."""
        last = self.reports[-1].values if self.reports else {}
        if last.get("error") != "REPLAY":
            return None
        return int(last["error_value"])


def _is_answer(sample: Sample) -> bool:
    return sample.packet not in UNASKED and (sample.service, sample.subtype) != HOUSEKEEPING


def follow(
    link: Link, decoder: Decoder, packet: bytes, timeout_s: float, wanted: str = ""
) -> Iterator[tuple[Verification, Sample | None]]:
    """Send a telecommand; yield what comes of it, and once more at the end with None."""
    words = int.from_bytes(packet[:2], "big"), int.from_bytes(packet[2:4], "big")
    verification = Verification(request=words, wanted=wanted)
    until_s = time.monotonic() + timeout_s
    link.send(packet)
    for raw in link.packets(until_s):
        sample = decoder.decode(raw)
        if verification.take(sample):
            yield verification, sample
        if verification.over:
            break
    yield verification, None
