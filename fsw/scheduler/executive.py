"""The fixed-rate executive: one wait per tick of an absolute grid; slips are only counted."""

from collections.abc import Callable, Sequence

from fsw.clock import Clock
from fsw.messages.findings import Stall
from fsw.scheduler.tasks import Slips, Task, TaskTimes, Tick, is_due

NEVER_NS = 1 << 62
TIMED_TICKS = 5  # tasks are timed in every fifth tick only: reading a clock costs time
MAX_EARLY_WAKES = 64  # per tick; a descriptor that stays readable must not spin the loop


def _no_descriptors() -> Sequence[int]:
    return ()


def _nothing() -> None:
    return None


def _no_time() -> int:
    return 0


class Executive:
    """Run a task table on the grid t0 + k * period.

    Parameters
    ----------
    clock : the only source of time
    period_ns : tick period [ns]
    tasks : table; every row whose rate group is due runs, in table order
    wake_fds : descriptors that may end the wait early
    drain : the only function that runs after an early wake; then the wait continues
    cpu_time_ns : processor time of this thread [ns]; separates the loop's own work from a stall
    held_ns : time since the last call in which the kernel used this thread for other work [ns];
        it is subtracted from the thread's processor time
    stall_ns : a wake this late that the loop's own work does not explain is a stall [ns]
    budget_ns : processor time that the work of a tick may use [ns]
    """

    def __init__(
        self,
        clock: Clock,
        period_ns: int,
        tasks: Sequence[Task],
        *,
        wake_fds: Callable[[], Sequence[int]] = _no_descriptors,
        drain: Callable[[], None] = _nothing,
        cpu_time_ns: Callable[[], int] = _no_time,
        held_ns: Callable[[], int] = _no_time,
        stall_ns: int = NEVER_NS,
        budget_ns: int = NEVER_NS,
    ) -> None:
        if period_ns <= 0:
            raise ValueError(f"period_ns {period_ns} must be positive")
        self._clock = clock
        self._period_ns = period_ns
        self._tasks = tuple(tasks)
        self._wake_fds = wake_fds
        self._drain = drain
        self._cpu_time_ns, self._held_ns = cpu_time_ns, held_ns
        self._stall_ns, self._budget_ns = stall_ns, budget_ns
        self._began_ns = 0  # wake of the newest tick
        self._began_cpu_ns = 0  # processor time when the wait for that tick began
        self._longest_ns = 0  # longest work over the budget since the last report
        self._stalls: list[Stall] = []
        self._t0_ns: int | None = None
        self._index = -1
        self.slips = Slips(times={task.name: TaskTimes() for task in tasks})

    @property
    def next_due_ns(self) -> int | None:
        """Grid time of the next tick [ns]; None before the first."""
        if self._t0_ns is None:
            return None
        return self._t0_ns + (self._index + 1) * self._period_ns

    def step(self) -> Tick:
        """Wait for the next grid point, skip missed points, run the due tasks; return the tick."""
        tick = self._wait()
        previous, self._index = self._index, tick.index
        self.slips.ticks += 1
        started_ns = tick.now_ns
        is_timed = tick.index // TIMED_TICKS > previous // TIMED_TICKS
        for task in self._tasks:
            if not is_due(task.divisor, tick.index - task.phase, previous - task.phase):
                continue
            task.run(tick)
            if is_timed:
                ended_ns = self._clock.now_ns()
                self.slips.times[task.name].add(ended_ns - started_ns)
                started_ns = ended_ns
        self.slips.work.add(self._clock.now_ns() - tick.now_ns)
        return tick

    def take_stalls(self) -> list[Stall]:
        """Return the stalls since the last call."""
        stalls, self._stalls = self._stalls, []
        return stalls

    def take_over_budget_ns(self) -> int:
        """Return the longest work over the budget since the last call [ns]; 0: none."""
        longest_ns, self._longest_ns = self._longest_ns, 0
        return longest_ns

    def _is_over_budget(self, worked_ns: int) -> bool:
        """Return whether the work since the newest tick was longer than the budget.

        A virtual machine that was stopped counts part of the stop as the thread's processor time.
        Therefore the excess must be longer than the time in which the thread had no processor.
        """
        if worked_ns <= self._budget_ns:
            return False
        interrupted_ns = self._clock.now_ns() - self._began_ns - worked_ns
        return worked_ns - self._budget_ns > interrupted_ns

    def _wait(self) -> Tick:
        cpu_ns = self._cpu_time_ns()
        worked_ns = max(0, cpu_ns - self._began_cpu_ns - self._held_ns())
        self._began_cpu_ns = cpu_ns
        if self._t0_ns is None:
            self._t0_ns = self._began_ns = self._clock.now_ns()
            worked_ns = 0
        if self._is_over_budget(worked_ns):
            self.slips.over_budget += 1
            self._longest_ns = max(self._longest_ns, worked_ns)
        index = self._index + 1
        due_ns = self._t0_ns + index * self._period_ns
        fds = self._wake_fds()
        wakes = 0
        while not self._clock.sleep_until_ns(due_ns, fds):
            wakes += 1
            self._drain()
            fds = self._wake_fds() if wakes < MAX_EARLY_WAKES else ()
        self.slips.early_wakes += wakes
        now_ns = self._clock.now_ns()
        late_ns = now_ns - due_ns
        missed = max(late_ns // self._period_ns, 0)
        self.slips.slips += missed
        self.slips.release.add(late_ns)
        ready_ns = max(due_ns, self._began_ns + worked_ns)
        if now_ns - ready_ns >= self._stall_ns:
            self.slips.stalls += 1
            self._stalls.append(Stall(ready_ns, now_ns, missed))
        self._began_ns = now_ns
        index += missed
        return Tick(index, due_ns + missed * self._period_ns, now_ns)
