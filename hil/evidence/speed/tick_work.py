"""Processor time of the daemon's ticks in a virtual flight.

The loop itself runs, with its own tasks; simulated devices do their work in the wait, outside of
what is measured. Printed: how the work of a tick is distributed, and how many ticks exceed theirs.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: one core

import numpy as np

from fsw.exchange.sinks import NullSink
from fsw.loop import realtime
from fsw.loop.ports import Ports
from fsw.loop.wiring import build
from fsw.messages import FloatArray
from fsw.scheduler.tasks import Tick
from hil.devices.plant import Plant
from hil.links.virtual import VirtualBench
from hil.run.bench import T0_NS, prepare
from hil.world.scenario import BUS, load
from hil.world.sensors import SensorConfig

ESTIMATION = "estimate"  # the task that conditions, folds in and re-linearises


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TickWork:
    """Processor time per tick, (ticks,) each [s]."""

    rate_hz: float
    all_s: FloatArray
    estimation_s: FloatArray

    def lines(self) -> list[str]:
        """Return the report."""
        period_s = 1.0 / self.rate_hz
        parts = {"all tasks": self.all_s, "estimation": self.estimation_s}
        found = []
        for name, spent_s in parts.items():
            middle, high, higher = np.percentile(spent_s, (50.0, 99.0, 99.9))
            found.append(
                f"{self.rate_hz:g} Hz, {name}: median {1e3 * middle:.3f} ms, 99 % {1e3 * high:.3f},"
                f" 99.9 % {1e3 * higher:.3f}, longest {1e3 * spent_s.max():.3f}; "
                f"{np.sum(spent_s > period_s)} of {len(spent_s)} ticks beyond {1e3 * period_s:g} ms"
            )
        return found


def measure(scenario: str, seed: int, rate_hz: float | None = None) -> TickWork:
    """Fly a scenario in virtual time and take the processor time of every tick.

    `rate_hz` is the loop's rate; None: the scenario's. The garbage collector is kept away, as in
    the live loop.
    """
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        setup = prepare(load(scenario), seed, Path(folder))
        config = setup.config
        if rate_hz is not None:
            scheduler = config.scheduler.model_copy(update={"tick_rate_hz": rate_hz})
            config = config.model_copy(update={"scheduler": scheduler})
        sensors = SensorConfig.from_dict(setup.scenario.sensors)
        before_s = setup.scenario.before_s
        plant = Plant(setup.history, sensors, seed, start_delay_s=before_s, t0_ns=T0_NS)
        bench = VirtualBench(plant, T0_NS, seed=seed)
        ports = Ports(can={BUS: bench.can}, imu=bench.imu, star_tracker=bench.star_tracker)
        daemon = build(config, bench.clock, ports, NullSink())
    spent = {"all": 0.0, ESTIMATION: 0.0}

    def timed(name: str, run: Callable[[Tick], None]) -> Callable[[Tick], None]:
        def go(tick: Tick) -> None:
            begin = time.process_time()
            run(tick)
            elapsed = time.process_time() - begin
            spent["all"] += elapsed
            if name == ESTIMATION:
                spent[ESTIMATION] += elapsed

        return go

    tasks = daemon.executive._tasks  # noqa: SLF001 - the instrument sits around the loop's tasks
    daemon.executive._tasks = tuple(replace(t, run=timed(t.name, t.run)) for t in tasks)  # noqa: SLF001
    end_ns, rows = T0_NS + round(setup.total_s * 1e9), []
    realtime.freeze_garbage()
    try:
        while bench.clock.now_ns() < end_ns:
            spent.update(dict.fromkeys(spent, 0.0))
            daemon.step()
            rows.append((spent["all"], spent[ESTIMATION]))
    finally:
        gc.unfreeze()
        gc.enable()
    work = np.array(rows)
    return TickWork(
        rate_hz=config.scheduler.tick_rate_hz, all_s=work[:, 0], estimation_s=work[:, 1]
    )


def main(arguments: list[str] | None = None) -> int:
    """Print the report for each rate."""
    parser = argparse.ArgumentParser(
        prog="python -m hil.evidence.speed.tick_work", description=__doc__
    )
    parser.add_argument("scenario", nargs="?", default="both", help="of `hil list`; both")
    parser.add_argument("--seed", type=int, default=0, metavar="K")
    parser.add_argument("--rates", type=float, nargs="+", default=[500.0, 1000.0], metavar="HZ")
    options = parser.parse_args(arguments)
    for rate_hz in options.rates:
        lines = measure(options.scenario, options.seed, rate_hz).lines()
        sys.stdout.write("\n".join(lines) + "\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
