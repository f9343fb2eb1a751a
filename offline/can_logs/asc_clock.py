"""The clock of an ASC log: stamps count from a start that the header or a trigger block states.

The header has milliseconds at best. python-can writes them without leading zeros, so `30.42` is
30 s and 42 ms; Vector's tools write three digits.
"""

import re
from datetime import UTC, datetime
from pathlib import Path

from fsw.errors import ConfigError

MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
OTHERS = {  # what else months begin with in German, French, Italian and Spanish
    **dict.fromkeys(("gen", "ene", "jän"), 1),
    **dict.fromkeys(("fév", "fev"), 2),
    **dict.fromkeys(("mär", "mrz"), 3),
    **dict.fromkeys(("avr", "abr"), 4),
    **dict.fromkeys(("mai", "mag"), 5),
    **dict.fromkeys(("giu", "juin"), 6),
    **dict.fromkeys(("lug", "juil"), 7),
    **dict.fromkeys(("ago", "aoû", "aou"), 8),
    "set": 9,
    **dict.fromkeys(("okt", "ott"), 10),
    **dict.fromkeys(("dez", "déc", "dic"), 12),
}
FAR_S = 60.0  # a first frame that is further from the start has stamps of another clock
DIGITS = {1: "one digit", 2: "two digits"}
_START = re.compile(r"\s*(?:date|begin\s+triggerblock)\s+(?P<moment>\S.*)", re.IGNORECASE)
_MOMENT = re.compile(
    r"(?:\w+\.?\s+)?(?P<month>[^\W\d]+)\.?\s+(?P<day>\d+)\s+(?P<clock>\d+:\d+:\d+)"
    r"(?:\.(?P<fraction>\d+))?(?:\s+(?P<half>[ap]m))?\s+(?P<year>\d{4})",
    re.IGNORECASE,
)


class AscClock:
    """Turns the stamps of an ASC log into times [ns since 1970]."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._start_ns = 0
        self._blocks = 0  # trigger blocks
        self._new_ns: int | None = None  # start of a block of which no stamp has been read
        self._first_s: float | None = None  # stamp of the first frame
        self._last_s = 0.0
        self._doubt: list[str] = []

    def reads(self, number: int, text: str) -> bool:
        """Return whether a line states a start, and adopt it."""
        found = _START.match(text)
        if found is None:
            return False
        is_block = text.lstrip()[:1] in "bB"
        if not is_block and self._first_s is not None:
            return True
        self._blocks += is_block
        start_ns, doubt = self._read(number, found["moment"])
        if self._first_s is None:
            self._start_ns, self._doubt = start_ns, doubt
        else:
            self._new_ns = start_ns
        return True

    def stamp_ns(self, stamp_s: float) -> int:
        """Return the time of a frame.

        Stamps of a further trigger block count from its own start, unless they continue those of
        the block before.
        """
        if self._first_s is None:
            self._first_s = stamp_s
        elif self._new_ns is not None and stamp_s < self._last_s:
            self._start_ns = self._new_ns
        self._new_ns, self._last_s = None, stamp_s
        return self._start_ns + round(stamp_s * 1e6) * 1000

    def notes(self) -> list[str]:
        """Return what a user must know about the times."""
        if self._first_s is None or not self._doubt:
            return ["no start in its header: stamps count from 0"] * (self._first_s is not None)
        notes = [", ".join(self._doubt)]
        if self._blocks > 1:
            notes.append(f"{self._blocks} trigger blocks")
        if abs(self._first_s) > FAR_S:
            notes.append(
                f"first frame {self._first_s:.1f} s after the start, so the stamps may count from "
                "midnight or from power-on; see --shift"
            )
        return notes

    def _read(self, number: int, text: str) -> tuple[int, list[str]]:
        """Return a start [ns] and in words how well it is known."""
        try:
            found = _MOMENT.fullmatch(text.strip())
            moment, fraction = _local(found)
            start_ns = round(moment.timestamp()) * 10**9
        except (ValueError, OverflowError, OSError) as error:
            raise ConfigError(
                f"{self._path}: line {number}: {text.strip()[:100]!r} must be as 'Thu Oct 9 "
                "08:53:30.042 2025', the month in English, German, French, Italian or Spanish"
            ) from error
        digits = len(fraction)
        start_ns += int(fraction.zfill(3).ljust(9, "0")[:9])
        local = datetime.fromtimestamp(start_ns * 1e-9, UTC).astimezone()
        known = "1 ms" if digits else "1 s"
        doubt = [
            f"starts {local.isoformat(' ', 'milliseconds')} by its header, read in this computer's "
            f"time zone, known to {known}"
        ]
        if digits in DIGITS and int(fraction):
            doubt.append(
                f"its .{fraction} of {DIGITS[digits]} read as {int(fraction)} ms, as python-can "
                "writes them"
            )
        return start_ns, doubt


def _local(found: re.Match[str] | None) -> tuple[datetime, str]:
    """Return date and time to the second, and the digits after the point. Raises ValueError."""
    if found is None:
        raise ValueError("no date")
    name = found["month"].lower()
    month = OTHERS.get(name[:4]) or OTHERS.get(name[:3]) or MONTHS.index(name[:3]) + 1
    hour, minute, second = map(int, found["clock"].split(":"))
    if found["half"]:
        hour = hour % 12 + 12 * (found["half"].lower() == "pm")
    moment = datetime(int(found["year"]), month, int(found["day"]), hour, minute, second)  # noqa: DTZ001
    return moment, found["fraction"] or ""
