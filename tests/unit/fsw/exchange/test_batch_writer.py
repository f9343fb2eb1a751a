"""Messages added at once make the file that the library writes of them one by one."""

import io

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from fsw.exchange.batch_writer import MOST_AT_ONCE, BatchWriter

RNG = np.random.default_rng(4)


def written(writer_type: type[Writer], batches: list, *, chunk_bytes: int, at_once: bool) -> bytes:
    file = io.BytesIO()
    writer = writer_type(file, chunk_size=chunk_bytes, compression=CompressionType.NONE)
    writer.start(profile="", library="x")
    channels = [writer.register_channel(topic, "raw", 0) for topic in ("/a", "/b")]
    sequence = [0xFFFFFFFF - 5, 0]
    for which, times, data in batches:
        if at_once:
            writer.add_messages(channels[which], times, data, sequence[which])
        else:
            for k, (t_ns, row) in enumerate(zip(times.tolist(), data, strict=True)):
                number = (sequence[which] + k) & 0xFFFFFFFF
                writer.add_message(channels[which], t_ns, row.tobytes(), t_ns, number)
        sequence[which] += len(times)
        writer.add_message(channels[1], 77, b"between", 78, 9)
    writer.finish()
    return file.getvalue()


@pytest.fixture
def batches() -> list:
    sizes = [(0, 10, 16), (1, 1, 72), (0, 3, 16), (0, 0, 16), (0, 5, 0)]
    return [
        (which, RNG.integers(1, 1 << 62, count), RNG.integers(0, 256, (count, size), np.uint8))
        for which, count, size in sizes
    ]


def test_the_file_is_the_librarys_byte_by_byte(batches: list) -> None:
    one_by_one = written(Writer, batches, chunk_bytes=1 << 20, at_once=False)
    assert written(BatchWriter, batches, chunk_bytes=1 << 20, at_once=True) == one_by_one


def test_chunks_end_and_nothing_is_lost_between_them() -> None:
    count = 2 * MOST_AT_ONCE + 7
    batch = (0, np.arange(count) + 5, RNG.integers(0, 256, (count, 16), np.uint8))
    file = written(BatchWriter, [batch, batch], chunk_bytes=4096, at_once=True)
    reader = make_reader(io.BytesIO(file))
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert len(summary.chunk_indexes) == 5
    assert summary.statistics.message_count == 2 * count + 2
    found = [m for _, _, m in reader.iter_messages(topics=["/a"], log_time_order=False)]
    assert [m.log_time for m in found] == 2 * batch[1].tolist()
    assert b"".join(m.data for m in found) == 2 * batch[2].tobytes()
