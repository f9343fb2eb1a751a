"""Faults are seeded, do not depend on batching, and do what they say."""

import struct

import numpy as np
import pytest

from fsw.drivers.codecs import sagitta as flight_sagitta
from fsw.drivers.codecs import stim300 as flight_stim300
from fsw.drivers.codecs.sagitta import SagittaCodec
from fsw.drivers.codecs.stim300 import StimDatagram
from fsw.drivers.layout.shipped import READ_JOINT, READ_JOINT_FD
from hil.devices import canopen, sagitta
from hil.faults import taps as faults
from hil.faults import values
from hil.faults.taps import Struck, chain
from tests.support.plant_cases import reading
from tests.support.taps import FlipEveryBit, Regrouped, flip_payload, sagitta_fields

MS = 1_000_000
# interfaces.md, section 2
STIM = bytes.fromhex(
    "a5004000008000ff40000000cccdfe666600666600190019801a0000180018801900002a04d2acdb75c9"
)
STAR = sagitta.frame(
    sagitta.solution_payload(sagitta.Solution(q_wxyz=(0.5, 0.5, 0.5, 0.5), unix_us=10**15, ticks=7))
)
MEASURED = (-1.25, 0.0, -12.34, 0.0)
TPDO1 = (5, 0x193, canopen.encode_tpdo1(reading(*MEASURED), 0x09, 42), False)


def stream(count: int = 400) -> list[tuple[int, bytes]]:
    return [(k * MS, bytes([k % 256]) * 10) for k in range(count)]


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


@pytest.mark.parametrize("sizes", [[400], [1] * 400, [7, 93, 100, 200]])
def test_what_happens_does_not_depend_on_batching(sizes: list[int]) -> None:
    def taps() -> faults.Tap[tuple[int, bytes]]:
        actions = (faults.noise(30), faults.truncate, faults.flip, faults.duplicate, faults.drop)
        return chain(*(Struck(action, 0.1, k) for k, action in enumerate(actions)))

    whole = taps()(stream())
    tap, items, parts = taps(), stream(), []
    for size in sizes:
        parts += list(tap(items[:size]))
        items = items[size:]
    assert parts == list(whole)
    assert list(whole) != stream()


def test_another_seed_strikes_other_items() -> None:
    a, b = (Struck(faults.drop, 0.2, seed)(stream()) for seed in (1, 2))
    assert a != b


def test_the_rate_window_selection_and_rest_are_kept() -> None:
    every = Struck(faults.drop, 1.0, 1, window_ns=(100 * MS, 200 * MS))
    assert every(stream()) == stream()[:100] + stream()[200:]
    assert every.count == 100
    odd = Struck(faults.drop, 1.0, 1, only=lambda item: item[1][0] % 2 == 1)
    assert odd(stream()) == stream()[::2]
    fourth = Struck(faults.drop, 1.0, 1, rest=3)
    assert fourth(stream()) == [item for k, item in enumerate(stream()) if k % 4]
    some = Struck(faults.drop, 0.1, 1)
    some(stream(10_000))
    assert 900 < some.count < 1100  # 3.3 sigma of a binomial count


def test_byte_actions_change_the_bytes_they_say() -> None:
    item = (3, STIM)
    ((t_ns, noisy),) = faults.noise(20)(item, rng())
    assert t_ns == 3
    assert noisy.endswith(STIM)
    assert 1 <= len(noisy) - len(STIM) <= 20
    ((_, head),) = faults.truncate(item, rng())
    ((_, tail),) = faults.behead(item, rng())
    assert STIM.startswith(head)
    assert STIM.endswith(tail)
    assert 0 < len(head) < len(STIM) > len(tail) > 0
    ((_, flipped),) = faults.flip(item, rng())
    assert sum((a ^ b).bit_count() for a, b in zip(flipped, STIM, strict=True)) == 1
    assert faults.duplicate(item, rng()) == [item, item]
    assert faults.drop(item, rng()) == []
    assert faults.delay(4)(item, rng()) == [(7, STIM)]


def test_flipping_every_bit_goes_through_them_and_begins_again() -> None:
    flip = FlipEveryBit()
    flipped = [flip((0, STIM), rng())[0][1] for _ in range(8 * len(STIM) + 1)]
    assert len(set(flipped)) == 8 * len(STIM)
    assert flipped[0] == flipped[-1]


def test_an_edited_datagram_is_valid_and_differs_in_the_edited_fields() -> None:
    edit = faults.stim_fields(
        counter_step=300, latency_us=77, gyro=(1 << 14, 0, 0), acc=(0, 1 << 19, 0), status=0x10
    )
    decoded = flight_stim300.decode_datagram(edit(STIM, rng()), 10)
    assert isinstance(decoded, StimDatagram)
    assert decoded.counter == (42 + 300) % 256
    assert decoded.latency_us == 77
    assert decoded.gyro_rad_s == pytest.approx((np.pi / 180, 0, 0))
    assert decoded.acc_m_s2 == pytest.approx((0, 9.80665, 0))
    assert (decoded.gyro_status, decoded.acc_status) == (0x10, 0)
    assert faults.stim_fields()(STIM, rng()) == STIM


def test_an_edited_solution_is_valid_and_differs_in_the_edited_fields() -> None:
    edit = sagitta_fields(q_wxyz=(0.0, 1.0, 0.0, 0.0), time_step_us=-5)
    decoded = SagittaCodec().decode(edit(STAR, rng()))
    assert isinstance(decoded, flight_sagitta.Solution)
    assert decoded.q_wxyz == (0, 1, 0, 0)
    assert decoded.unix_us == 10**15 - 5
    assert sagitta_fields()(STAR, rng()) == STAR
    shorter = flight_sagitta.decode_payload(sagitta_fields(cut=3)(STAR, rng()))
    assert isinstance(shorter, bytes)
    assert len(shorter) == 80
    with pytest.raises(ValueError, match="star tracker"):
        edit(STAR[:-9], rng())


def test_frame_actions_change_the_fields_they_say() -> None:
    action = faults.change_frame(counter_step=200, position=-3, torque=9, status=1)
    ((_, _, data, _),) = action(TPDO1, rng())
    assert struct.unpack("<ihBB", data) == (-3, 9, 1, 2)  # 42 + 200 - 240
    assert faults.change_frame(length=3)(TPDO1, rng())[0][2] == TPDO1[2][:3]
    true, forged = faults.as_node(0x22)(TPDO1, rng())
    assert true == TPDO1
    assert forged == (5, 0x1A2, *TPDO1[2:])
    ((_, _, flipped, _),) = flip_payload(TPDO1, rng())
    assert sum((a ^ b).bit_count() for a, b in zip(flipped, TPDO1[2], strict=True)) == 1


@pytest.mark.parametrize("is_fd", [False, True])
def test_faults_of_a_joint_know_both_forms_of_its_frame(is_fd: bool) -> None:
    fd = canopen.encode_fd(reading(*MEASURED, is_fd=True), 0x09, 42, 7)
    data = fd if is_fd else TPDO1[2]
    frame = (5, 0x193, data, is_fd)

    def decoded(action: faults.FrameAction) -> tuple[float, float]:
        ((_, _, changed, _),) = action(frame, rng())
        assert len(changed) == len(data)
        octets = np.frombuffer(changed, np.uint8)[None]
        position, torque, *_ = (READ_JOINT_FD if is_fd else READ_JOINT)(octets)
        return float(position[0]), float(torque[0])

    position, torque = decoded(values.torque(values.shifted(2.0)))
    assert torque == pytest.approx(-10.34, abs=0.006)
    assert position == pytest.approx(-1.25, abs=1e-6)
    position, torque = decoded(values.position(values.shifted(0.5)))
    assert position == pytest.approx(-0.75, abs=1e-6)
    assert torque == pytest.approx(-12.34, abs=0.006)
    _, torque = decoded(faults.change_frame(status=0x0B, torque=2**31 - 1))
    assert torque == pytest.approx((2**31 - 1) * 1e-4 if is_fd else 327.67)


@pytest.mark.parametrize("length", [0, 3, 6, 12, 19])
def test_faults_of_a_joint_leave_a_frame_alone_that_another_fault_cut(length: int) -> None:
    frame = (5, 0x193, bytes(length), True)
    for action in (
        values.torque(values.shifted(2.0)),
        values.position(values.Stuck()),
        faults.change_frame(status=0x0B),
    ):
        assert action(frame, rng()) == [frame]


@pytest.mark.parametrize("damaged", [b"", STIM[:-1], STIM[:11], STIM[:5] + STIM[6:], STIM[1:]])
def test_faults_of_an_imu_leave_a_datagram_alone_that_another_fault_damaged(damaged: bytes) -> None:
    actions = (
        values.inertial("gyro", [values.shifted(0.1)] * 3),
        values.inertial("acc", [values.Stuck() for _ in range(3)]),
        values.flip_unseen,
        values.flagged(gyro=1, acc=1),
        values.counted_on(5),
    )
    for action in actions:
        assert action((7, damaged), rng()) == [(7, damaged)]
        ((_, changed),) = action((7, STIM), rng())
        assert isinstance(flight_stim300.decode_datagram(changed, 10), StimDatagram)


def test_frames_are_told_apart() -> None:
    assert faults.is_tpdo1(TPDO1)
    assert not faults.is_tpdo1((0, 0x180, b"", False))
    assert not faults.is_tpdo1((0, 0x293, b"", False))
    assert faults.is_node(0x13)((0, 0x713, b"", False))
    assert not faults.is_node(0x13)((0, 0x192, b"", False))
    assert not faults.is_node(0x00)((0, 0x080, b"", False))


def test_regrouping_keeps_every_byte_and_brings_none_early() -> None:
    tap = Regrouped(3 * MS)
    out = [chunk for item in stream() for chunk in tap([item])]
    data = b"".join(data for _, data in out)
    assert b"".join(data for _, data in stream()).startswith(data)
    assert len(data) >= 10 * (400 - 4)
    assert all(t_ns % (3 * MS) == 0 for t_ns, _ in out)
    sent = 0
    for t_ns, chunk in out:
        sent += len(chunk) // 10
        assert stream()[sent - 1][0] <= t_ns
