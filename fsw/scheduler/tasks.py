"""Rate groups: a table of tasks, each run every `divisor`-th tick, with time statistics."""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Tick:
    """One run of the loop."""

    index: int  # position on the absolute grid; skipped ticks leave gaps
    due_ns: int  # grid time
    now_ns: int  # when the loop woke, read before any input is drained


@dataclass(frozen=True, slots=True)
class Task:
    """One row of the table; rows run in table order.

    `phase` delays a task within its group's period [ticks], so that not all tasks run in one tick.
    """

    name: str
    divisor: int
    run: Callable[[Tick], None]
    phase: int = 0

    def __post_init__(self) -> None:
        if self.divisor < 1:
            raise ValueError(f"task {self.name!r}: divisor {self.divisor} must be at least 1")


BIN_NS = 10_000
BINS = 2000  # the last bin holds all longer times


@dataclass(slots=True)
class TaskTimes:
    """Statistics of the time that one task needs, or that a wake is late [ns]."""

    count: int = 0
    last_ns: int = 0
    total_ns: int = 0
    max_ns: int = 0
    bins: list[int] = field(default_factory=lambda: [0] * BINS)  # runs by time, in bins of BIN_NS

    def add(self, elapsed_ns: int) -> None:
        """Add the time of one run."""
        self.count += 1
        self.last_ns = elapsed_ns
        self.total_ns += elapsed_ns
        self.max_ns = max(self.max_ns, elapsed_ns)
        self.bins[min(max(elapsed_ns, 0) // BIN_NS, BINS - 1)] += 1

    def quantile_ns(self, ratio: float) -> int:
        """Return the time [ns] that a ratio of the runs did not exceed, to 10 us; 0: no run yet."""
        wanted, seen = ratio * self.count, 0
        for k, count in enumerate(self.bins):
            seen += count
            if seen and seen >= wanted:
                return self.max_ns if k == BINS - 1 else min((k + 1) * BIN_NS, self.max_ns)
        return 0

    @property
    def mean_ns(self) -> float:
        """Mean over all runs [ns]; 0 before the first."""
        return self.total_ns / self.count if self.count else 0.0


@dataclass(slots=True)
class Slips:
    """Statistics of how well the loop kept its grid."""

    ticks: int = 0  # ticks run
    slips: int = 0  # grid points skipped because the loop was late
    stalls: int = 0  # times without a processor, see `messages.findings.Stall`
    over_budget: int = 0  # ticks whose own work took longer than the budget
    early_wakes: int = 0  # waits ended early by a descriptor
    release: TaskTimes = field(default_factory=TaskTimes)  # from the grid point to the wake
    work: TaskTimes = field(default_factory=TaskTimes)  # all tasks of a tick
    times: dict[str, TaskTimes] = field(default_factory=dict)

    @property
    def max_late_ns(self) -> int:
        """The latest wake [ns]."""
        return self.release.max_ns


def is_due(divisor: int, index: int, previous: int) -> bool:
    """Return whether a multiple of `divisor` lies in (previous, index].

    A rate group whose own grid point was skipped runs at the next tick instead of a period later.
    """
    return index // divisor > previous // divisor
