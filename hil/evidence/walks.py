"""Count the calls on the way of one value through fsw: `python -m hil.evidence walks`.

A walk is the way of one value through the functions of fsw. A run in virtual time gives two walks:
that of a joint torque, from the CAN frame to the telemetry packet with the estimate, and that of a
RUN_BATCH, from the bytes of its TCP connection through the worker to its result. A walk is a list
of stations; a station is a function and the argument that holds the value. A hop is a function of
fsw on the call stack at a station, the station included; each function counts once. A form is the
type of a station's argument. Functions that return before the next station are not counted.

Loop, estimation, service and worker run in one process here; their rings and pipes are real.
"""

import io
import json
import os
import pickle
import socket
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

import fsw
from fsw.exchange.ring import RingReader, RingWriter
from fsw.exchange.ringlink import DOWN_BYTES, TO_ESTIMATION, TO_SERVICE, UP_BYTES, RingSink
from fsw.exchange.sinks import Fanout
from fsw.loop.estimation.estimation import Estimation
from fsw.loop.estimation.process import work_off
from fsw.loop.ports import SECOND, Ports
from fsw.loop.wiring import build
from fsw.service import batch_jobs, worker
from fsw.service.process import Service
from fsw.service.worker import Job
from fsw.telemetry.dictionary import DICTIONARY
from fsw.telemetry.dictionary.codes import METHOD
from fsw.telemetry.link.packets import telecommand_packet
from hil.devices.plant import Plant
from hil.links.virtual import VirtualBench
from hil.run.bench import T0_NS, prepare
from hil.world.scenario import BUS, load
from hil.world.sensor_config import SensorConfig

SCENARIO = "target_leo"
WARM_S = 3.0  # virtual time before a walk: the arm then moves and estimates are published
PATIENCE_S = 3.0  # longest virtual time of a walk
SOURCE = str(Path(fsw.__file__).parent)
CROSSING = ("unpack_traffic", "message_of")  # stations at which a process reads from a ring


@dataclass(frozen=True, slots=True)
class Station:
    """A function, by its qualified name, and the name and type of the argument with the value."""

    function: str
    argument: str
    form: str

    def is_entered(self, frame: FrameType) -> bool:
        """Return whether a frame enters the station's function with an argument of its type."""
        if frame.f_code.co_qualname != self.function:
            return False
        return type(frame.f_locals[self.argument]).__name__ == self.form


TORQUE = (
    Station("RingSink.put", "message", "CanTraffic"),
    Station("RingWriter.push", "payload", "bytes"),
    Station("unpack_traffic", "record", "RingRecord"),
    Station("JointBusSource.feed", "frames", "ndarray"),
    Station("decode_tpdo1", "data", "ndarray"),
    Station("Aligner.push", "samples", "JointSamples"),
    Station("_Channel.window", "values", "ndarray"),
    Station("Estimation._use", "window", "Window"),
    Station("NodeFit.coefficients", "values", "ndarray"),
    Station("Recursion.fold", "block", "Block"),
    Station("predict", "block", "BlockStack"),
    Station("SquareRootInformation.update", "A", "ndarray"),
    Station("outcome", "x", "ndarray"),
    Station("RingSink.put", "message", "Estimate"),
    Station("RingWriter.push", "payload", "bytes"),
    Station("message_of", "record", "RingRecord"),
    Station("TelemetryApplication.estimate", "estimate", "Estimate"),
    Station("estimate_values", "estimate", "Estimate"),
    Station("Packetizer.make", "values", "dict"),
    Station("LinkServer.send", "packet", "bytes"),
)
RUN_BATCH = (
    Station("PacketSplitter.feed", "chunk", "bytes"),
    Station("TelecommandReader.read", "packet", "bytes"),
    Station("Functions._run_batch", "request", "Request"),
    Station("BatchJobs.carry_out", "command", "Command"),
    Station("read_blocks", "path", "PosixPath"),
    Station("run_batch", "blocks", "list"),
    Station("main.<locals>.tell", "report", "JobReport"),
    Station("BatchJobs._follow", "values", "dict"),
    Station("LatestValues.record_job", "report", "JobReport"),
)


class Walk:
    """A profile function of the interpreter that waits for one station after the other."""

    def __init__(self, stations: Sequence[Station]) -> None:
        self._ahead = list(stations)
        self.hops: dict[str, None] = {}
        self.forms: dict[str, None] = {}

    @property
    def is_over(self) -> bool:
        """Whether the last station has been entered."""
        return not self._ahead

    def __call__(self, frame: FrameType, event: str, _argument: object) -> None:
        """Record the hops and the form if a call enters the next station."""
        code = frame.f_code
        if event != "call" or self.is_over or not code.co_filename.startswith(SOURCE):
            return
        station = self._ahead[0]
        if station.is_entered(frame):
            self.forms.setdefault(station.form)
            self.hops |= dict.fromkeys(reversed([name_of(at) for at in hops_of(frame)]))
            self._ahead.pop(0)

    def ahead(self) -> str:
        """Return the function of the next station, which was not reached."""
        return self._ahead[0].function

    def values(self) -> dict[str, Any]:
        """Return the counts of the walk, and the names of its hops and forms, as JSON values."""
        return {
            "hops": len(self.hops),
            "files": len({name.partition(":")[0] for name in self.hops}),
            "forms": len(self.forms),
            "ring_crossings": sum(name.endswith(CROSSING) for name in self.hops),
            "names": list(self.hops),
            "types": list(self.forms),
        }


def hops_of(frame: FrameType | None) -> Iterator[FrameType]:
    """Yield the frames of fsw on a call stack, innermost first; comprehensions are left out."""
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith(SOURCE) and code.co_name[0] != "<":
            yield frame
        frame = frame.f_back


def name_of(frame: FrameType) -> str:
    """Return "module:function" of a frame."""
    return f"{frame.f_globals.get('__name__')}:{frame.f_code.co_qualname}"


class EndedWorker:
    """A batch worker that ran in this process and has ended; it stands in for a `Popen`."""

    def __init__(self, job: Job) -> None:
        target = io.StringIO()
        self._code = worker.main(io.BytesIO(pickle.dumps(job)), target)
        self.stdout = io.BytesIO(target.getvalue().encode())

    def poll(self) -> int:
        """Return the exit code."""
        return self._code

    def terminate(self) -> None:
        """Do nothing: the worker has ended."""

    def wait(self) -> int:
        """Return the exit code."""
        return self._code


class WalkedBench:
    """Loop, estimation and service of one flight, run in this process and in virtual time."""

    def __init__(self, folder: Path) -> None:
        telemetry = {"port": 0, "housekeeping_interval_s": 0.1, "science_interval_s": 0.1}
        setup = prepare(load(SCENARIO), 1, folder, real_time=True, telemetry=telemetry)
        sensors = SensorConfig.from_dict(setup.scenario.sensors)
        plant = Plant(setup.history, sensors, setup.seed, start_delay_s=1.0, t0_ns=T0_NS)
        world = VirtualBench(plant, T0_NS, seed=setup.seed)
        ports = Ports(
            can={BUS: world.can, BUS + SECOND: world.redundant},
            imu=world.imu,
            star_tracker=world.star_tracker,
        )
        down, found, stream = (RingWriter.create(DOWN_BYTES) for _ in range(3))
        sink = Fanout(RingSink(stream, TO_ESTIMATION), RingSink(down, TO_SERVICE))
        config, self._clock = setup.config, world.clock
        self._loop = build(config, world.clock, ports, sink, lambda: stream.notes[0])
        found_sink = RingSink(found, TO_SERVICE)
        self._estimation = Estimation(config, world.clock.now_ns, found_sink)
        self._stream, *inbox = (RingReader(os.dup(ring.fd)) for ring in (stream, down, found))
        up = RingWriter.create(UP_BYTES)
        self._service = Service(config, world.clock, inbox[0], inbox[1], up, resume=False)
        self._service.open()
        self.state = setup.config.resolve(setup.config.service.state_directory)

    def fly(self, duration_s: float, walk: Walk | None = None) -> None:
        """Simulate for `duration_s` of virtual time [s], or until the walk is over."""
        end_ns = self._clock.now_ns() + round(duration_s * 1e9)
        while self._clock.now_ns() < end_ns and not (walk and walk.is_over):
            self._loop.step()
            work_off(self._estimation, self._stream)
            self._service.cycle()

    def walk(self, stations: Sequence[Station]) -> Walk:
        """Simulate until the walk is over; return it. Raise RuntimeError if a station is missed."""
        walk = Walk(stations)
        sys.setprofile(walk)
        try:
            self.fly(PATIENCE_S, walk)
        finally:
            sys.setprofile(None)
        if not walk.is_over:
            raise RuntimeError(f"{walk.ahead()} was not reached")
        return walk

    def close(self) -> None:
        """Close loop and service."""
        self._loop.close()
        self._service.close()


@contextmanager
def warm_bench() -> Iterator[WalkedBench]:
    """Yield a bench that publishes estimates; close it at the end."""
    with TemporaryDirectory(prefix="walk-") as name, closing(WalkedBench(Path(name))) as bench:
        bench.fly(WARM_S)
        yield bench


def torque_walk(bench: WalkedBench) -> Walk:
    """Return the walk of one joint torque from its frame to a telemetry packet."""
    return bench.walk(TORQUE)


def batch_walk(bench: WalkedBench) -> Walk:
    """Return the walk of one RUN_BATCH from the bytes of its telecommand to its result."""
    started = batch_jobs._worker  # noqa: SLF001 - a profile function sees only this process
    batch_jobs._worker = EndedWorker  # type: ignore[assignment] # noqa: SLF001
    item = DICTIONARY.telecommand("RUN_BATCH")
    arguments = {"method": METHOD.value("FUSED"), "unknown": 0, "last_s": 60.0}
    try:
        port = json.loads((bench.state / "status.json").read_text())["telemetry"]["port"]
        with socket.create_connection(("127.0.0.1", port)) as ground:
            ground.sendall(telecommand_packet(item, arguments, 1))
            return bench.walk(RUN_BATCH)
    finally:
        batch_jobs._worker = started  # noqa: SLF001


def main() -> int:
    """Print both walks as JSON; return the exit code 0."""
    with warm_bench() as bench:
        walks = {"torque": torque_walk(bench).values(), "run_batch": batch_walk(bench).values()}
    sys.stdout.write(json.dumps(walks, indent=1) + "\n")
    return 0
