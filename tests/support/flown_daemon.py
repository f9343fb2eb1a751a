"""A daemon on a simulated plant that a test flies, stops and starts again."""

from typing import Any

from fsw.exchange.sinks import Message
from fsw.loop.ports import Ports
from fsw.messages import Snapshot
from hil.devices.plant import Plant
from hil.links.virtual import VirtualBench
from hil.run.bench import T0_NS, Setup
from hil.run.collector import Collector
from hil.run.daemon import Daemon
from hil.world.scenario import BUS
from hil.world.sensor_config import SensorConfig

S = 1_000_000_000


class Kept(Collector):
    """Keeps the states of the estimation too."""

    def __init__(self) -> None:
        super().__init__()
        self.snapshots: list[Snapshot] = []
        self.published = 0

    def put(self, message: Message) -> None:
        super().put(message)
        if isinstance(message, Snapshot):
            self.snapshots.append(message)
            self.published = len(self.estimates)  # before the newest state


def bench_of(setup: Setup) -> VirtualBench:
    sensors = SensorConfig.from_dict(setup.scenario.sensors)
    plant = Plant(setup.history, sensors, setup.seed, start_delay_s=1.0, t0_ns=T0_NS)
    return VirtualBench(plant, T0_NS, seed=setup.seed)


def daemon_on(setup: Setup, bench: VirtualBench, sink: Any) -> Daemon:
    ports = Ports(can={BUS: bench.can}, imu=bench.imu, star_tracker=bench.star_tracker)
    return Daemon(setup.config, bench.clock, ports, sink)


def fly(daemon: Daemon, bench: VirtualBench, until_s: float) -> None:
    end_ns = T0_NS + round(until_s * S)
    daemon.run(lambda: bench.clock.now_ns() >= end_ns)
