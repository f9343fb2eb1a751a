"""A daemon on a simulated plant that a test flies, stops and starts again."""

from typing import Any

from fsw.exchange.sinks import Message, NullSink
from fsw.loop.ports import Ports
from fsw.messages import Block, Estimate, Event, Snapshot
from hil.devices.plant import Plant
from hil.links.virtual import VirtualBench
from hil.run.bench import T0_NS, Setup
from hil.run.daemon import Daemon
from hil.world.scenario import BUS
from hil.world.sensors import SensorConfig

S = 1_000_000_000


class Kept(NullSink):
    """Keeps states, estimates and events."""

    def __init__(self) -> None:
        self.snapshots: list[Snapshot] = []
        self.published = 0
        self.blocks: list[Block] = []
        self.estimates: list[Estimate] = []
        self.events: list[Event] = []

    def put(self, message: Message) -> None:
        match message:
            case Snapshot():
                self.snapshots.append(message)
                self.published = len(self.estimates)  # before the newest state
            case Block():
                self.blocks.append(message)
            case Estimate():
                self.estimates.append(message)
            case Event():
                self.events.append(message)


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
