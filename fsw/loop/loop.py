"""The loop: send SYNC, read all devices and hand their traffic over in batches, undecoded.

`wiring.build` builds a loop.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from fsw.clock import Clock
from fsw.config import Config
from fsw.exchange.sinks import BatchEnd, Sink, StatusReport
from fsw.exchange.status import task_summary, time_values
from fsw.loop.bus_input import BusInput
from fsw.loop.inputs import Inputs, batch_s
from fsw.messages import Event
from fsw.messages.commands import Command, CommandName
from fsw.scheduler.executive import Executive
from fsw.scheduler.tasks import Task, Tick

SPREAD_TICKS = 16  # a batch of at least this length is handed over in steps, one per tick
STATUS_PHASE = 8  # phase of the status task [ticks]: after these steps


def nothing_due() -> int:
    """Return 0: the end of the next window is not known."""
    return 0


def nothing_more() -> dict[str, Any]:
    """Return no further values for the status."""
    return {}


class Loop:
    """Sends SYNC and heartbeats, drains ports, hands batches over, reopens ports, reports status.

    Parameters
    ----------
    inputs : buses and lines that hand their traffic over to the same `sink`
    deadline_ns : returns the time at which the next window closes and the batch ends [ns], or 0
    more : returns further values of each status
    """

    def __init__(
        self,
        config: Config,
        clock: Clock,
        sink: Sink,
        inputs: Inputs,
        deadline_ns: Callable[[], int] = nothing_due,
        more: Callable[[], Mapping[str, Any]] = nothing_more,
    ) -> None:
        self._config, self._clock, self._sink, self._inputs = config, clock, sink, inputs
        self._deadline_ns, self._more = deadline_ns, more
        rate_hz, budget_s = config.scheduler.tick_rate_hz, config.scheduler.work_budget_s
        self._batch_ticks = max(1, round(rate_hz * batch_s(config)))
        self._next_batch = 0  # tick at which the next batch ends
        self._handing: Iterator[None] = iter(())  # remaining steps of the newest batch
        self._handed_ns = -1  # end of the newest batch [ns]
        self.stop_requested = self.restart_requested = False
        period_ns = round(1e9 / rate_hz)
        self.executive = Executive(
            clock,
            period_ns,
            self._table(),
            wake_fds=inputs.wake_fds,
            drain=inputs.stamp_lines,
            cpu_time_ns=clock.cpu_time_ns,
            held_ns=inputs.take_held_ns,
            stall_ns=round(config.health.stall_s * 1e9),
            budget_ns=period_ns if budget_s is None else round(budget_s * 1e9),
        )

    def step(self) -> Tick:
        """Wait for the next grid point and run one tick."""
        return self.executive.step()

    def run(self, stop: Callable[[], bool]) -> None:
        """Run ticks until `stop` returns True or a command ends the run."""
        while not (stop() or self.stop_requested):
            self.step()

    def submit(self, command: Command) -> None:
        """Pass a command to the sink; STOP and RESTART also end this loop."""
        self.stop_requested |= command.name in (CommandName.STOP, CommandName.RESTART)
        self.restart_requested |= command.name is CommandName.RESTART
        self._sink.put(command)

    def finish(self) -> None:
        """Hand over the remaining traffic, so that the recording lasts to the end of the run."""
        self._inputs.drain()
        self._hand_over_whole(self._clock.now_ns(), self.executive.slips.ticks)

    def report(self) -> None:
        """Put the loop's counters into the sink, between ticks."""
        now_ns = self._clock.now_ns()
        self._sink.put(StatusReport(now_ns, self.status(now_ns)))

    def close(self) -> None:
        """Report the end and release the ports; called after the estimation has ended."""
        now_ns = self._clock.now_ns()
        text = f"stopped after {self.executive.slips.ticks} ticks"
        self._sink.put(Event(now_ns, "info", "STOPPED", text))
        self.report()
        self._inputs.close()
        self._sink.close()

    def status(self, now_ns: int) -> dict[str, Any]:
        """Return the loop's counters as plain values."""
        slips = self.executive.slips
        return {
            "t_ns": now_ns,
            "ticks": slips.ticks,
            "slips": slips.slips,
            "stalls": slips.stalls,
            "over_budget": slips.over_budget,
            "max_late_us": slips.max_late_ns / 1e3,
            "release_us": time_values(slips.release),
            "work_us": time_values(slips.work),
            "tasks_us": task_summary(slips),
            **self._inputs.status(),
            **self._more(),
        }

    def _table(self) -> list[Task]:
        rate_hz, inputs = self._config.scheduler.tick_rate_hz, self._inputs
        rates = {bus.name: bus for bus in self._config.buses}
        table = [Task("start", 1, lambda _: inputs.start())]
        for bus in inputs.buses:
            config = rates[bus.name]
            if config.heartbeat_s is not None:
                divisor = max(1, round(rate_hz * config.heartbeat_s))
                table.append(Task(f"heartbeat_{bus.name}", divisor, partial(self._beat, bus)))
            if config.sync == "producer":
                divisor = round(rate_hz / config.rate_hz)
                table.append(Task(f"sync_{bus.name}", divisor, partial(self._sync, bus)))
        status = max(1, round(rate_hz / self._config.service.status_rate_hz))
        return [
            *table,
            Task("drain", 1, lambda _: inputs.drain()),
            Task("hand_over", 1, self._hand_over_if_due),
            Task("links", max(1, round(rate_hz / 10.0)), lambda _: inputs.retry()),
            Task("status", status, self._status, phase=min(STATUS_PHASE, status - 1)),
        ]

    def _sync(self, bus: BusInput, _tick: Tick) -> None:
        self._inputs.sync(bus)

    def _beat(self, bus: BusInput, _tick: Tick) -> None:
        self._inputs.beat(bus)

    def _hand_over_if_due(self, tick: Tick) -> None:
        """End the batch when it is long enough or when a window closes.

        A long batch is handed over in steps over several ticks; at the end of a window, at once.
        """
        is_closing = self._handed_ns < self._deadline_ns() <= tick.now_ns
        if not is_closing and tick.index < self._next_batch:
            next(self._handing, None)
            return
        self._next_batch = (tick.index // self._batch_ticks + 1) * self._batch_ticks
        if is_closing or self._batch_ticks < SPREAD_TICKS:
            self._hand_over_whole(tick.now_ns, tick.index)
            return
        self._end_handing()
        self._handing = self._hand_over(tick.now_ns, tick.index)
        next(self._handing)

    def _hand_over_whole(self, now_ns: int, index: int) -> None:
        self._end_handing()
        self._handing = self._hand_over(now_ns, index)
        self._end_handing()

    def _end_handing(self) -> None:
        for _ in self._handing:
            pass

    def _hand_over(self, now_ns: int, index: int) -> Iterator[None]:
        """End a batch and hand it over in steps; later traffic belongs to the next batch."""
        self._handed_ns = now_ns
        yield from self._inputs.hand_over()
        self._sink.put(
            BatchEnd(
                now_ns=now_ns,
                lost=self._inputs.lost(),
                tick=index,
                slips=self.executive.slips.slips,
                stalls=tuple(self.executive.take_stalls()),
                over_budget_ns=self.executive.take_over_budget_ns(),
            )
        )

    def _status(self, tick: Tick) -> None:
        self._sink.put(StatusReport(tick.now_ns, self.status(tick.now_ns)))
