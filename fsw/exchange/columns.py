"""The messages of one topic in a piece of a recording, side by side."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.drivers.wire import CLASSIC_BYTES, FD_BYTES, ByteChunk, FrameArray, frames_from
from fsw.messages import IntArray


class Column(NamedTuple):
    """The messages of one topic in a piece of a recording, in file order."""

    data: bytes  # bytes of the piece
    spans: IntArray  # (k, 3) log time [ns], first byte and byte behind each message

    def rows(self) -> NDArray[np.uint8] | None:
        """Return the messages as rows of bytes; None unless all are classic or all FD frames."""
        starts, stops = self.spans[:, 1], self.spans[:, 2]
        width = int(stops[0] - starts[0])
        if width not in (CLASSIC_BYTES, FD_BYTES) or np.count_nonzero(stops - starts != width):
            return None
        return windows(self.data, width)[starts].view(np.uint8).reshape(-1, width)

    def chunks(self) -> list[ByteChunk]:
        """Return the messages as chunks of a serial line."""
        return [ByteChunk(t_ns, self.data[a:b]) for t_ns, a, b in self.spans.tolist()]


def frames_of(columns: Sequence[Column]) -> FrameArray:
    """Return the messages of some columns as frames of a bus; invalid frames are left out."""
    spans = np.concatenate([column.spans for column in columns])
    sizes, found = spans[:, 2] - spans[:, 1], [column.rows() for column in columns]
    parts = [part for part in found if part is not None]
    if len(parts) < len(found) or len({part.shape[1] for part in parts}) > 1:
        padded = [
            column.data[a:b][:FD_BYTES].ljust(FD_BYTES, b"\0")
            for column in columns
            for _, a, b in column.spans.tolist()
        ]
        parts = [np.frombuffer(b"".join(padded), np.uint8).reshape(-1, FD_BYTES)]
    return frames_from(spans[:, 0], np.concatenate(parts), sizes)


def windows(data: bytes, width: int) -> NDArray[np.void]:
    """Return a view (k,) of the `width` bytes that begin at each place of the data."""
    return np.ndarray((len(data) - width + 1,), f"V{width}", data, strides=(1,))
