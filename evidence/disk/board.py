"""The service of the daemon in virtual time, on real files and a real socket, fed from memory."""

import os
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import yaml

from evidence.disk.ground_end import COMMAND_KEY, TELEMETRY_KEY
from fsw.config import Config, load
from fsw.drivers.wire import ByteChunk
from fsw.exchange.ring import RingReader, RingWriter
from fsw.exchange.ringlink import TO_SERVICE, UP_BYTES, RingSink, commands_of
from fsw.exchange.sinks import EstimationStatus, Message, SerialTraffic, StatusReport
from fsw.loop.ports import Ports
from fsw.messages import Event
from fsw.messages.commands import Code, Reply
from fsw.service import process
from fsw.service.process import Service
from hil.devices.plant import Plant
from hil.links.virtual import VirtualBench
from hil.run import bench, live
from hil.run.daemon import Daemon
from hil.world.scenario import load as load_scenario
from hil.world.sensor_config import SensorConfig

STEP_NS = 200_000_000
CYCLES = 2  # of the service in a step
CHUNK_BYTES = 4000  # of the numbered message in each step
FLIGHT_S = 3.0
KEYS = {"command.key": COMMAND_KEY, "telemetry.key": TELEMETRY_KEY}


class Clock:
    """A clock that stands still until somebody sleeps or moves it."""

    def __init__(self, now_ns: int) -> None:
        self._now_ns = now_ns

    def now_ns(self) -> int:
        """Return the time [ns]."""
        return self._now_ns

    def cpu_time_ns(self) -> int:
        """Return 0: no processor time is judged here."""
        return 0

    def process_cpu_s(self) -> float:
        """Return 0: no processor time is judged here."""
        return 0.0

    def move(self, by_ns: int) -> None:
        """Let time pass [ns]."""
        self._now_ns += by_ns

    def sleep_until_ns(self, deadline_ns: int, wake_fds: Sequence[int] = ()) -> bool:  # noqa: ARG002
        """Move to the deadline."""
        self._now_ns = max(self._now_ns, deadline_ns)
        return True


class _Kept(list[Message]):
    def put(self, message: Message) -> None:
        if isinstance(message, TO_SERVICE) and not isinstance(message, StatusReport | Event):
            self.append(message)

    def close(self) -> None:
        """Do nothing."""


@lru_cache(maxsize=1)
def flight() -> tuple[Path, list[Message]]:
    """Return the configuration of a short flight, and the messages for a service in it."""
    folder = Path(mkdtemp(prefix="hil-disk-"))
    setup = bench.prepare(load_scenario("target_leo"), 1, folder, telemetry={"port": 0})
    rate_hz = float(setup.scenario.flight["bus"]["rate_hz"])
    sensors = SensorConfig.from_dict(setup.scenario.sensors)
    plant = Plant(
        setup.history, sensors, 1, start_delay_s=0.1, t0_ns=bench.T0_NS, sync_rate_hz=rate_hz
    )
    world, kept = VirtualBench(plant, bench.T0_NS, seed=1), _Kept()
    cans = dict.fromkeys((bus.name for bus in setup.config.buses), world.can)
    ports = Ports(can=cans, imu=world.imu, star_tracker=world.star_tracker)
    daemon = Daemon(setup.config, world.clock, ports, kept)
    while world.clock.now_ns() < bench.T0_NS + FLIGHT_S * 1e9:
        daemon.step()
    daemon.shutdown()
    return setup.config_path, list(kept)


def configuration(folder: Path, disk: Path) -> Config:
    """Return the flight's configuration with keys, and with its state and recordings on a disk."""
    path, _ = flight()
    data: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    for name, key in KEYS.items():
        (folder / name).write_bytes(key)
        (folder / name).chmod(0o600)
    slots = [
        {"spi": 1, "file": str(folder / "command.key")},
        {"spi": 2, "file": str(folder / "telemetry.key"), "role": "telemetry"},
    ]
    data["telemetry"] = {
        "port": live.free_tcp_port(),
        "tc_security": "sdls",
        "sdls": {"keys": slots, "window": 1000},
        "packet_stores": dict.fromkeys(
            ("events_bytes", "housekeeping_bytes", "science_bytes"), 1 << 20
        ),
    }
    data["recorder"] = {"directory": str(disk / "recordings"), "compression": "none"}
    data["service"] = {"state_directory": str(disk / "state"), "disk_reserve_bytes": 1 << 18}
    new = path.with_name(f"{folder.name}.yaml")
    new.write_text(yaml.safe_dump(data), encoding="utf-8")
    return load(new)


class Board:
    """A running service; a step lasts 0.2 s and writes one numbered message."""

    def __init__(self, config: Config, now_ns: int, first: int) -> None:
        process.POLL_S = 0.0  # the clock is virtual: nobody waits
        self.clock = Clock(now_ns)
        down, found, up = (RingWriter.create(1 << 22), *(RingWriter.create(UP_BYTES) for _ in "12"))
        self._commands = RingReader(os.dup(up.fd))
        self._sink = RingSink(down, TO_SERVICE)
        self._estimation = RingSink(found, (EstimationStatus,))
        self._messages = iter(flight()[1])
        self.given = first
        self.port = config.telemetry.port if config.telemetry is not None else 0
        rings = RingReader(os.dup(down.fd)), RingReader(os.dup(found.fd)), up
        self.service = Service(config, self.clock, *rings, resume=False)
        self.service.open()

    def step(self) -> None:
        """Run 0.2 s."""
        self.clock.move(STEP_NS)
        now_ns = self.clock.now_ns()
        for _, message in zip(range(8), self._messages, strict=False):
            self._sink.put(message)
        data = self.given.to_bytes(8, "big") + os.urandom(CHUNK_BYTES)
        self._sink.put(SerialTraffic("numbered", [ByteChunk(now_ns, data)]))
        self.given += 1
        self._estimation.put(EstimationStatus({"identifying": True}))
        self._sink.put(StatusReport(now_ns, {}))
        for _ in range(CYCLES):
            self.service.cycle()
            for command in commands_of(self._commands):
                name = str(command.name)
                self._sink.put(
                    Reply(id=command.id, command=name, accepted=True, code=Code.ACCEPTED)
                )

    def slow_syncs(self, by_ns: int) -> None:
        """Let every sync of the service's own thread last for a time [ns]."""

        def slowed(real: Callable[[int], None]) -> Callable[[int], None]:
            def sync(descriptor: int) -> None:
                if threading.current_thread() is threading.main_thread():
                    self.clock.move(by_ns)
                real(descriptor)

            return sync

        os.fsync, os.fdatasync = slowed(os.fsync), slowed(os.fdatasync)  # type: ignore[assignment]

    @property
    def lost(self) -> int:
        """Number of messages that the recorder says it has lost."""
        return int(self.service._switch.lost)  # noqa: SLF001

    @property
    def codes(self) -> dict[str, int]:
        """Counts of the events so far."""
        return dict(self.service._event_counts)  # noqa: SLF001

    def close(self) -> None:
        """End the service in order."""
        with suppress(OSError):
            self.service.close()
