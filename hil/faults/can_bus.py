"""Faults by name of a bus, the nodes and the joint sensors, on a virtual bench's CAN link."""

from collections.abc import Callable, Mapping, Sequence

from fsw.drivers.wire import ERR_FLAG
from hil.devices.can_segment import TimedFrame
from hil.devices.canopen import NMT_ID, SYNC_ID
from hil.faults import amounts, values
from hil.faults import taps as faults
from hil.faults.place import Place, Type
from hil.faults.taps import FrameAction, Struck, chain

STRANGER = 0x2A
MS = 1_000_000
ERROR_BUS = 0x088  # protocol violation, bus error
ERROR_BUS_OFF, ERROR_RESTARTED = 0x040, 0x100
FULL_SCALE = 2**31 - 1  # largest value; clamped to the field
NO_TORQUE = 0x08  # status: encoder valid, torque invalid


def _frame(action: FrameAction, instead: FrameAction, rate: float = 1.0, *, rest: int = 0) -> Type:
    def put(place: Place) -> None:
        place.can(action, instead, rate, rest=rest)

    return put


def _status(status: int, *, torque_only: bool, torque: int | None = None) -> Type:
    lost = faults.change_frame(status=NO_TORQUE) if torque_only else faults.drop
    return _frame(faults.change_frame(status=status, torque=torque), lost)


def _torque(change: Callable[[Place], values.Change], rate: float = 1.0, rest: int = 0) -> Type:
    def put(place: Place) -> None:
        lost = faults.change_frame(status=NO_TORQUE)
        place.can(values.torque(change(place)), lost, rate, rest=rest)

    return put


def _position(change: Callable[[Place], values.Change], rate: float = 1.0, rest: int = 0) -> Type:
    def put(place: Place) -> None:
        place.can(values.position(change(place)), faults.drop, rate, rest=rest)

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


def _bus_errors(place: Place) -> None:
    """Replace frames, as if damaged on the bus, by an error frame and a repetition."""

    def spoil(frame: TimedFrame, _rng: object) -> list[TimedFrame]:
        error = (frame[0], ERR_FLAG | ERROR_BUS, bytes(8), False)
        return [error, (frame[0] + 150_000, *frame[1:])]

    place.can(spoil, faults.keep, 0.05, faults.is_tpdo1)


def _wrong_node(place: Place) -> None:
    def renamed(frame: TimedFrame, _rng: object) -> list[TimedFrame]:
        return [(frame[0], frame[1] - place.node + STRANGER, frame[2], frame[3])]

    place.can(renamed, faults.drop, 1.0, faults.is_node(place.node))


def _strike_syncs(place: Place, action: faults.FrameAction, rate: float) -> None:
    """Change some of the host's SYNCs on their way to the nodes."""
    struck = Struck(
        action,
        place.entry.rate or rate,
        place.seed,
        only=lambda frame: frame[1] == SYNC_ID,
        window_ns=place.window_ns,
        rest=10,
    )
    place.struck.append(struck)
    place.world.can.host_tap = lambda frame: struck([frame])


def _sync_lost(place: Place) -> None:
    """Drop some SYNCs on their way to the nodes, without an error for the host."""
    _strike_syncs(place, faults.drop, 0.01)


def _sync_doubled(place: Place) -> None:
    """Repeat some of the host's SYNCs 1 ms later, like a second producer."""

    def twice(frame: TimedFrame, _rng: object) -> list[TimedFrame]:
        again = (frame[0] + MS, *frame[1:])
        place.world.can.inject(again)
        return [frame, again]

    _strike_syncs(place, faults.keep if place.reference else twice, 0.05)


def _sync_creep(place: Place) -> None:
    """Let the stamps of the host's SYNCs run away from their true times, at `size` seconds/s.

    Without their times the answers are lost.
    """
    first, last = place.window_ns
    if place.reference:
        place.can(faults.drop, faults.drop, 1.0, faults.is_tpdo1)
        return
    rate = place.size(5e-5)

    def crept(t_ns: int) -> int:
        return t_ns + round(rate * (t_ns - first)) if first <= t_ns < last else t_ns

    place.world.can.sent_stamp = crept


def _cut(place: Place) -> None:
    """Drop every frame to the host, like a broken cable."""
    place.can(faults.drop, faults.drop, 1.0, lambda _frame: True)


def _bus_off(place: Place) -> None:
    first, last = place.window_ns
    _cut(place)
    place.struck.clear()  # the error frame is the fault's first effect
    if not place.reference:
        place.world.can.inject((first, ERR_FLAG | ERROR_BUS_OFF, bytes(8), False))
        place.world.can.inject((last, ERR_FLAG | ERROR_RESTARTED, bytes(8), False))


def _babble(place: Place) -> None:
    if place.reference:
        return
    first, last = place.window_ns
    for t_ns in range(first, last, round(1e9 / place.size(6000.0))):
        place.world.can.inject((t_ns, 0x020, bytes(8), False))


def _node_reset(place: Place) -> None:
    """Reset one node; the node is silent until an NMT command starts it."""
    first, _ = place.window_ns
    if place.reference:
        place.can(faults.drop, faults.drop, window_ns=(first, first + 8 * MS))
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
    "sync_creep": _sync_creep,
    "node_no_sync": _status(0x49, torque_only=False),
    "node_test_data": _status(0x89, torque_only=False),
    "encoder_fault": _status(0x19, torque_only=False),
    "torque_saturated": _status(0x0B, torque_only=True, torque=FULL_SCALE),
    "torque_fault": _status(0x0D, torque_only=True),
    "torque_stuck": _torque(amounts.stuck),
    "torque_spike": _torque(amounts.shift(5.0), 0.02, 10),
    "torque_absurd": _torque(amounts.shift(250.0), 0.02, 10),
    "torque_scale": _torque(amounts.scale(1.5)),
    "torque_drift": _torque(amounts.drift(2.0)),
    "encoder_jump": _position(amounts.shift(0.05)),
    "encoder_stuck": _position(amounts.stuck),
    "encoder_spike": _position(amounts.shift(1e-3), 0.02, 10),
}
