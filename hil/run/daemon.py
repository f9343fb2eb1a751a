"""The daemon in virtual time: loop and estimation in one process, called one after the other."""

from collections.abc import Callable
from typing import Any

from fsw.clock import Clock
from fsw.config import Config
from fsw.estimation.estimation import Estimation
from fsw.estimators.pipeline import Pipeline
from fsw.exchange.restart import Restart
from fsw.exchange.sinks import Fanout, JoinedStatus, Sink
from fsw.loop.ports import Ports
from fsw.loop.wiring import build
from fsw.messages import Estimate
from fsw.scheduler.tasks import Tick


class Daemon:
    """Loop and estimation of `fsw run` in one process; a sink replaces the service."""

    def __init__(
        self,
        config: Config,
        clock: Clock,
        ports: Ports,
        sink: Sink,
        *,
        pipeline: Pipeline | None = None,
    ) -> None:
        joined = JoinedStatus(sink)
        self.estimation = Estimation(config, clock.now_ns, joined, pipeline=pipeline)
        align = self.estimation.aligner
        self.loop = build(
            config, clock, ports, Fanout(self.estimation, joined), lambda: align.deadline_ns or 0
        )
        self._clock = clock
        self.executive, self.submit = self.loop.executive, self.loop.submit

    @property
    def latest(self) -> Estimate | None:
        """The newest estimate, or None."""
        return self.estimation.latest

    def step(self) -> Tick:
        """Run one tick."""
        return self.loop.step()

    def run(self, stop: Callable[[], bool]) -> None:
        """Run ticks until `stop()` returns True or a command ends the loop."""
        self.loop.run(stop)

    def restart(self, found: Restart) -> bool:
        """Continue from a checkpoint, before the first tick; return False for a cold start."""
        return self.estimation.restart(found)

    def shutdown(self) -> Estimate | None:
        """Process buffered samples, close the ports; return the last estimate, or None."""
        self.loop.finish()
        final = self.estimation.shutdown()
        self.loop.close()
        return final

    def status(self) -> dict[str, Any]:
        """Return health and counters of loop and estimation as plain values."""
        return {**self.loop.status(self._clock.now_ns()), **self.estimation.status()}
