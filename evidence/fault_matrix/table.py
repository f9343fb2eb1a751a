"""The table of bounds, `table.yaml`: it is read and checked; no bound is computed from a run."""

from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field

from hil.world.scenario import FaultEntry

LANES = ("virtual", "machine", "socketcan")  # virtual time, real time, a real bus
PATH = Path(__file__).with_name("table.yaml")
Device = Literal["arm", "imu", "star_tracker", "machine", "socketcan"]


class Row(BaseModel):
    """One fault: its parameters, and the events and times that are required."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    type: str
    sensor: Device
    event: str
    also: tuple[str, ...] = Field(default=(), alias="with")
    recovered: str = "RECOVERED"
    detect_periods: float = 3.0
    detect_s: float | None = None
    reason: str = ""
    shares: str = ""  # why another row has the same event
    loses: Literal["samples", "nothing"] = "samples"
    at_s: float | None = None
    for_s: float | None = None
    node_id: int | None = None
    size: float | None = None
    rate: float | None = None
    device: Literal["arm", "imu", "star_tracker"] | None = None
    recover_s: float | None = None  # replaces the recovery bound of the table; live rows only
    recover_reason: str = ""
    short: bool = False  # whether the short matrix that the tests run includes the row

    @property
    def reasons(self) -> tuple[str, str, str]:
        """Names of the reasons for a late detection, a late recovery, a shared event; or empty."""
        return self.reason, self.recover_reason, self.shares

    @property
    def lane(self) -> str:
        """The lane in which the row runs: one of `LANES`."""
        return self.sensor if self.sensor in LANES else LANES[0]


class Table(BaseModel):
    """All bounds and all rows."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    recover_s: float
    batch_s: float  # is added to every bound of detection
    filter_s: float
    probability: float
    sigma_ratio: float
    sigma_least: float
    before_s: float
    total_s: float
    at_s: float
    for_s: float
    period_s: dict[str, float]
    reasons: dict[str, str]
    faults: tuple[Row, ...]

    def times(self, row: Row) -> tuple[float, float]:
        """Return the begin and the duration of a row's fault [s]."""
        return self.at_s if row.at_s is None else row.at_s, row.for_s or self.for_s

    def entry(self, row: Row) -> FaultEntry:
        """Return the row as a fault of a scenario."""
        values: dict[str, Any] = {
            key: getattr(row, key) for key in ("type", "device", "node_id", "size", "rate")
        }
        at_s, for_s = self.times(row)
        return FaultEntry(at_s=at_s, for_s=for_s, **values)

    def detect_bound_s(self, row: Row) -> float:
        """Return the time from the begin of a fault within which it must be reported [s]."""
        own_s = row.detect_periods * self.period_s[row.sensor]
        return (own_s if row.detect_s is None else row.detect_s) + self.batch_s

    def of(self, lane: str) -> tuple[Row, ...]:
        """Return the rows of one of `LANES`."""
        return tuple(row for row in self.faults if row.lane == lane)

    @property
    def recover_bound_s(self) -> float:
        """The time from the end of a fault within which the recovery must be reported [s]."""
        return self.recover_s + self.filter_s


def load(path: Path = PATH) -> Table:
    """Read the table; raise ValueError if a key is invalid or a reason is missing."""
    table = Table.model_validate(yaml.safe_load(path.read_text(encoding="utf-8")))
    for row in table.faults:
        for reason in filter(None, row.reasons):
            if reason not in table.reasons:
                raise ValueError(f"{row.type}: reason {reason!r} is not listed")
        loose = row.detect_s is not None or row.detect_periods > 3.0
        if loose and not row.reason:
            raise ValueError(f"{row.type}: more than 3 periods to detect it, and no reason")
        if row.recover_s is not None and not row.recover_reason:
            raise ValueError(f"{row.type}: a recovery of its own, and no reason")
    events = [(row.lane, row.event) for row in table.faults]
    for row in table.faults:
        if events.count((row.lane, row.event)) > 1 and not row.shares:
            raise ValueError(f"{row.type}: {row.event} is another row's too, and no reason")
    return table
