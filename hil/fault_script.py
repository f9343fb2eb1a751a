"""Faults by name, as a scenario's `faults:` lists them, put onto the links of a virtual bench.

`install(..., reference=True)` puts in place of each fault what it truly takes away: the samples
that are gone, or the values of them that a sensor at fault cannot have measured. What a run with a
fault is held against is a run with the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hil import fault_values as values
from hil import faults
from hil.devices.can_segment import TimedFrame
from hil.devices.canopen import NMT_ID, SYNC_ID
from hil.devices.uart import TimedBytes
from hil.faults import ByteAction, FrameAction, Struck, chain
from hil.links import ERROR_FLAG, VirtualBench, VirtualSerial
from hil.scenario import FaultEntry, ScenarioError

NODE = 0x13
STRANGER = 0x2A
MS = 1_000_000
ERROR_BUS = 0x088  # protocol violation, bus error
ERROR_BUS_OFF, ERROR_RESTARTED = 0x040, 0x100
NO_TORQUE = 0x08  # status: the encoder is valid, the torque is not
INTEGRITY, START_UP, OVERLOAD = 0x80, 0x40, 0x10  # of a cluster of the inertial unit
RESTART_S = 0.3  # start-up of an inertial unit after power-on


@dataclass(slots=True)
class Place:
    """Where one fault goes."""

    entry: FaultEntry
    world: VirtualBench
    seed: int
    reference: bool
    start_ns: int
    struck: list[Struck[Any]] = field(default_factory=list)
    returned_ns: int = 0  # when the device is itself again

    def __post_init__(self) -> None:
        """By default at the end of the window."""
        self.returned_ns = self.window_ns[1]

    @property
    def began_ns(self) -> int:
        """When the fault first did something."""
        struck = [s.first_ns for s in self.struck if s.first_ns is not None]
        return min(struck, default=self.window_ns[0])

    @property
    def window_ns(self) -> tuple[int, int]:
        """From and to on the bench's clock."""
        first = self.start_ns + round(self.entry.at_s * 1e9)
        return first, first + round(self.entry.for_s * 1e9)

    def size(self, default: float) -> float:
        """Return how much."""
        return default if self.entry.size is None else self.entry.size

    @property
    def node(self) -> int:
        """The node in question."""
        return self.entry.node_id or NODE

    @property
    def answers(self) -> Callable[[TimedFrame], bool]:
        """Whether a frame is the node's sample."""
        can_id = faults.TPDO1_ID + self.node
        return lambda frame: frame[1] == can_id

    def can(
        self,
        action: FrameAction,
        instead: FrameAction,
        rate: float = 1.0,
        only: Callable[[TimedFrame], bool] | None = None,
        *,
        rest: int = 0,
    ) -> Struck[TimedFrame]:
        """Strike frames on their way to the host."""
        return self.can_within(self.window_ns, action, instead, rate, only, rest=rest)

    def can_within(
        self,
        window_ns: tuple[int, int],
        action: FrameAction,
        instead: FrameAction,
        rate: float = 1.0,
        only: Callable[[TimedFrame], bool] | None = None,
        *,
        rest: int = 0,
    ) -> Struck[TimedFrame]:
        """Strike frames within another window."""
        struck = Struck(
            instead if self.reference else action,
            self.entry.rate or rate,
            self.seed,
            only=only or self.answers,
            window_ns=window_ns,
            rest=rest,
        )
        self.world.can.tap = chain(self.world.can.tap, struck)
        self.struck.append(struck)
        return struck

    def serial(self, device: str) -> VirtualSerial:
        """Return the line of the device."""
        return self.world.serials[self.entry.device or device]

    def line(
        self,
        device: str,
        action: ByteAction,
        instead: ByteAction,
        rate: float = 1.0,
        *,
        until_ns: int | None = None,
        rest: int = 0,
    ) -> None:
        """Strike transmissions of a serial device."""
        first, last = self.window_ns
        struck = Struck(
            instead if self.reference else action,
            self.entry.rate or rate,
            self.seed,
            window_ns=(first, until_ns or last),
            rest=rest,
        )
        port = self.serial(device)
        port.tap = chain(port.tap, struck)
        self.struck.append(struck)


Type = Callable[[Place], None]


def _frame(action: FrameAction, instead: FrameAction, rate: float = 1.0, *, rest: int = 0) -> Type:
    def put(place: Place) -> None:
        place.can(action, instead, rate, rest=rest)

    return put


def _line(
    device: str, action: ByteAction, instead: ByteAction, rate: float = 1.0, *, rest: int = 0
) -> Type:
    def put(place: Place) -> None:
        place.line(device, action, instead, rate, rest=rest)

    return put


def _status(status: int, *, torque_only: bool) -> Type:
    lost = faults.change_frame(status=NO_TORQUE) if torque_only else faults.drop
    return _frame(faults.change_frame(status=status), lost)


def _torque(change: Callable[[Place], values.Change], rate: float = 1.0, rest: int = 0) -> Type:
    def put(place: Place) -> None:
        lost = faults.change_frame(status=NO_TORQUE)
        place.can(values.torque(change(place)), lost, rate, rest=rest)

    return put


def _position(change: Callable[[Place], values.Change], rate: float = 1.0, rest: int = 0) -> Type:
    def put(place: Place) -> None:
        place.can(values.position(change(place)), faults.drop, rate, rest=rest)

    return put


def _inertial(
    cluster: str, change: Callable[[Place], values.Change], rate: float = 1.0, rest: int = 0
) -> Type:
    def put(place: Place) -> None:
        bits = {cluster: INTEGRITY}
        changes = [change(place) for _ in range(3)]
        action = values.inertial(cluster, changes)
        place.line("imu", action, values.flagged(**bits), rate, rest=rest)

    return put


def _frame_reorder(place: Place) -> None:
    tap = place.world.can.tap
    struck = place.can(faults.keep, faults.drop, 0.02, rest=20)
    if not place.reference:
        place.world.can.tap = chain(tap, faults.Overtaken(struck))


def _frame_delay(place: Place) -> None:
    late: faults.Delayed[TimedFrame] = faults.Delayed(round(place.size(0.003) * 1e9))
    place.can(late, faults.keep)
    behind: Struck[TimedFrame] = Struck(
        faults.keep if place.reference else late.follow,
        1.0,
        place.seed,
        only=place.answers,
        window_ns=(place.window_ns[1], faults.FOREVER_NS),
    )
    place.world.can.tap = chain(place.world.can.tap, behind)


def _delayed_line(
    place: Place, device: str, late: faults.Delayed[TimedBytes], instead: ByteAction
) -> None:
    place.line(device, late, instead)
    behind: Struck[TimedBytes] = Struck(
        faults.keep if place.reference else late.follow,
        1.0,
        place.seed,
        window_ns=(place.window_ns[1], faults.FOREVER_NS),
    )
    port = place.serial(device)
    port.tap = chain(port.tap, behind)


def _jitter(place: Place) -> None:
    scattered: faults.Delayed[TimedBytes] = faults.Delayed(0, round(place.size(0.0039) * 1e9))
    _delayed_line(place, "imu", scattered, faults.keep)


def _bus_errors(place: Place) -> None:
    """Turn frames damaged on the bus into an error frame and the frame sent again."""

    def spoil(frame: TimedFrame, _rng: object) -> list[TimedFrame]:
        error = (frame[0], ERROR_FLAG | ERROR_BUS, bytes(8), False)
        return [error, (frame[0] + 150_000, *frame[1:])]

    place.can(spoil, faults.keep, 0.05, faults.is_tpdo1)


def _wrong_node(place: Place) -> None:
    def renamed(frame: TimedFrame, _rng: object) -> list[TimedFrame]:
        return [(frame[0], frame[1] - place.node + STRANGER, frame[2], frame[3])]

    place.can(renamed, faults.drop, 1.0, faults.is_node(place.node))


def _sync_lost(place: Place) -> None:
    """Let the nodes miss a SYNC now and then; the host does not know."""
    struck = Struck(
        faults.drop,
        place.entry.rate or 0.01,
        place.seed,
        only=lambda frame: frame[1] == SYNC_ID,
        window_ns=place.window_ns,
        rest=10,
    )
    place.struck.append(struck)
    place.world.can.host_tap = lambda frame: struck([frame])


def _sync_doubled(place: Place) -> None:
    """Repeat the host's SYNC half a period later, as another producer would."""

    def twice(frame: TimedFrame, _rng: object) -> list[TimedFrame]:
        again = (frame[0] + MS, *frame[1:])
        place.world.can.inject(again)
        return [frame, again]

    struck: Struck[TimedFrame] = Struck(
        faults.keep if place.reference else twice,
        place.entry.rate or 0.05,
        place.seed,
        only=lambda frame: frame[1] == SYNC_ID,
        window_ns=place.window_ns,
        rest=10,
    )
    place.struck.append(struck)
    place.world.can.host_tap = lambda frame: struck([frame])


def _cut(place: Place) -> None:
    """Let nothing of the bus arrive: a broken cable."""
    place.can(faults.drop, faults.drop, 1.0, lambda _frame: True)


def _bus_off(place: Place) -> None:
    first, last = place.window_ns
    _cut(place)
    place.struck.clear()  # the error frame comes first
    if not place.reference:
        place.world.can.inject((first, ERROR_FLAG | ERROR_BUS_OFF, bytes(8), False))
        place.world.can.inject((last, ERROR_FLAG | ERROR_RESTARTED, bytes(8), False))


def _babble(place: Place) -> None:
    if place.reference:
        return
    first, last = place.window_ns
    for t_ns in range(first, last, round(1e9 / place.size(6000.0))):
        place.world.can.inject((t_ns, 0x020, bytes(8), False))


def _node_reset(place: Place) -> None:
    """Restart a node by itself; until NMT starts it again it is silent."""
    first, _ = place.window_ns
    if place.reference:
        place.can_within((first, first + 8 * MS), faults.drop, faults.drop)
        return
    done = False

    def reset(frames: Sequence[TimedFrame]) -> Sequence[TimedFrame]:
        nonlocal done
        if not done and frames and frames[0][0] >= first:
            done = True
            segment = next(iter(place.world.plant.segments.values()))
            for node in segment.nodes.values():
                if node.node_id == place.node:
                    node.autostart = False
            place.world.can.command(frames[0][0], NMT_ID, bytes((0x81, place.node)))
        return frames

    place.world.can.tap = chain(place.world.can.tap, reset)


def _node_power(place: Place) -> None:
    _, last = place.window_ns
    place.can(faults.drop, faults.drop, 1.0, faults.is_node(place.node))
    if place.reference:
        return
    done = False

    def back(frames: Sequence[TimedFrame]) -> Sequence[TimedFrame]:
        nonlocal done
        if not done and frames and frames[0][0] >= last:
            done = True
            place.world.can.command(last, NMT_ID, bytes((0x81, place.node)))
        return frames

    place.world.can.tap = chain(place.world.can.tap, back)


def _port_lost(device: str) -> Type:
    def put(place: Place) -> None:
        name = place.entry.device or device
        first, last = place.window_ns
        if place.reference:
            # the port is opened again with backoff, up to half a second after the device's return
            if name == "arm":
                place.can(faults.drop, faults.drop, 1.0, lambda _frame: True)
            else:
                place.line(name, faults.drop, faults.drop)
            return
        port: Any = place.world.can if name == "arm" else place.serial(name)
        port.lost_ns = (first, last)

    return put


def _imu_power(place: Place) -> None:
    """Make it silent, then starting up, with a counter that began again."""
    _, last = place.window_ns
    place.returned_ns = up_ns = last + round(RESTART_S * 1e9)
    if place.reference:
        place.line("imu", faults.drop, faults.drop, until_ns=up_ns)
        return
    place.line("imu", faults.drop, faults.drop)
    port = place.serial("imu")
    port.tap = chain(
        port.tap,
        Struck(
            values.flagged(gyro=START_UP, acc=START_UP), 1.0, place.seed, window_ns=(last, up_ns)
        ),
        Struck(values.counted_on(101), 1.0, place.seed, window_ns=(last, faults.FOREVER_NS)),
    )


def _clock_step(device: str, action: ByteAction) -> Type:
    def put(place: Place) -> None:
        place.returned_ns = place.window_ns[0]
        if not place.reference:
            place.line(device, action, faults.keep, until_ns=faults.FOREVER_NS)

    return put


def _tracker_late(place: Place) -> None:
    late: faults.Delayed[TimedBytes] = faults.Delayed(round(place.size(0.3) * 1e9))
    _delayed_line(place, "star_tracker", late, faults.drop)


def _drift(rate: float) -> Callable[[Place], values.Change]:
    return lambda place: values.drifting(place.size(rate), place.window_ns[0])


def _shift(offset: float) -> Callable[[Place], values.Change]:
    return lambda place: values.shifted(place.size(offset))


def _scale(ratio: float) -> Callable[[Place], values.Change]:
    return lambda place: values.scaled(place.size(ratio))


def _stuck(_place: Place) -> values.Change:
    return values.Stuck()


WRONG_LATENCY = faults.rewrite(faults.stim_fields(latency_us=2500))
STARTING_UP = values.flagged(gyro=START_UP, acc=START_UP)
UNUSABLE = values.flagged(gyro=INTEGRITY, acc=INTEGRITY)
TYPES: Mapping[str, Type] = {
    "frame_drop": _frame(faults.drop, faults.drop, 0.02, rest=10),
    "frame_duplicate": _frame(faults.duplicate, faults.keep, 0.02, rest=10),
    "frame_reorder": _frame_reorder,
    "frame_delay": _frame_delay,
    "frame_short": _frame(faults.change_frame(length=6), faults.drop, 0.02, rest=10),
    "frame_counter": _frame(faults.change_frame(counter_step=7), faults.drop, 0.02, rest=10),
    "frame_damaged": _bus_errors,
    "bus_off": _bus_off,
    "bus_cut": _cut,
    "babbling_node": _babble,
    "wrong_node": _wrong_node,
    "node_reset": _node_reset,
    "node_power_cycle": _node_power,
    "sync_lost": _sync_lost,
    "sync_doubled": _sync_doubled,
    "node_no_sync": _status(0x49, torque_only=False),
    "node_test_data": _status(0x89, torque_only=False),
    "encoder_fault": _status(0x19, torque_only=False),
    "torque_saturated": _status(0x0B, torque_only=True),
    "torque_fault": _status(0x0D, torque_only=True),
    "torque_stuck": _torque(_stuck),
    "torque_spike": _torque(_shift(5.0), 0.02, 10),
    "torque_absurd": _torque(_shift(250.0), 0.02, 10),
    "torque_scale": _torque(_scale(1.5)),
    "torque_drift": _torque(_drift(2.0)),
    "encoder_jump": _position(_shift(0.05)),
    "encoder_stuck": _position(_stuck),
    "encoder_spike": _position(_shift(1e-3), 0.02, 10),
    "port_lost": _port_lost("imu"),
    "datagram_drop": _line("imu", faults.drop, faults.drop, 0.02, rest=10),
    "datagram_duplicate": _line("imu", faults.duplicate, faults.keep, 0.02, rest=10),
    "bytes_dropped": _line("imu", faults.truncate, faults.drop, 0.02, rest=10),
    "bits_flipped": _line("imu", faults.flip, faults.drop, 0.02, rest=10),
    "bits_flipped_unseen": _line(
        "imu", values.flip_unseen, values.flagged(acc=INTEGRITY), 0.02, rest=10
    ),
    "burst_noise": _line("imu", faults.noise(30), faults.keep, 0.02, rest=10),
    "jitter": _jitter,
    "latency_wrong": _line("imu", WRONG_LATENCY, faults.drop, 0.02, rest=10),
    "imu_power_cycle": _imu_power,
    "imu_start_up": _line(
        "imu",
        values.flagged(gyro=START_UP, acc=START_UP),
        values.flagged(gyro=INTEGRITY, acc=INTEGRITY),
    ),
    "imu_clock_step": _clock_step("imu", values.counted_on(77)),
    "gyro_overload": _line("imu", values.flagged(gyro=OVERLOAD), values.flagged(gyro=INTEGRITY)),
    "acc_overload": _line("imu", values.flagged(acc=OVERLOAD), values.flagged(acc=INTEGRITY)),
    "gyro_lost": _line("imu", values.flagged(gyro=INTEGRITY), values.flagged(gyro=INTEGRITY)),
    "acc_lost": _line("imu", values.flagged(acc=INTEGRITY), values.flagged(acc=INTEGRITY)),
    "gyro_stuck": _inertial("gyro", _stuck),
    "acc_stuck": _inertial("acc", _stuck),
    "gyro_spike": _inertial("gyro", _shift(0.2), 0.02, 10),
    "gyro_drift": _inertial("gyro", _drift(0.02)),
    "acc_scale": _inertial("acc", _scale(1.5)),
    "acc_drift": _inertial("acc", _drift(0.5)),
    "tracker_lost": _line("star_tracker", faults.drop, faults.drop),
    "tracker_blinded": _line("star_tracker", values.solution(blind=True), faults.drop),
    "tracker_flip": _line("star_tracker", values.solution(turn_rad=3.141592653589793), faults.drop),
    "tracker_jump": _line("star_tracker", values.solution(turn_rad=0.35), faults.drop),
    "tracker_late": _tracker_late,
    "tracker_damaged": _line("star_tracker", faults.flip, faults.drop, 0.5),
    "tracker_duplicate": _line("star_tracker", faults.duplicate, faults.keep, 0.5),
    "tracker_clock_step": _clock_step("star_tracker", values.solution(time_step_us=7_000_000)),
}


def install(
    entries: Sequence[FaultEntry],
    world: VirtualBench,
    seed: int,
    start_ns: int,
    *,
    reference: bool = False,
) -> list[Place]:
    """Put faults onto a bench that was powered on at the start; return where they went.

    They may be put on at any time before the first of them begins.

    Raises
    ------
    ScenarioError for a type that does not exist.
    """
    places = []
    for index, entry in enumerate(entries):
        put = TYPES.get(entry.type)
        if put is None:
            raise ScenarioError(f"faults: type {entry.type!r} is none of {sorted(TYPES)}")
        place = Place(entry, world, 1000 * seed + index, reference, start_ns)
        put(place)
        places.append(place)
    return places
