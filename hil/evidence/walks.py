"""Walks of one value through the flight software, counted from a traced run in virtual time.

`python -m hil.evidence walks` prints the functions of fsw that one joint torque passes, from the
CAN frame that its port returns to the telemetry packet that holds the estimate. The loop and the
service run in one process here, joined by their real rings.

A function is a hop when something that holds the value goes in or comes out:

- the frame, its bytes, the torque as a number or in an array, or what contains one of them; after
  the first estimate that knows the torque, that estimate;
- everything a hop returns;
- arrays and bytes that a hop hands to the function it calls: it has computed them;
- the state of an object that keeps the value (`KEEPERS`): its methods carry it from then on.

Every function counts once. `all` is every hop in the order of its first entry; `hops` leaves out
what branches off, such as the recorder and the arithmetic whose result comes back: each step is
followed to the one it got the value from. Not seen are the port, which is the bench's here, and
other processes.
"""

from __future__ import annotations

import json
import os
import sys
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, FrameType

import numpy as np

import fsw
from fsw.drivers.wire import CanFrame, FrameArray, frame_list
from fsw.exchange.ring import RingReader, RingWriter
from fsw.exchange.ringlink import DOWN_BYTES, UP_BYTES, RingSink
from fsw.loop.ports import SECOND, Ports
from fsw.loop.wiring import build
from fsw.messages import Estimate
from fsw.service.process import Service
from hil.devices.plant import Plant
from hil.links.virtual import VirtualBench
from hil.run.bench import T0_NS, Setup, prepare
from hil.run.flight import TORQUE_STEP_NM
from hil.world.scenario import BUS, load
from hil.world.sensors import SensorConfig

SCENARIO = "target_leo"
WARM_S = 3.0  # the motion continues and estimates are published
PATIENCE_S = 3.0  # virtual, from the frame to its packet
KEEPERS = ("fsw.estimators", "fsw.scheduler.align", "fsw.telemetry")
COMPUTING = "fsw.estimators"  # where what is handed on has been computed from what came in
END = "fsw.telemetry.link.server"
SOURCE = str(Path(fsw.__file__).parent)
MOST_ITEMS, MOST_VALUES, MOST_BYTES, DEPTH = 64, 4096, 1 << 14, 3
LEAST_BYTES = 16  # shorter ones are alike by chance
FIRST_TPDO1 = 0x181


@dataclass(frozen=True, slots=True)
class WalkStep:
    """One entry of a hop, and the step it got the value from."""

    name: str
    before: WalkStep | None


class Tracer:
    """Follows one frame; a profile function of the interpreter."""

    def __init__(self, frame: CanFrame) -> None:
        self.hops: dict[str, None] = {}
        self.forms: dict[str, None] = {}  # types of what holds the value
        self.end: WalkStep | None = None
        self._estimated = False
        start = WalkStep("", None)
        self._kept: list[object] = [frame]  # so that no number comes again
        self._makers: dict[object, WalkStep] = {id(frame): start, bytes(frame.data): start}
        self._bytes: list[bytes] = [bytes(frame.data)]
        torque_nm = TORQUE_STEP_NM["classic"] * int.from_bytes(
            frame.data[4:6], "little", signed=True
        )
        self._torques_nm = (torque_nm, -torque_nm)  # as a joint of either sign has it
        self._makers |= dict.fromkeys(self._torques_nm, start)
        self._hopping: dict[int, WalkStep] = {}  # by frame of the interpreter

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        """Look at a call or a return."""
        code = frame.f_code
        if self.end is not None or not code.co_filename.startswith(SOURCE):
            return
        if event == "call":
            self._called(frame, code)
        elif event == "return":
            self._returned(frame, code, argument)

    def way(self) -> list[str]:
        """Return the hops that lead to the end, without what branches off; each once."""
        names, step = [], self.end
        while step is not None and step.name:
            names.append(step.name)
            step = step.before
        return list(dict.fromkeys(reversed(names)))

    def _called(self, frame: FrameType, code: CodeType) -> None:
        module = str(frame.f_globals.get("__name__"))
        caller = self._hopping.get(id(frame.f_back))
        for name, value in arguments(frame, code):
            own = name == "self"
            maker = self._makers.get(id(value)) if own else self.maker(value)
            if maker is not None:
                self._hop(frame, code, module, caller or maker)
            elif caller is not None and not own and is_computed(value, module):
                self._hop(frame, code, module, caller)
                self.learn(value, caller)
        if module == END:
            self.end = self._hopping.get(id(frame))

    def _returned(self, frame: FrameType, code: CodeType, value: object) -> None:
        module = str(frame.f_globals.get("__name__"))
        step = self._hopping.pop(id(frame), None)
        if value is None or isinstance(value, bool | int | str):
            keeper = frame.f_locals.get("self")
            if step is not None and keeper is not None and module.startswith(KEEPERS):
                self._kept.append(keeper)
                self._makers[id(keeper)] = step  # the newest
            return
        maker = self.maker(value)
        if step is None and maker is not None:
            step = self._hop(frame, code, module, maker)
            self._hopping.pop(id(frame), None)
        if step is not None:
            self.learn(value, step)

    def _hop(self, frame: FrameType, code: CodeType, module: str, before: WalkStep) -> WalkStep:
        step = self._hopping.get(id(frame))
        if step is None:
            step = self._hopping[id(frame)] = WalkStep(f"{module}:{code.co_qualname}", before)
            self.hops.setdefault(step.name)
        return step

    def learn(self, value: object, maker: WalkStep) -> None:
        """Remember something that holds the value, and the step that made it."""
        if isinstance(value, bool | int | float | str | type(None)):
            return
        self._kept.append(value)
        self._makers.setdefault(id(value), maker)
        self.forms.setdefault(type(value).__name__)
        if not self._estimated and self._holds_torque(value):
            self._makers |= dict.fromkeys(self._torques_nm, maker)
        if isinstance(value, Estimate) and not self._estimated:
            self._estimated = True  # from here on the estimate is followed, and nothing else
            self._makers, self._bytes, self._hopping = {id(value): maker}, [], {}
            return
        if isinstance(value, bytes | bytearray | memoryview) and len(value) >= LEAST_BYTES:
            self._bytes.append(bytes(value))
            self._makers.setdefault(bytes(value), maker)
        if is_dataclass(value):
            for field in fields(value):
                found = getattr(value, field.name)
                if "torque" in field.name and isinstance(found, float):
                    self._makers.setdefault(found, maker)

    def _holds_torque(self, value: object) -> bool:
        """Return whether an array, or an array of a data class, has the torque in it."""
        if is_dataclass(value) and not isinstance(value, type):
            return any(self._holds_torque(getattr(value, field.name)) for field in fields(value))
        if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
            return False
        return bool(np.isin(value, self._torques_nm).any())

    def maker(self, value: object, depth: int = DEPTH) -> WalkStep | None:
        """Return the step that made what holds the value in something; None if nothing does."""
        if id(value) in self._makers:
            return self._makers[id(value)]
        if isinstance(value, float):
            return self._makers.get(float(value))
        if isinstance(value, bytes | bytearray | memoryview):
            data = bytes(value)
            known = (item for item in reversed(self._bytes) if item in data)
            found = None if len(data) > MOST_BYTES else next(known, None)
            return None if found is None else self._makers[found]
        if isinstance(value, np.ndarray):
            if value.dtype.kind in "Vu":
                return self.maker(value.tobytes())
            numbers = value.ravel()[:MOST_VALUES] if value.dtype.kind == "f" else ()
            return first(self._makers.get(float(number)) for number in numbers)
        return first(self.maker(item, depth - 1) for item in items(value)) if depth else None


def first(found: Iterable[WalkStep | None]) -> WalkStep | None:
    """Return the first step there is."""
    return next((step for step in found if step is not None), None)


def items(value: object) -> Iterator[object]:
    """Yield what a plain container or a data class holds."""
    if isinstance(value, list | tuple | deque):
        yield from list(value)[-MOST_ITEMS:]
    elif isinstance(value, Mapping):
        yield from list(value.values())[-MOST_ITEMS:]
    elif is_dataclass(value) and not isinstance(value, type):
        yield from (getattr(value, field.name, None) for field in fields(value))


def arguments(frame: FrameType, code: CodeType) -> Iterator[tuple[str, object]]:
    """Yield the arguments of a call with their names."""
    count = code.co_argcount + code.co_kwonlyargcount
    count += bool(code.co_flags & 0x04) + bool(code.co_flags & 0x08)  # *args, **kwargs
    values = frame.f_locals
    yield from ((name, values[name]) for name in code.co_varnames[:count] if name in values)


def is_computed(value: object, module: str) -> bool:
    """Return whether a hop computed its argument: an array of an estimator, or bytes."""
    if isinstance(value, np.ndarray):
        return module.startswith(COMPUTING) and value.dtype.kind == "f"
    return isinstance(value, bytes | bytearray) and len(value) >= LEAST_BYTES


def torque_walk() -> Tracer:
    """Return the walk of one joint torque from its frame to a telemetry packet.

    Raises
    ------
    RuntimeError when no packet came.
    """
    with TemporaryDirectory(prefix="walk-") as name:
        telemetry = {"port": 0, "housekeeping_interval_s": 0.1, "science_interval_s": 0.1}
        setup = prepare(load(SCENARIO), 1, Path(name), real_time=True, telemetry=telemetry)
        return _followed(setup)


def _followed(setup: Setup) -> Tracer:
    sensors = SensorConfig.from_dict(setup.scenario.sensors)
    plant = Plant(setup.history, sensors, setup.seed, start_delay_s=1.0, t0_ns=T0_NS)
    world = VirtualBench(plant, T0_NS, seed=setup.seed)
    ports = Ports(
        can={BUS: world.can, BUS + SECOND: world.redundant},
        imu=world.imu,
        star_tracker=world.star_tracker,
    )
    down, up = RingWriter.create(DOWN_BYTES), RingWriter.create(UP_BYTES)
    daemon = build(setup.config, world.clock, ports, RingSink(down))
    service = Service(setup.config, world.clock, RingReader(os.dup(down.fd)), up, resume=False)
    service.open()
    tracer: Tracer | None = None
    read = world.can.read

    def read_and_follow() -> FrameArray:
        nonlocal tracer
        frames = read()
        if tracer is None and world.clock.now_ns() > T0_NS + round(WARM_S * 1e9):
            for frame in frame_list(frames):
                if frame.can_id >= FIRST_TPDO1 and len(frame.data) >= 6:
                    tracer = Tracer(frame)
                    sys.setprofile(tracer)
                    break
        return frames

    world.can.read = read_and_follow  # type: ignore[method-assign]
    try:
        while world.clock.now_ns() < T0_NS + round((WARM_S + PATIENCE_S) * 1e9):
            daemon.step()
            service.cycle()
            if tracer is not None and tracer.end:
                return tracer
    finally:
        sys.setprofile(None)
        daemon.shutdown()
        service.close()
    raise RuntimeError(f"no packet; {list(tracer.hops) if tracer else 0}")


def main() -> int:
    """Print the walks; return 0."""
    walk = torque_walk()
    way = walk.way()
    counts = {"touched": len(walk.hops), "way": len(way), "forms": len(walk.forms)}
    values = {"torque": {**counts, "hops": way, "all": list(walk.hops), "types": list(walk.forms)}}
    sys.stdout.write(json.dumps(values, indent=1) + "\n")
    return 0
