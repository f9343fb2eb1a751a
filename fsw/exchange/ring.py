"""A bounded ring of records between two processes: one writer, one reader, no locks.

The ring is in a memory file (memfd) whose descriptor the other process inherits: the file has no
name and is freed when its last user ends, even by a kill. A record that does not fit is dropped and
counted; the writer never waits. Every record carries its sequence number and CRC-32, so that a
record that is not wholly visible yet (weakly ordered memory) is left for the next read.

Layout: 64 bytes of header (u64 each: capacity, bytes written, bytes read, records written, records
dropped, two numbers that the reader notes for the writer and for the next reader), then
`capacity` bytes of records: u32 length, kind, sequence, CRC; payload; padding to 16.
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

HEADER_BYTES = 64
ALIGN = 16
PAD = 0xFFFFFFFF  # length of a filler up to the end of the ring
_CAPACITY, _WRITTEN, _READ, _RECORDS, _DROPPED, _NOTE = range(6)
_RECORD = struct.Struct("=IIII")


class RingRecord(NamedTuple):
    """One record."""

    kind: int
    payload: bytes


class _Ring:
    """Mapping and header of a ring, the same for writer and reader."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._map = mmap.mmap(fd, 0)
        self._view = memoryview(self._map)
        self._header = self._view[:HEADER_BYTES].cast("Q")
        self._data = self._view[HEADER_BYTES:]
        self._capacity = self._header[_CAPACITY] or len(self._data)

    @property
    def dropped(self) -> int:
        """Number of records that found no room."""
        return self._header[_DROPPED]

    @property
    def records(self) -> int:
        """Number of records written."""
        return self._header[_RECORDS]

    @property
    def used_bytes(self) -> int:
        """Bytes waiting to be read."""
        return self._header[_WRITTEN] - self._header[_READ]

    @property
    def consumed_bytes(self) -> int:
        """Bytes read so far."""
        return self._header[_READ]

    @property
    def capacity_bytes(self) -> int:
        """Size of the ring."""
        return self._capacity

    @property
    def notes(self) -> tuple[int, int]:
        """The two numbers that the reader has noted; 0 at first."""
        return self._header[_NOTE], self._header[_NOTE + 1]

    def close(self) -> None:
        """Unmap and close the descriptor."""
        self._header.release()
        self._data.release()
        self._view.release()
        self._map.close()
        os.close(self.fd)


class RingWriter(_Ring):
    """The writing end; owns the memory file."""

    @classmethod
    def create(cls, capacity_bytes: int) -> RingWriter:
        """Make a ring; pass `fd` to the reader's process (pass_fds)."""
        if capacity_bytes < 2 * ALIGN or capacity_bytes % ALIGN:
            raise ValueError(f"capacity_bytes {capacity_bytes} must be a multiple of {ALIGN}")
        fd = os.memfd_create("fsw-ring")
        os.ftruncate(fd, HEADER_BYTES + capacity_bytes)
        ring = cls(fd)
        ring._header[_CAPACITY] = capacity_bytes
        return ring

    def push(self, kind: int, payload: bytes) -> bool:
        """Append a record; if it finds no room, count it as dropped and return False."""
        header, capacity = self._header, self._capacity
        length = len(payload)
        size = (_RECORD.size + length + ALIGN - 1) & -ALIGN
        written = header[_WRITTEN]
        offset = written % capacity
        tail = capacity - offset
        skip = tail if size > tail else 0
        if written + skip + size - header[_READ] > capacity:
            header[_DROPPED] += 1
            return False
        if skip:
            _RECORD.pack_into(self._data, offset, PAD, 0, 0, 0)
            offset = 0
        start = offset + _RECORD.size
        sequence = header[_RECORDS]
        self._data[start : start + length] = payload
        _RECORD.pack_into(
            self._data, offset, length, kind, sequence & 0xFFFFFFFF, zlib.crc32(payload)
        )
        header[_RECORDS] = sequence + 1
        header[_WRITTEN] = written + skip + size
        return True


class RingReader(_Ring):
    """The reading end, in another process or this one."""

    def __init__(self, fd: int) -> None:
        super().__init__(fd)
        self._sequence: int | None = None  # of the next record; None: read from the record

    def note(self, first: int, second: int) -> None:
        """Note two numbers, at least 0, for the writer and the next reader."""
        self._header[_NOTE], self._header[_NOTE + 1] = first, second

    def read(self, limit: int = 1 << 30, *, once: bool = False) -> Iterator[RingRecord]:
        """Yield the waiting records, at most `limit`.

        A record counts as read when the consumer asks for the next one, or stops. So the next
        reader receives the record at which a reader was killed. With `once` a record counts as
        read before it is yielded, so that a record that killed a reader does not kill the next.
        """
        header, data, capacity = self._header, self._data, self._capacity
        for _ in range(limit):
            position = header[_READ]
            if position == header[_WRITTEN]:
                return
            offset = position % capacity
            length, kind, sequence, crc = _RECORD.unpack_from(data, offset)
            if length == PAD:
                position += capacity - offset
                if position == header[_WRITTEN]:
                    return
                offset = 0
                length, kind, sequence, crc = _RECORD.unpack_from(data, 0)
            expected = sequence if self._sequence is None else self._sequence & 0xFFFFFFFF
            if sequence != expected or length > capacity:
                return
            payload = bytes(data[offset + _RECORD.size : offset + _RECORD.size + length])
            if zlib.crc32(payload) != crc:
                return
            end = position + ((_RECORD.size + length + ALIGN - 1) & -ALIGN)
            if once:
                self._sequence, header[_READ] = sequence + 1, end
            try:
                yield RingRecord(kind, payload)
            finally:
                self._sequence, header[_READ] = sequence + 1, end
