"""Limits bursts of one event code: the first events pass, one summary a period counts the rest."""

from collections.abc import Mapping
from dataclasses import dataclass

PERIOD_S = 10.0
LONGEST_PERIOD_S = 600.0
# events that a sender on the link can cause at any rate -> number that pass in a period
LIMITS: Mapping[str, int] = {
    "TC_REJECTED": 5,
    "TC_AUTH_FAILED": 5,
    "TC_NOT_AUTHORISED": 5,
    "TC_GARBAGE": 5,
    "TC_FAILED": 20,
    "TC_ACCEPTED": 200,
    "TC_COMPLETED": 200,
    "LINK_OPENED": 10,
    "LINK_CLOSED": 10,
    "LINK_REFUSED": 10,
    "LINK_DROPS": 5,
    "LINK_CAUGHT_UP": 5,
    "FILE_FAILED": 10,
    "SCHEDULE_DISCARDED": 20,
}


@dataclass(slots=True)
class _Burst:
    until_ns: int
    period_s: float = PERIOD_S
    passed: int = 0
    held: int = 0
    last: str = ""


class Summaries:
    """Decides which events pass, and counts the rest for summaries.

    While a burst continues, only one summary per period passes for its code, and the period doubles
    up to ten minutes. A period without a held event ends the burst.
    """

    def __init__(self, limits: Mapping[str, int] = LIMITS) -> None:
        self._limits = limits
        self._bursts: dict[str, _Burst] = {}
        self.held = 0  # total of the events counted for a summary

    def passes(self, code: str, text: str, now_ns: int) -> bool:
        """Return whether an event passes; count it for the summary if not."""
        limit = self._limits.get(code)
        if limit is None:
            return True
        burst = self._bursts.get(code)
        if burst is None:
            burst = self._bursts[code] = _Burst(now_ns + round(PERIOD_S * 1e9))
        if burst.period_s == PERIOD_S and burst.passed < limit:
            burst.passed += 1
            return True
        burst.held += 1
        self.held += 1
        burst.last = text
        return False

    def poll(self, now_ns: int) -> list[tuple[str, str]]:
        """Return code and text of each summary that is due."""
        due = [(code, burst) for code, burst in self._bursts.items() if now_ns >= burst.until_ns]
        found = []
        for code, burst in due:
            if not burst.held:
                del self._bursts[code]
                continue
            found.append((code, _summary(burst)))
            burst.held, burst.period_s = 0, min(2.0 * burst.period_s, LONGEST_PERIOD_S)
            burst.until_ns = now_ns + round(burst.period_s * 1e9)
        return found

    def close(self) -> list[tuple[str, str]]:
        """End all bursts; return code and text of a last summary of each with held events."""
        found = [(code, _summary(burst)) for code, burst in self._bursts.items() if burst.held]
        self._bursts.clear()
        return found


def _summary(burst: _Burst) -> str:
    return f"{burst.held} more within {burst.period_s:g} s, the last: {burst.last}"
