"""What a run keeps of the inertial unit's bytes: all of them, hardly any in memory."""

import tracemalloc

from fsw.drivers.wire import ByteChunk
from fsw.exchange.sinks import SerialTraffic
from hil.run.collector import Collector
from offline.shelf import IN_MEMORY

PER_SECOND = 500
BOUND = 20.0  # bytes of memory for a further chunk; itself it has some 150


def put(collector: Collector, first: int, stop: int) -> None:
    for k in range(first, stop, PER_SECOND):
        some = [ByteChunk(j, j.to_bytes(38, "little")) for j in range(k, k + PER_SECOND)]
        collector.put(SerialTraffic("imu", some))


def test_the_bytes_of_a_long_run_are_not_in_memory() -> None:
    collector, first, count = Collector(), 8 * PER_SECOND, 80 * PER_SECOND
    assert first > IN_MEMORY
    put(collector, 0, first)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        put(collector, first, count)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < BOUND * (count - first)
    assert [chunk.t_ns for chunk in collector.imu_chunks] == list(range(count))
    assert collector.imu_chunks[count - 1].data == (count - 1).to_bytes(38, "little")
