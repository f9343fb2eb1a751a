"""`fsw bench`: measure timer, buses and serial lines of this computer, each against a reference.

Timer: wake-ups of the executive against `cyclictest` (Debian's rt-tests). Bus: frames through the
ports against python-can's `recv` and Notifier. Line: bytes through the port against pyserial. Each
figure is the median of several rounds; a round measures the project's code, then the reference.
"""

import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field

from offline.bench import buses, lines, timer

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Figure:
    """One quantity over all rounds, of the project's code and of the reference, if there is one."""

    name: str
    unit: str
    own: tuple[float, ...]
    reference_name: str = ""
    reference: tuple[float, ...] = ()

    @property
    def ratio(self) -> float | None:
        """Median of `own` divided by that of `reference`; None if it is missing or zero."""
        if not self.reference or not statistics.median(self.reference):
            return None
        return statistics.median(self.own) / statistics.median(self.reference)

    def to_text(self) -> str:
        """Return one row of the table."""
        text = f"{self.name:<44} {_spread(self.own)} {self.unit}"
        if not self.reference:
            return text
        ratio = "" if self.ratio is None else f", ratio {self.ratio:.2f}"
        return f"{text}; {self.reference_name} {_spread(self.reference)}{ratio}"


def _spread(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.4g} ({min(values):.4g} to {max(values):.4g})"


@dataclass(slots=True)
class Report:
    """Figures of one run of the bench, and lines on what could not be measured."""

    rounds: int
    figures: list[Figure] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    def to_json(self) -> dict[str, object]:
        """Return plain values."""
        rows = [{**asdict(figure), "ratio": figure.ratio} for figure in self.figures]
        return {"rounds": self.rounds, "figures": rows, "missing": self.missing}

    def to_text(self) -> str:
        """Return a table with median, least and greatest value of the rounds."""
        rows = [figure.to_text() for figure in self.figures]
        return "\n".join([f"median (least to greatest) of {self.rounds} rounds", *rows])


def bench(rounds: int, seconds: float, priority: int, frame_rate_hz: float, tell: Tell) -> Report:
    """Measure timer, buses and serial lines.

    Parameters
    ----------
    seconds : duration of each measurement in each round [s]
    priority : SCHED_FIFO priority of the timer's measurement; 0: ordinary scheduling
    tell : receives lines of progress
    """
    report = Report(rounds)
    for figures in (
        _timer(report, rounds, seconds, priority, tell),
        _buses(rounds, seconds, frame_rate_hz, tell),
        _lines(rounds, seconds, tell),
    ):
        report.figures += figures
    return report


def _timer(
    report: Report, rounds: int, seconds: float, priority: int, tell: Tell
) -> Iterator[Figure]:
    own: list[timer.Lateness] = []
    reference: list[timer.Lateness] = []
    for k in range(rounds):
        tell(f"timer, round {k + 1} of {rounds}")
        own.append(timer.executive(timer.RATE_HZ, seconds, priority))
        found = timer.cyclictest(timer.RATE_HZ, seconds, priority)
        if found is not None:
            reference.append(found)
    if not reference:
        report.missing.append("cyclictest: install Debian's rt-tests")
    if any(not lateness.is_fifo for lateness in own) and priority:
        report.missing.append(f"SCHED_FIFO {priority}: not permitted, ordinary scheduling")
    for name in ("p50_us", "p99_us", "max_us"):
        yield Figure(
            f"tick release at {timer.RATE_HZ:g} Hz, {name[:-3]}",
            "us",
            tuple(getattr(lateness, name) for lateness in own),
            "cyclictest",
            tuple(getattr(lateness, name) for lateness in reference),
        )


def _buses(rounds: int, seconds: float, rate_hz: float, tell: Tell) -> Iterator[Figure]:
    seen: dict[str, list[buses.Flow]] = {name: [] for name in buses.READERS}
    for k in range(rounds):
        for name, reader in buses.READERS.items():
            tell(f"{name}, round {k + 1} of {rounds}")
            seen[name].append(reader(rate_hz, seconds))

    def of(name: str, quantity: str) -> tuple[float, ...]:
        return tuple(float(getattr(flow, quantity)) for flow in seen[name])

    for ours in (buses.SOCKET, buses.MULTICAST):
        yield Figure(f"{ours}: frames sent", "frames/s", of(ours, "frames_per_s"))
        yield Figure(f"{ours}: frames lost", "frames", of(ours, "lost"))
        yield Figure(f"{ours}: core in the path", "%", of(ours, "core_percent"))
        for name in (buses.RECV, buses.NOTIFIER):
            yield Figure(
                f"{ours}: processor time of a frame",
                "us",
                of(ours, "us_per_frame"),
                name,
                of(name, "us_per_frame"),
            )
    for name in (buses.RECV, buses.NOTIFIER):
        yield Figure(f"{name}: frames lost", "frames", of(name, "lost"))
    stalls = [buses.stalled(rate_hz, stall_s) for stall_s in buses.STALLS_S]
    for stall_s, flow in zip(buses.STALLS_S, stalls, strict=True):
        name = f"{buses.SOCKET}: stall of {stall_s:g} s"
        yield Figure(f"{name}: frames lost", "frames", (float(flow.lost),))
        yield Figure(f"{name}: of these counted", "frames", (float(flow.counted),))


def _lines(rounds: int, seconds: float, tell: Tell) -> Iterator[Figure]:
    seen: dict[str, list[lines.Flow]] = {name: [] for name in lines.READERS}
    for k in range(rounds):
        for name, reader in lines.READERS.items():
            tell(f"{name}, round {k + 1} of {rounds}")
            seen[name].append(reader(seconds))
    for quantity, unit in (("bytes_per_s", "bytes/s"), ("us_per_kilobyte", "us/kB")):
        own, reference = (
            tuple(float(getattr(flow, quantity)) for flow in flows) for flows in seen.values()
        )
        what = "bytes read" if quantity == "bytes_per_s" else "processor time"
        yield Figure(f"serial line: {what}", unit, own, lines.PYSERIAL, reference)
