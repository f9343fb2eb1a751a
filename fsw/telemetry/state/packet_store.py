"""One circular packet store of bounded size on the disk, which survives a restart.

A store is a folder of segments. A segment is a header (magic, version, and the epoch of its times)
followed by whole telemetry packets as they were sent, and by an end (magic, times of the oldest and
newest packet, CRC-32) once no more follow. A start reads the packets of segments without an end
only. The oldest segment is removed before the store would exceed its size. Packets are written
unbuffered, so a killed process loses none. A full segment is synchronised to the disk before the
next begins; the service synchronises the newest segment every few seconds.
"""

import errno
import os
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from fastcrc import crc16

from file_delivery.durable import sync_file
from file_delivery.regular import open_regular, regular
from file_delivery.room import check_room
from fsw.telemetry.link.packets import (
    CRC_BYTES,
    CUC_BYTES,
    HEADER_BYTES,
    TM_HEADER_BYTES,
    from_cuc,
)
from fsw.telemetry.state.epoch import MAX_CLOCK_ID_CHARACTERS, Epoch, carried_over

MAGIC = b"FSWP"
FORMAT_VERSION = 1
SEGMENTS = 16  # number of segments of a full store
MOST_SEGMENTS = 64  # limit when many segments are short, after many restarts
_HEAD = struct.Struct(f">4sHq{MAX_CLOCK_ID_CHARACTERS}s")
END_MAGIC = b"FSWE"  # no packet begins so
_END = struct.Struct(">4sqq")
END_BYTES = _END.size + 4  # with its CRC-32
_NAME = re.compile(r"(\d{8})\.packets$")
_TIME = slice(TM_HEADER_BYTES - CUC_BYTES, TM_HEADER_BYTES)


@dataclass(slots=True)
class StoreSegment:
    """Times and size of one segment file."""

    number: int
    path: Path
    epoch: Epoch
    size_bytes: int = _HEAD.size
    oldest_ns: int | None = None
    newest_ns: int | None = None

    def note(self, t_ns: int, size_bytes: int) -> None:
        """Add one packet to the segment's counts."""
        self.size_bytes += size_bytes
        self.oldest_ns = t_ns if self.oldest_ns is None else min(self.oldest_ns, t_ns)
        self.newest_ns = t_ns if self.newest_ns is None else max(self.newest_ns, t_ns)


def packet_time_ns(packet: bytes) -> int:
    """Return the time in a packet's secondary header [ns]. Raises ValueError when it has none."""
    if len(packet) < TM_HEADER_BYTES + CRC_BYTES:
        raise ValueError(f"{len(packet)} bytes are not a packet with a time")
    return from_cuc(packet[_TIME])


def split_packets(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield time [ns] and bytes of each packet; stop at the first bytes that are not a packet."""
    while len(head := file.read(HEADER_BYTES)) == HEADER_BYTES and head[:4] != END_MAGIC:
        length = int.from_bytes(head[4:6], "big") + 1
        packet = head + file.read(length)
        if len(packet) < HEADER_BYTES + length:
            return
        try:
            t_ns = packet_time_ns(packet)
        except ValueError:
            return
        yield t_ns, packet


def read_segment(path: Path) -> tuple[Epoch, BinaryIO]:
    """Return the epoch of a segment, and its file at the first packet; the caller closes it.

    Raises
    ------
    OSError, or ValueError when the file is not a segment.
    """
    file = open_regular(path, "rb")
    try:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise ValueError(f"{path.name}: too short")
        magic, version, offset_ns, clock_id = _HEAD.unpack(head)
        if magic != MAGIC or version != FORMAT_VERSION:
            raise ValueError(f"{path.name}: no segment of version {FORMAT_VERSION}")
    except BaseException:
        file.close()
        raise
    name = clock_id.rstrip(b"\0").decode(errors="replace")
    return Epoch(clock_id=name, utc_less_met_ns=offset_ns), file


class PacketStore:
    """Stores packets in the order in which they were made.

    Parameters
    ----------
    limit_bytes : largest size of all segments together [B]
    epoch : returns the origin of present times
    reserve_bytes : free space of the disk that packets leave alone [B]
    """

    def __init__(
        self,
        folder: Path,
        limit_bytes: int,
        epoch: Callable[[], Epoch],
        *,
        reserve_bytes: int = 0,
    ) -> None:
        self._folder, self._epoch, self._reserve_bytes = folder, epoch, reserve_bytes
        self.limit_bytes = limit_bytes
        self._segment_bytes = limit_bytes // SEGMENTS
        self._segments: list[StoreSegment] = []
        self._is_open = False  # whether this run began the newest segment and no write failed
        self._next = 1
        self._find()

    @property
    def size_bytes(self) -> int:
        """Return the size of all segments together [B]."""
        return sum(segment.size_bytes for segment in self._segments)

    @property
    def newest(self) -> Path | None:
        """Return the path of the newest segment, the only one that may not be synchronised."""
        return self._segments[-1].path if self._segments else None

    def span(self) -> tuple[int, int] | None:
        """Return the times of the oldest and newest packet [ns]; None if the store is empty."""
        now = self._epoch()
        times = [
            carried_over(t_ns, segment.epoch, now)
            for segment in self._segments
            for t_ns in (segment.oldest_ns, segment.newest_ns)
            if t_ns is not None
        ]
        return (min(times), max(times)) if times else None

    def append(self, packet: bytes) -> None:
        """Store one packet. Raises OSError; the next packet then begins a new segment."""
        try:
            segment = self._current(len(packet))
            check_room(self._folder, self._reserve_bytes, len(packet))
            _append(segment.path, packet)
        except OSError:
            self._is_open = False
            raise
        segment.note(packet_time_ns(packet), len(packet))

    def packets(self, from_ns: int | None, to_ns: int) -> Iterator[bytes | None]:
        """Yield one item per stored packet: the packet if it is wanted, otherwise None.

        Wanted are packets with a correct CRC from `from_ns` to `to_ns` [ns], both included.

        Parameters
        ----------
        from_ns : None: from the oldest packet, also of earlier starts of the machine
        """
        now = self._epoch()
        for number in [segment.number for segment in self._segments]:
            segment = next((item for item in self._segments if item.number == number), None)
            if segment is None:
                continue  # removed in the meantime
            with suppress(OSError, ValueError):  # it is damaged or cannot be read
                epoch, file = read_segment(segment.path)
                with file:
                    for t_ns, packet in split_packets(file):
                        t_now_ns = carried_over(t_ns, epoch, now)
                        wanted = (from_ns is None or from_ns <= t_now_ns) and t_now_ns <= to_ns
                        yield packet if wanted and crc16.ibm_3740(packet) == 0 else None

    def delete_until(self, t_ns: int) -> int:
        """Remove segments without a packet after a time; return their size [B]. Raises OSError."""
        now, removed = self._epoch(), 0
        for segment in list(self._segments):
            newest_ns = segment.newest_ns
            if newest_ns is not None and carried_over(newest_ns, segment.epoch, now) <= t_ns:
                if segment is self._segments[-1]:
                    self._is_open = False
                removed += self._remove(segment)
        return removed

    def _current(self, size_bytes: int) -> StoreSegment:
        """Return the segment to append a packet to; begin a new one when it is full."""
        if self._is_open:
            segment = self._segments[-1]
            if segment.size_bytes + size_bytes + END_BYTES <= self._segment_bytes:
                return segment
        most_bytes = self.limit_bytes - self._segment_bytes
        while self._segments and (
            self.size_bytes > most_bytes or len(self._segments) >= MOST_SEGMENTS
        ):
            self._remove(self._segments[0])
        return self._begin()

    def _begin(self) -> StoreSegment:
        self._folder.mkdir(parents=True, exist_ok=True)
        check_room(self._folder, self._reserve_bytes, new_file=True)
        if self._is_open:
            _end(self._segments[-1])
        elif self._segments:
            _sync(self._segments[-1].path)
        self._is_open = False
        epoch = self._epoch()
        segment = StoreSegment(self._next, self._folder / f"{self._next:08d}.packets", epoch)
        self._next += 1
        head = _HEAD.pack(MAGIC, FORMAT_VERSION, epoch.utc_less_met_ns, _name(epoch))
        try:
            _append(segment.path, head, os.O_CREAT | os.O_EXCL)
        except OSError:
            with suppress(OSError):
                segment.path.unlink()
            raise
        self._segments.append(segment)
        self._is_open = True
        return segment

    def _remove(self, segment: StoreSegment) -> int:
        segment.path.unlink(missing_ok=True)
        self._segments.remove(segment)
        return segment.size_bytes

    def _find(self) -> None:
        """Find the segments of earlier runs; remove files that are not segments.

        A file that cannot be read now stays: a later start may read it.
        """
        if not self._folder.is_dir():
            return
        named = [(_NAME.match(path.name), path) for path in self._folder.iterdir()]
        for number, path in sorted((int(m[1]), path) for m, path in named if m):
            self._next = number + 1
            try:
                self._segments.append(_found(number, path))
            except OSError:
                continue
            except ValueError:
                with suppress(OSError):
                    path.unlink()


def _found(number: int, path: Path) -> StoreSegment:
    """Return a segment of an earlier run; give a whole one its end. Raises OSError, ValueError."""
    epoch, file = read_segment(path)
    segment = StoreSegment(number, path, epoch)
    with file:
        size_bytes = os.fstat(file.fileno()).st_size
        times = _read_end(file, size_bytes)
        if times is not None:
            segment.oldest_ns, segment.newest_ns = times
        else:
            for t_ns, packet in split_packets(file):
                segment.note(t_ns, len(packet))
    is_whole = times is None and segment.size_bytes == size_bytes
    segment.size_bytes = size_bytes
    if is_whole:
        with suppress(OSError):  # the next start reads its packets again
            _end(segment)
    return segment


def _end(segment: StoreSegment) -> None:
    """Write the end of a segment and wait until it is on the disk. Raises OSError."""
    if segment.oldest_ns is not None and segment.newest_ns is not None:
        end = _END.pack(END_MAGIC, segment.oldest_ns, segment.newest_ns)
        _append(segment.path, end + zlib.crc32(end).to_bytes(4, "big"))
        segment.size_bytes += END_BYTES
    _sync(segment.path)


def _read_end(file: BinaryIO, size_bytes: int) -> tuple[int, int] | None:
    """Return the times in the end of a segment [ns]; None without one, then at the first packet."""
    if size_bytes < _HEAD.size + END_BYTES:
        return None
    file.seek(size_bytes - END_BYTES)
    data = file.read(END_BYTES)
    magic, oldest_ns, newest_ns = _END.unpack_from(data)
    if magic == END_MAGIC and data[_END.size :] == zlib.crc32(data[: _END.size]).to_bytes(4, "big"):
        return oldest_ns, newest_ns
    file.seek(_HEAD.size)
    return None


def _append(path: Path, data: bytes, create: int = 0) -> None:
    """Append all of the data to a file; a removed file is not made again. Raises OSError."""
    descriptor = regular(path, os.O_WRONLY | os.O_APPEND | create, 0o600)
    try:
        if os.write(descriptor, data) != len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    finally:
        os.close(descriptor)


def _sync(path: Path) -> None:
    """Wait until a segment is on the disk, if it still exists. Raises OSError."""
    with suppress(FileNotFoundError), open_regular(path, "rb") as file:
        sync_file(file)


def _name(epoch: Epoch) -> bytes:
    return epoch.clock_id.encode()[:MAX_CLOCK_ID_CHARACTERS]
