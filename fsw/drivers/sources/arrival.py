"""Latest possible arrival of a frame's last byte, from the chunks that hold the frame.

A line sends the bytes of a frame without gaps, so each chunk bounds the arrival: an earlier chunk
by its stamp plus the time of the bytes still missing, the chunk with the last byte by its stamp
minus the time of the accepted bytes behind it. Bytes in no accepted frame never count, so junk
shifts no time. Bounds of earlier chunks are final when the frame is accepted. The bound of the last
chunk is final once the next accepted frame that ends in a later chunk is known.
"""

from dataclasses import dataclass

from fsw.drivers.codecs.framing import Frame

BITS_PER_BYTE = 10  # 8N1


@dataclass(slots=True)
class Arrival:
    """Bounds of one accepted frame's arrival [ns]."""

    n: int  # device time [ticks]
    delay_ns: float  # from device time to the arrival of the last byte
    t_receive_ns: int  # stamp of the chunk with the last byte
    spill_ns: float  # earliest bound from the chunks before, relative to t_receive_ns
    bytes_before: int  # accepted bytes in the chunk of t_receive_ns up to the last byte

    def bound_ns(self, bytes_in_chunk: int, byte_ns: float) -> float:
        """Return the bound relative to t_receive_ns [ns]; it is never positive."""
        return min(self.spill_ns, (self.bytes_before - bytes_in_chunk) * byte_ns)


class ArrivalTracker:
    """Collects the accepted frames of the open chunk, whose bounds are not final yet."""

    def __init__(self, baud_rate: int) -> None:
        self.byte_ns = BITS_PER_BYTE * 1e9 / baud_rate
        self.bytes_in_chunk = 0  # accepted bytes of the open chunk
        self._chunk = -1
        self._open: list[Arrival] = []

    def is_new_chunk(self, frame: Frame) -> bool:
        """Return whether adding this frame makes the open chunk final."""
        return frame.pieces[-1].chunk != self._chunk

    def finish(self, frame: Frame) -> list[Arrival]:
        """Return the open chunk's arrivals, which are final as `frame` ends in a later chunk.

        `bytes_in_chunk` belongs to these arrivals until the next `add`.
        """
        for piece in frame.pieces[:-1]:
            if piece.chunk == self._chunk:
                self.bytes_in_chunk += piece.length
        done, self._open = self._open, []
        return done

    def add(self, frame: Frame, n: int, delay_ns: float) -> Arrival:
        """Add an accepted frame of device time n [ticks]; return its arrival."""
        last = frame.pieces[-1]
        if last.chunk != self._chunk:
            self._chunk = last.chunk
            self.bytes_in_chunk = 0
        self.bytes_in_chunk += last.length
        spill_ns = 0.0
        missing = len(frame.data)
        for piece in frame.pieces[:-1]:
            missing -= piece.length
            spill_ns = min(spill_ns, piece.t_ns - last.t_ns + missing * self.byte_ns)
        arrival = Arrival(n, delay_ns, last.t_ns, spill_ns, self.bytes_in_chunk)
        self._open.append(arrival)
        return arrival

    def finish_whole(self) -> list[Arrival]:
        """Return the arrivals of the open chunk, which are final now, and forget them.

        Call this for a frame that is wholly in a later chunk.
        """
        done, self._open = self._open, []
        return done

    def add_whole(self, chunk: int, count: int, length: int) -> None:
        """Open a chunk that holds nothing but `count` accepted frames of `length` bytes."""
        self._chunk, self.bytes_in_chunk = chunk, count * length

    def hold(self, arrivals: list[Arrival]) -> None:
        """Keep the arrivals of the open chunk until they are final."""
        self._open = arrivals

    def clear(self) -> None:
        """Discard the arrivals that are not final, because the device's time has jumped."""
        self._open = []
