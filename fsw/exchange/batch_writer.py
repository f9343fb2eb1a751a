"""Writes many messages of one length to an MCAP file at once."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import MessageIndex
from mcap.writer import Writer
from numpy.typing import NDArray

MOST_AT_ONCE = 512  # messages, so that a chunk is not much longer than configured
_HEAD_BYTES = 22  # of a message before its data: channel, sequence, two times


class BatchWriter(Writer):
    """Extends the library's writer, which needs some 20 us for each message.

    It uses private members of the library: the builder of a chunk and the statistics. A test
    compares the file with one that the library writes alone, byte by byte.
    """

    @property
    def open_messages(self) -> int:
        """Number of messages in the open chunk."""
        held: Any = self
        return int(held._Writer__chunk_builder.num_messages)  # noqa: SLF001

    def add_messages(
        self,
        channel_id: int,
        log_times_ns: NDArray[np.int64],
        data: NDArray[np.uint8],
        sequence: int,
    ) -> None:
        """Add messages of one channel; their publish times are their log times.

        Parameters
        ----------
        log_times_ns : (k,), not negative
        data : (k, n) bytes, one message per row
        sequence : number of the first message
        """
        records = _records(channel_id, log_times_ns, data, sequence)
        times_ns = log_times_ns.tolist()
        for start in range(0, len(records), MOST_AT_ONCE):
            part = slice(start, start + MOST_AT_ONCE)
            self._add_records(channel_id, times_ns[part], records[part])

    def _add_records(
        self, channel_id: int, times_ns: Sequence[int], records: NDArray[np.void]
    ) -> None:
        count, first_ns, last_ns = len(records), min(times_ns), max(times_ns)
        held: Any = self
        chunk, statistics = held._Writer__chunk_builder, held._Writer__statistics  # noqa: SLF001
        ends = range(chunk.count, chunk.count + records.nbytes, records.itemsize)
        index = chunk.message_indices.setdefault(
            channel_id, MessageIndex(channel_id=channel_id, records=[])
        )
        index.records += zip(times_ns, ends, strict=True)
        chunk.record_writer.write(records.tobytes())
        for part, seen in ((chunk, chunk.num_messages), (statistics, statistics.message_count)):
            part.message_start_time = min(part.message_start_time, first_ns) if seen else first_ns
            part.message_end_time = max(part.message_end_time, last_ns)
        chunk.num_messages += count
        statistics.message_count += count
        statistics.channel_message_counts[channel_id] += count
        held._Writer__maybe_finalize_chunk()  # noqa: SLF001


def _records(
    channel_id: int, log_times_ns: NDArray[np.int64], data: NDArray[np.uint8], sequence: int
) -> NDArray[np.void]:
    """Return message records: operation code, length, channel, sequence, two times, data."""
    size = data.shape[1]
    records = np.empty(len(data), _layout(size))
    records["code"], records["length"] = Opcode.MESSAGE, _HEAD_BYTES + size
    records["channel"] = channel_id
    records["sequence"] = (sequence + np.arange(len(data))) & 0xFFFFFFFF
    records["logged"] = records["published"] = log_times_ns
    records["data"] = data
    return records


@cache
def _layout(size: int) -> np.dtype[np.void]:
    """Return the layout of a message record with `size` bytes of data."""
    names = ["code", "length", "channel", "sequence", "logged", "published", "data"]
    formats = ["u1", "<u8", "<u2", "<u4", "<u8", "<u8", f"({size},)u1"]
    return np.dtype({"names": names, "formats": formats})
