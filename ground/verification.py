"""Follows one telecommand through its verification reports (service 1)."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from ground.errors import FAILED, NO_ANSWER, REJECTED, LinkError
from ground.link import Link
from ground.sdls import MAX_NUMBER
from ground.telemetry import NO_PACKETS, Sample, TelemetryDecoder

SUCCESS = "_success"
FAILURE = "_failure"
END = "completion"
REPLAY = "REPLAY"
REFUSED_CLIENT = "LINK_REFUSED"  # the last event before the daemon closes a connection
REFUSED = ("acceptance", "routing")
UNASKED = ("time", "time_correlation", "science", *NO_PACKETS)  # packets sent without a request
HOUSEKEEPING = (3, 25)


class VerificationOutcome(StrEnum):
    """Outcome of a telecommand."""

    COMPLETED = "completed"
    REJECTED = "rejected"
    FAILED = "failed"
    NO_ANSWER = "no answer"
    UNFINISHED = "accepted, not finished in time"
    REPEATED = "refused as repeated; whether a copy of it had its effect is not known"


EXIT_CODES = {
    VerificationOutcome.COMPLETED: 0,
    VerificationOutcome.REJECTED: REJECTED,
    VerificationOutcome.FAILED: FAILED,
    VerificationOutcome.NO_ANSWER: NO_ANSWER,
    VerificationOutcome.UNFINISHED: NO_ANSWER,
    VerificationOutcome.REPEATED: NO_ANSWER,
}


@dataclass(slots=True)
class Verification:
    """The reports on one telecommand, and the packets that answer it."""

    request: tuple[int, int]  # first two words of the telecommand
    is_authenticated: bool = False  # whether only the daemon can have made these reports
    wanted: str = ""  # name of the requested housekeeping packet
    reports: list[Sample] = field(default_factory=list)
    answers: list[Sample] = field(default_factory=list)
    outcome: VerificationOutcome = VerificationOutcome.NO_ANSWER

    def take(self, sample: Sample) -> bool:
        """Record a packet; return whether it is a report on this telecommand or answers it."""
        if sample.service != 1:
            if self.reports and (sample.packet == self.wanted or _is_answer(sample)):
                self.answers.append(sample)
                return True
            return False
        named = (sample.values["request_packet_id"], sample.values["request_sequence"])
        if named != self.request:
            return False
        self.reports.append(sample)
        if _is_replay(sample):
            if self.outcome is VerificationOutcome.NO_ANSWER:
                self.outcome = VerificationOutcome.REPEATED
            return True
        stage, _, word = sample.packet.rpartition("_")
        if word == FAILURE.strip("_"):
            self.outcome = (
                VerificationOutcome.REJECTED if stage in REFUSED else VerificationOutcome.FAILED
            )
        elif stage == END:
            self.outcome = VerificationOutcome.COMPLETED
        else:
            self.outcome = VerificationOutcome.UNFINISHED
        return True

    @property
    def over(self) -> bool:
        """Whether the telecommand has ended; an unauthenticated REPLAY report does not end it."""
        ends = (
            VerificationOutcome.COMPLETED,
            VerificationOutcome.REJECTED,
            VerificationOutcome.FAILED,
        )
        return self.outcome in ends or (
            self.is_authenticated and self.outcome is VerificationOutcome.REPEATED
        )

    @property
    def expected_number(self) -> int | None:
        """Number of the key that the daemon expects next; None unless a REPLAY report names it."""
        named = [float(s.values["error_value"]) for s in self.reports if _is_replay(s)]
        return int(named[-1]) if named and 0.0 <= named[-1] <= MAX_NUMBER else None


def _is_replay(sample: Sample) -> bool:
    return sample.values.get("error") == REPLAY


def _is_answer(sample: Sample) -> bool:
    return sample.packet not in UNASKED and (sample.service, sample.subtype) != HOUSEKEEPING


def follow(
    link: Link, decoder: TelemetryDecoder, packet: bytes, timeout_s: float, wanted: str = ""
) -> Iterator[tuple[Verification, Sample | None]]:
    """Send a telecommand; yield each report and answer, and once more at the end with None.

    The telecommand is sent once. If an authenticated report says that its number was refused, the
    next number is set to the one that the daemon expects. An unauthenticated report does not change
    the number.
    """
    words = int.from_bytes(packet[:2], "big"), int.from_bytes(packet[2:4], "big")
    is_authenticated = link.stream.is_authenticated
    verification = Verification(request=words, wanted=wanted, is_authenticated=is_authenticated)
    until_s = time.monotonic() + timeout_s
    link.send(packet)
    refusal = ""
    try:
        for raw in link.packets(until_s):
            sample = decoder.decode(raw)
            if sample.values.get("event") == REFUSED_CLIENT:
                refusal = f": {sample.values['text']}"
            if verification.take(sample):
                yield verification, sample
            if verification.over:
                break
    except LinkError as error:
        raise LinkError(f"{error}{refusal}") from error
    number = verification.expected_number
    if number is not None and verification.is_authenticated and link.sealer is not None:
        link.sealer.set_next(number)
    yield verification, None
