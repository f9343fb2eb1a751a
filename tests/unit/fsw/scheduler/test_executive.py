import pytest

from fsw.scheduler.executive import MAX_EARLY_WAKES, Executive
from fsw.scheduler.tasks import Task, Tick, is_due
from tests.support.loop_cases import MS, FakeClock


def run(clock: FakeClock, tasks: list[Task], ticks: int, **more) -> tuple[Executive, list[Tick]]:
    executive = Executive(clock, 2 * MS, tasks, cpu_time_ns=clock.cpu_time_ns, **more)
    return executive, [executive.step() for _ in range(ticks)]


def test_ticks_lie_on_the_absolute_grid_from_the_first_step_on():
    clock = FakeClock(1000)
    executive, ticks = run(clock, [], 4)
    assert [t.due_ns for t in ticks] == [1000 + 2 * MS * k for k in range(4)]
    assert (executive.slips.ticks, executive.slips.slips) == (4, 0)
    assert executive.next_due_ns == 1000 + 8 * MS


def test_a_late_tick_runs_once_skips_what_was_missed_and_keeps_the_grid():
    clock = FakeClock()

    def stall(tick: Tick) -> None:
        if tick.index == 1:
            clock.now += 7 * MS

    executive, ticks = run(clock, [Task("stall", 1, stall)], 4)
    assert [t.index for t in ticks] == [0, 1, 4, 5]
    assert [t.due_ns for t in ticks] == [0, 2 * MS, 8 * MS, 10 * MS]
    assert executive.slips.slips == 2
    assert executive.slips.max_late_ns == 5 * MS
    assert executive.slips.release.count == 4
    assert executive.slips.release.quantile_ns(0.75) <= 0.01 * MS
    assert executive.slips.release.quantile_ns(0.99) == 5 * MS


def test_a_tick_late_by_less_than_a_period_is_no_slip():
    clock = FakeClock()

    def stall(tick: Tick) -> None:
        clock.now += 3 * MS if tick.index == 0 else 0

    executive, ticks = run(clock, [Task("stall", 1, stall)], 3)
    assert [t.index for t in ticks] == [0, 1, 2]
    assert executive.slips.slips == 0


def test_rate_groups_run_in_table_order_at_their_divisor():
    log: list[tuple[int, str]] = []
    tasks = [
        Task("slow", 3, lambda t: log.append((t.index, "slow"))),
        Task("fast", 1, lambda t: log.append((t.index, "fast"))),
    ]
    run(FakeClock(), tasks, 4)
    assert log == [
        (0, "slow"), (0, "fast"), (1, "fast"), (2, "fast"), (3, "slow"), (3, "fast"),
    ]  # fmt: skip


def test_a_task_with_a_phase_runs_behind_the_beginning_of_its_period():
    log: list[tuple[int, str]] = []
    tasks = [
        Task("early", 3, lambda t: log.append((t.index, "early"))),
        Task("late", 3, lambda t: log.append((t.index, "late")), phase=2),
    ]
    run(FakeClock(), tasks, 6)
    assert log == [(0, "early"), (2, "late"), (3, "early"), (5, "late")]


def test_a_rate_group_whose_tick_was_skipped_runs_at_the_next_one():
    assert is_due(4, 9, 7)
    assert not is_due(4, 7, 5)
    assert is_due(4, 0, -1)


def test_an_early_wake_only_drains_and_the_tick_stays_on_the_grid():
    clock = FakeClock()
    clock.wakes = [MS // 2, MS, 3 * MS]
    drained: list[int] = []
    ran: list[int] = []
    executive, _ = run(
        clock,
        [Task("tick", 1, lambda _: ran.append(clock.now))],
        3,
        wake_fds=lambda: (1,),
        drain=lambda: drained.append(clock.now),
    )
    assert ran == [0, 2 * MS, 4 * MS]
    assert drained == [MS // 2, MS, 3 * MS]
    assert executive.slips.early_wakes == 3


def test_a_descriptor_that_stays_readable_cannot_spin_the_loop():
    clock = FakeClock()
    clock.wakes = [1] * 1000
    executive, _ = run(clock, [], 2, wake_fds=lambda: (1,))
    assert executive.slips.early_wakes == MAX_EARLY_WAKES
    assert clock.now == 2 * MS


def test_times_per_task_are_last_mean_and_max():
    clock = FakeClock()
    costs = iter([10, 1, 1, 1, 1, 30, 1, 1, 1, 1, 20])

    def work(_tick: Tick) -> None:
        clock.now += next(costs)

    executive, _ = run(clock, [Task("work", 1, work)], 11)  # timed in every fifth tick
    times = executive.slips.times["work"]
    assert (times.count, times.last_ns, times.mean_ns, times.max_ns) == (3, 20, 20.0, 30)
    assert (executive.slips.work.count, executive.slips.work.total_ns) == (11, 68)


def test_a_divisor_below_one_is_refused():
    with pytest.raises(ValueError, match="divisor 0"):
        Task("x", 0, lambda _: None)


def test_a_late_wake_without_work_of_its_own_is_a_stall():
    clock = FakeClock()

    def work(tick: Tick) -> None:
        if tick.index == 1:  # 1 ms of work, interrupted for 9 ms
            clock.cpu += 1 * MS
            clock.now += 10 * MS

    executive, ticks = run(clock, [Task("work", 1, work)], 4, stall_ns=5 * MS)
    assert [t.index for t in ticks] == [0, 1, 6, 7]
    (stall,) = executive.take_stalls()
    assert (stall.start_ns, stall.end_ns, stall.slips) == (4 * MS, 12 * MS, 4)
    assert executive.take_stalls() == []
    assert executive.slips.stalls == 1


def test_a_late_wake_by_the_loops_own_work_is_no_stall_but_over_budget():
    clock = FakeClock()

    def work(tick: Tick) -> None:
        if tick.index == 1:
            clock.cpu += 10 * MS
            clock.now += 10 * MS

    executive, _ = run(clock, [Task("w", 1, work)], 4, stall_ns=5 * MS, budget_ns=2 * MS)
    assert executive.take_stalls() == []
    assert executive.take_over_budget_ns() == 10 * MS
    assert executive.take_over_budget_ns() == 0
    assert (executive.slips.stalls, executive.slips.over_budget) == (0, 1)
    assert executive.slips.slips == 4


def test_time_in_which_the_kernel_holds_the_loop_is_a_stall_and_no_work():
    clock = FakeClock()
    held = [0]

    def send(tick: Tick) -> None:
        if tick.index == 1:  # 1 ms of work, 9 ms in a call
            clock.cpu += 10 * MS
            clock.now += 10 * MS
            held[0] = 9 * MS

    def take_held() -> int:
        taken, held[0] = held[0], 0
        return taken

    executive, _ = run(
        clock, [Task("send", 1, send)], 4, stall_ns=5 * MS, budget_ns=2 * MS, held_ns=take_held
    )
    (stall,) = executive.take_stalls()
    assert (stall.start_ns, stall.end_ns, stall.slips) == (4 * MS, 12 * MS, 4)
    assert executive.slips.over_budget == 0


@pytest.mark.parametrize(("stopped_us", "over"), [(900, 1), (1100, 0)])
def test_a_tick_over_budget_by_less_than_its_interruption_is_none(stopped_us: int, over: int):
    clock = FakeClock()

    def work(tick: Tick) -> None:
        if tick.index == 1:
            clock.cpu += 3 * MS
            clock.now += 3 * MS + stopped_us * 1000

    executive, _ = run(clock, [Task("w", 1, work)], 4, budget_ns=2 * MS)
    assert executive.slips.over_budget == over
    assert (executive.take_over_budget_ns() > 0) == over


def test_work_within_the_budget_is_none_over_it():
    clock = FakeClock()

    def work(_tick: Tick) -> None:
        clock.cpu += 2 * MS

    executive, _ = run(clock, [Task("w", 1, work)], 4, budget_ns=2 * MS)
    assert executive.slips.over_budget == 0
