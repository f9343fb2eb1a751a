"""Two nodes with one id: neither is believed from the second double answer on."""

import pytest

from fsw.messages.findings import Fault
from tests.unit.fsw.drivers.sources.test_joints import cycle, reading, source, sync

BEGINS, ENDS = 100, 400  # SYNCs of the second node


def impostor(k: int, q: float = 0.1002, tau: float = 1.5):
    return reading(k, 0, q=q, tau=tau, delay_ns=200_000)


def flown(batch: int, frames_of) -> tuple[list, object]:
    """Feed 1000 SYNCs at 500 Hz in batches; return the samples of joint 0, and the bus."""
    bus = source()
    frames = [frame for k in range(1000) for frame in frames_of(k)]
    samples = []
    for start in range(0, len(frames), batch):
        samples += bus.feed(frames[start : start + batch])
    return [s for s in samples if s.joint == 0], bus


def two_answers(k: int):
    if BEGINS <= k < ENDS:
        return [sync(k), impostor(k), reading(k, 0), reading(k, 1)]
    return cycle(k)


@pytest.mark.parametrize("batch", [1, 7, 40, 3000])
def test_no_answer_of_a_contested_node_is_believed(batch: int):
    samples, bus = flown(batch, two_answers)
    during = [s for s in samples if BEGINS <= (s.t_ns - samples[0].t_ns) // 2_000_000 < ENDS + 500]
    assert len(during) == 2, "the first two, before a second SYNC had two answers"
    assert len(samples) == BEGINS + 2 + (1000 - ENDS - 500)
    found = {finding.fault for finding in bus.findings()}
    assert Fault.NODE_CONTESTED in found
    assert bus.counters["lost"] > 0


@pytest.mark.parametrize("batch", [1, 7, 3000])
def test_a_frame_that_the_bus_repeats_is_no_second_node(batch: int):
    samples, bus = flown(batch, lambda k: [sync(k), reading(k, 0), reading(k, 0), reading(k, 1)])
    assert len(samples) == 1000
    assert Fault.NODE_CONTESTED not in {finding.fault for finding in bus.findings()}


@pytest.mark.parametrize("batch", [1, 7, 3000])
@pytest.mark.parametrize("apart", [600, 1000])
def test_a_sync_sent_twice_costs_no_sample(batch: int, apart: int):
    """Every node answers it twice, and differently; so does a counter that a bad bit turns back."""
    samples, bus = flown(batch, lambda k: cycle(k) + [impostor(k)] * (k % apart == 50))
    assert len(samples) == 1000
    assert Fault.NODE_CONTESTED not in {finding.fault for finding in bus.findings()}


@pytest.mark.parametrize("batch", [1, 7, 40, 3000])
def test_many_syncs_sent_twice_cost_no_sample(batch: int):
    """Every node answers each of them twice, with another reading the second time."""

    def doubled(k: int):
        again = [reading(k, j, q=0.1001, tau=1.4, delay_ns=900_000) for j in (0, 1)]
        return cycle(k) + (again if k % 20 == 3 else [])

    samples, bus = flown(batch, doubled)
    assert len(samples) == 1000
    found = {finding.fault for finding in bus.findings()}
    assert Fault.SYNC_DOUBLED in found
    assert Fault.NODE_CONTESTED not in found
