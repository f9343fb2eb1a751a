"""Jumps and stands of an encoder on motions in closed form."""

import math
from collections.abc import Callable

import pytest

from fsw.drivers.sources.encoder_watch import HOLD_S, EncoderWatch
from fsw.messages.findings import Fault

PERIOD_S = 0.002
QUANTUM = math.tau / 2**24


def run(position: Callable[[float], float], stop_s: float) -> list[Fault | None]:
    tested = EncoderWatch(PERIOD_S, 1.0, PERIOD_S)
    times = [k * PERIOD_S for k in range(round(stop_s / PERIOD_S))]
    return [tested.look(round(t * 1e9), QUANTUM * round(position(t) / QUANTUM)) for t in times]


def smooth(t: float) -> float:
    """Return a motion that stops twice a second and never exceeds its limit."""
    return 0.1 * math.sin(2 * math.pi * t)


@pytest.mark.parametrize(
    "motion", [smooth, lambda t: 0.0 * t, lambda t: 0.9 * t, lambda t: 1e-5 * t]
)
def test_no_motion_within_the_limits_is_a_fault(motion: Callable[[float], float]) -> None:
    assert not any(run(motion, 4.0))


@pytest.mark.parametrize("bits", [12, 14, 16, 18, 20])
@pytest.mark.parametrize("slowing", [0.02, 0.3])
def test_a_coarse_encoder_that_turns_back_is_not_stuck(bits: int, slowing: float) -> None:
    step, w = math.tau / 2**bits, 2 * math.pi * slowing
    tested = EncoderWatch(PERIOD_S, 1.0, PERIOD_S + 3.0 * step, step)
    times = [k * PERIOD_S for k in range(round(2.0 / slowing / PERIOD_S))]
    motion = [0.3 * math.sin(w * t) for t in times]
    found = [
        tested.look(round(t * 1e9), step * round(q / step))
        for t, q in zip(times, motion, strict=True)
    ]
    assert not any(found)


def test_a_coarse_encoder_that_stands_is_stuck_after_some_of_its_steps() -> None:
    step = math.tau / 2**14
    tested = EncoderWatch(PERIOD_S, 1.0, PERIOD_S + 3.0 * step, step)
    found = [
        tested.look(round(k * PERIOD_S * 1e9), step * round(0.2 * min(k, 500) * PERIOD_S / step))
        for k in range(600)
    ]
    assert not any(found[:500])
    assert all(found[540:])


def test_a_jump_is_seen_at_once_and_is_over_at_once() -> None:
    found = run(lambda t: smooth(t) + (0.05 if 0.9995 <= t < 1.4995 else 0.0), 2.0)
    assert found == [None] * 500 + [Fault.ENCODER_JUMP] * 250 + [None] * 250


def test_a_position_that_never_comes_back_is_taken_after_a_while() -> None:
    found = run(lambda t: smooth(t) + (0.05 if t > 0.9995 else 0.0), HOLD_S + 3.0)
    assert found.count(Fault.ENCODER_JUMP) * PERIOD_S == pytest.approx(HOLD_S, abs=0.01)
    assert found[-1] is None


def test_an_encoder_that_stands_while_the_joint_moved_is_seen_after_three_readings() -> None:
    found = run(lambda t: 0.1 * (min(t, 0.9999) if t < 1.4999 else t), 2.0)
    assert not any(found[:501])
    assert found[502:750] == [Fault.ENCODER_STUCK] * 248
    assert not any(found[752:])


def test_a_joint_that_stops_gently_is_not_stuck() -> None:
    # decelerates at 0.5 rad/s^2 to rest
    assert not any(run(lambda t: 0.25 * (1 - (1 - min(t, 1.0)) ** 2), 2.0))
