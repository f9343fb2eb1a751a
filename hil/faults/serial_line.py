"""Faults by name of the serial devices and sensors, on the serial lines of a virtual bench."""

from collections.abc import Callable, Mapping
from typing import Any

from hil.devices.uart import TimedBytes
from hil.faults import amounts, values
from hil.faults import taps as faults
from hil.faults.place import Place, Type
from hil.faults.taps import ByteAction, Struck, chain

INTEGRITY, START_UP, OVERLOAD = 0x80, 0x40, 0x10  # status bits of an IMU cluster
RESTART_S = 0.3  # start-up of an inertial unit after power-on


def _line(
    device: str, action: ByteAction, instead: ByteAction, rate: float = 1.0, *, rest: int = 0
) -> Type:
    def put(place: Place) -> None:
        place.line(device, action, instead, rate, rest=rest)

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


def _port_lost(device: str) -> Type:
    def put(place: Place) -> None:
        name = place.entry.device or device
        first, last = place.window_ns
        if place.reference:
            # the daemon reopens the port with backoff, up to 0.5 s after the device's return
            if name == "arm":
                place.can(faults.drop, faults.drop, 1.0, lambda _frame: True)
            else:
                place.line(name, faults.drop, faults.drop)
            return
        port: Any = place.world.can if name == "arm" else place.serial(name)
        port.lost_ns = (first, last)

    return put


def _imu_power(place: Place) -> None:
    """Silence the unit for the window, then send start-up flags and a changed counter."""
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


WRONG_LATENCY = faults.rewrite(faults.stim_fields(latency_us=2500))
TYPES: Mapping[str, Type] = {
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
    "gyro_stuck": _inertial("gyro", amounts.stuck),
    "acc_stuck": _inertial("acc", amounts.stuck),
    "gyro_spike": _inertial("gyro", amounts.shift(0.2), 0.02, 10),
    "gyro_drift": _inertial("gyro", amounts.drift(0.02)),
    "acc_scale": _inertial("acc", amounts.scale(1.5)),
    "acc_drift": _inertial("acc", amounts.drift(0.5)),
    "tracker_lost": _line("star_tracker", faults.drop, faults.drop),
    "tracker_blinded": _line("star_tracker", values.solution(blind=True), faults.drop),
    "tracker_flip": _line("star_tracker", values.solution(turn_rad=3.141592653589793), faults.drop),
    "tracker_jump": _line("star_tracker", values.solution(turn_rad=0.35), faults.drop),
    "tracker_late": _tracker_late,
    "tracker_damaged": _line("star_tracker", faults.flip, faults.drop, 0.5),
    "tracker_duplicate": _line("star_tracker", faults.duplicate, faults.keep, 0.5),
    "tracker_clock_step": _clock_step("star_tracker", values.solution(time_step_us=7_000_000)),
}
