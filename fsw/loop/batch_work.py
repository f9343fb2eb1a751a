"""What has come since the last batch: accepted, decoded and put into windows, in bounded stages."""

from __future__ import annotations

from collections.abc import Callable, Generator

from fsw.health import Health
from fsw.loop.bus_input import BusInput
from fsw.loop.inputs import Inputs
from fsw.loop.science import Science
from fsw.loop.window_work import ENDED, WindowWork
from fsw.scheduler.align import Aligner
from fsw.scheduler.tasks import TaskTimes, Tick

FOREVER_NS = 1 << 62
MOST_STAGES = 5  # of a batch with one bus; where it has no twice as many ticks it is done at once
Report = Callable[[str, str, str], None]


class BatchWork:
    """The batch in progress: one stage a tick.

    Parameters
    ----------
    ticks : length of a batch
    windows : receives the windows that close
    science : receives the newest samples; None: nobody asks for them
    report : receives events: severity, code, text
    """

    def __init__(
        self,
        ticks: int,
        inputs: Inputs,
        aligner: Aligner,
        health: Health,
        windows: WindowWork,
        science: Science | None,
        report: Report,
    ) -> None:
        self._ticks = ticks
        self._inputs, self._aligner, self._health = inputs, aligner, health
        self._windows, self._science, self._report = windows, science, report
        self.window_limit = FOREVER_NS  # no window is closed from this index on
        self._next = 0  # tick of the next batch
        self._stages: Generator[None, None, None] | None = None  # half done
        self._accepted_ns = -1  # when it began
        self._before_ns = -1  # when the batch before it began
        self.delays = TaskTimes()  # of what came first in a batch, from its arrival to its sample
        self._decoded = False

    @property
    def is_busy(self) -> bool:
        """Whether a batch is half done."""
        return self._stages is not None

    def take_decoded(self) -> bool:
        """Return whether a batch has been decoded since the last call."""
        decoded, self._decoded = self._decoded, False
        return decoded

    def advance(self, tick: Tick) -> None:
        """Begin a batch when it is due, and when a window is; do one stage of it."""
        deadline_ns = self._aligner.deadline_ns
        is_closing = deadline_ns is not None and self._accepted_ns < deadline_ns <= tick.now_ns
        if is_closing or tick.index >= self._next:
            self.finish()
            self._next = (tick.index // self._ticks + 1) * self._ticks
            self._before_ns, self._accepted_ns = self._accepted_ns, tick.now_ns
            self._stages = self._batch(tick.now_ns)
        if self._stages is None:
            return
        if self._ticks < 2 * MOST_STAGES:
            self.finish()
        elif next(self._stages, ENDED) is ENDED:
            self._stages = None
        if self._stages is None and self._before_ns >= 0:
            self.delays.add(tick.now_ns - self._before_ns)

    def finish(self) -> None:
        """Do what is left of the batch in progress."""
        stages, self._stages = self._stages, None
        for _ in stages or ():
            pass

    def end(self, now_ns: int) -> None:
        """Do a last batch, so that the recording ends when the run does."""
        self.finish()
        self._inputs.drain()
        self._stages = self._batch(now_ns)
        self.finish()

    def _batch(self, now_ns: int) -> Generator[None, None, None]:
        """Accept and decode what has come by now, close the windows due by now.

        Data that arrive meanwhile belong to the next batch.
        """
        align = self._aligner
        self._inputs.accept()
        if not align.started:
            first = self._inputs.first_sync_ns()
            if first is not None:
                align.start(first)
        for member in self._inputs:
            yield
            samples = member.feed()
            for other in member.other_samples() if isinstance(member, BusInput) else ():
                align.push(other)
            if samples is None or not len(samples):
                continue
            if isinstance(member, BusInput):
                yield
            known_steps = isinstance(member, BusInput) or not member.is_sampled
            align.push(self._health.screen(samples) if known_steps else samples)
            if self._science is not None:
                self._science.keep(samples)
        while (deadline_ns := align.deadline_ns) is not None:
            if deadline_ns > now_ns or align.next_index >= self.window_limit:
                break
            self._windows.add(align.close(deadline_ns))
        for member in self._inputs:
            member.watch(now_ns)
        self._decoded = True
        for bus in self._inputs.buses:
            for event in bus.source.events():
                self._report(*event)
