"""UTC of the daemon's packets, from the correlation that the daemon sends after a time packet."""

import math
from datetime import UTC, datetime, timedelta

from ground.telemetry import Sample

PACKET = "time_correlation"
UNIX = datetime(1970, 1, 1, tzinfo=UTC)


class Correlation:
    """The newest correlation: time of day less mission elapsed time, and its largest error."""

    def __init__(self) -> None:
        self.offset_s: float | None = None
        self.uncertainty_s = math.inf
        self.synchronised = False

    def take(self, sample: Sample) -> None:
        """Keep the correlation in a sample; ignore other packets."""
        if sample.packet != PACKET:
            return
        self.offset_s = int(sample.values["utc_unix_ns"]) * 1e-9 - sample.time_s
        self.uncertainty_s = float(sample.values["uncertainty_s"])
        self.synchronised = sample.values["synchronised"] == "YES"

    def date(self, time_s: float) -> datetime | None:
        """Return UTC of a mission elapsed time [s]; None while there is no correlation."""
        if self.offset_s is None or math.isnan(time_s):
            return None
        return UNIX + timedelta(seconds=self.offset_s + time_s)

    def text(self, time_s: float) -> str | None:
        """Return UTC as ISO 8601 to the millisecond; None while there is no correlation."""
        date = self.date(time_s)
        if date is None:
            return None
        return date.isoformat(timespec="milliseconds").replace("+00:00", "Z")
