"""A lost port is back within half a second of its device, however long that was away."""

import pytest

from fsw.drivers.wire import BytePort
from fsw.errors import PortError
from fsw.loop.link import Link
from tests.support.loop_cases import MS, FakeClock, FakeSerial


@pytest.mark.parametrize("away_s", [0.1, 3.0, 4.0, 100.0])
def test_a_port_is_opened_again_half_a_second_after_its_return_at_the_latest(away_s: float) -> None:
    clock, opened = FakeClock(), 0
    back_ns = round(away_s * 1e9)

    def opener() -> BytePort:
        nonlocal opened
        opened += 1
        if clock.now_ns() < back_ns:
            raise PortError("not there")
        return FakeSerial(clock)

    link: Link[BytePort] = Link("imu", FakeSerial(clock), opener)
    link.lose(0)
    while not link.retry(clock.now_ns()):
        clock.now += 100 * MS
    assert link.up
    assert link.losses == 1
    assert clock.now_ns() - back_ns <= 500 * MS
    assert opened <= 2 * away_s + 2  # and no more often than twice a second


def test_a_port_that_cannot_be_opened_again_stays_lost() -> None:
    link: Link[BytePort] = Link("imu", None, None)
    assert not link.retry(10**12)
    assert link.losses == 1
