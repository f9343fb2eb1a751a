"""Resynchronising frame finder of the serial codecs: bounded memory, and every byte is counted.

A device's `Matcher` finds frames; bytes in no frame are skipped. After the first frame, each next
frame is expected directly behind the last one. Other bytes there count as one reject per length of
a frame: `CRC` if they looked like a frame, `SYNC` if they did not.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from fsw.drivers.wire import ByteChunk, Reject


class Matcher(Protocol):
    """Framing of one device."""

    def search(self, data: bytearray, start: int) -> int:
        """Return the first position from `start` on where a frame may begin, else len(data)."""
        ...

    def match(self, data: bytearray, start: int) -> int:
        """Return the length of the frame at `start`; 0 if it is incomplete, -1 if none is there."""
        ...


def find_sync(data: bytearray, sync: bytes, start: int) -> int:
    """Return the place of the next sync bytes, or of their beginning at the end of the data."""
    at = data.find(sync, start)
    if at >= 0:
        return at
    parts = (k for k in range(len(sync) - 1, 0, -1) if data.endswith(sync[:k]))
    return max(start, len(data) - next(parts, 0))


class FixedMatcher:
    """Framing by sync bytes, one length and a check of the whole frame."""

    def __init__(self, sync: bytes, length: int, is_intact: Callable[[bytes], bool]) -> None:
        self._sync, self._length, self._is_intact = sync, length, is_intact

    def search(self, data: bytearray, start: int) -> int:
        """Return the place of the next sync bytes, or of their beginning at the end of the data."""
        return find_sync(data, self._sync, start)

    def match(self, data: bytearray, start: int) -> int:
        """Return the length of the frame at `start`; 0 if it is incomplete, -1 if none is there."""
        end = start + self._length
        if len(data) < end:
            return 0
        return self._length if self._is_intact(bytes(data[start:end])) else -1


@dataclass(frozen=True, slots=True)
class Piece:
    """The part of a frame that arrived in one chunk."""

    chunk: int  # running index of the chunk
    t_ns: int  # stamp of the chunk
    length: int  # bytes of the frame in it


@dataclass(frozen=True, slots=True)
class Frame:
    """A whole frame and the pieces in which it arrived; the last piece holds the last byte."""

    data: bytes
    pieces: tuple[Piece, ...]
    skipped: int = 0  # bytes between the frame before and this one


class Framer:
    """Finds frames in chunks; it keeps no more bytes than one incomplete frame has."""

    def __init__(self, matcher: Matcher) -> None:
        self._matcher = matcher
        self._buffer = bytearray()
        self._base = 0  # position in the stream of the buffer's first byte
        self._marks: deque[tuple[int, int, int]] = deque()  # end of chunk, stamp, chunk index
        self._chunks = 0
        self._expected = -1  # where the next frame should begin, -1 before the first
        self._last_length = 1
        self._reported_skipped = 0
        self.received_bytes = 0
        self.skipped_bytes = 0
        self.rejects: dict[Reject, int] = {Reject.SYNC: 0, Reject.CRC: 0}

    @property
    def pending_bytes(self) -> int:
        """Bytes received that are neither in a frame nor skipped yet."""
        return len(self._buffer)

    def feed(self, chunk: ByteChunk) -> list[Frame]:
        """Accept a chunk and return the frames it completes, in order."""
        buffer = self._buffer
        buffer += chunk.data
        self.received_bytes += len(chunk.data)
        self._marks.append((self.received_bytes, chunk.t_ns, self._chunks))
        self._chunks += 1
        frames = []
        position, size = 0, len(buffer)
        while position < size:
            begin = self._matcher.search(buffer, position)
            if begin > position:
                self._skip(position, begin, Reject.SYNC)
                position = begin
                continue
            length = self._matcher.match(buffer, position)
            if length == 0:
                break
            if length < 0:
                self._skip(position, position + 1, Reject.CRC)
                position += 1
                continue
            end = position + length
            frames.append(
                Frame(
                    bytes(buffer[position:end]),
                    self._pieces(self._base + position, length),
                    self.skipped_bytes - self._reported_skipped,
                )
            )
            self._reported_skipped = self.skipped_bytes
            self._expected, self._last_length = self._base + end, length
            position = end
        del buffer[:position]
        self._base += position
        while self._marks and self._marks[0][0] <= self._base:
            self._marks.popleft()
        return frames

    def peek(self, chunks: Sequence[ByteChunk]) -> tuple[int, int]:
        """Return how many of the next chunks could be whole frames, as long as the last frame.

        Returns
        -------
        count : number of leading chunks whose length is a multiple of that length; 0 if a frame or
            junk is pending
        length : length of the last frame [bytes]
        """
        length = self._last_length
        if self._buffer or self._expected != self._base:
            return 0, length
        lengths = (len(chunk.data) for chunk in chunks)
        count = next((k for k, n in enumerate(lengths) if n % length or not n), len(chunks))
        return count, length

    def pass_over(self, chunks: Sequence[ByteChunk]) -> int:
        """Count chunks of whole frames as fed; return the running index of the first chunk."""
        first, size = self._chunks, sum(len(chunk.data) for chunk in chunks)
        self._chunks += len(chunks)
        self.received_bytes += size
        self._base += size
        self._expected = self._base
        return first

    def _skip(self, start: int, stop: int, reason: Reject) -> None:
        self.skipped_bytes += stop - start
        if self._expected < 0:
            return
        while self._base + start <= self._expected < self._base + stop:
            self.rejects[reason] += 1
            self._expected += self._last_length

    def _pieces(self, start: int, length: int) -> tuple[Piece, ...]:
        stop = start + length
        pieces = []
        for end, t_ns, index in self._marks:
            if end <= start:
                continue
            cut = min(end, stop)
            pieces.append(Piece(index, t_ns, cut - start))
            start = cut
            if cut == stop:
                break
        return tuple(pieces)
