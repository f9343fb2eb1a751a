"""Serial port over pyserial, for devices and pseudo-terminals; bytes are read in chunks."""

from __future__ import annotations

import contextlib
import os
import termios

import serial

from fsw.clock import Clock
from fsw.drivers.ports.system_words import of_system
from fsw.drivers.wire import ByteChunk
from fsw.errors import PortError

READ_BYTES = 4096
MAX_READS = 64  # per call, so that a babbling line cannot block the loop


def open_serial(path: str, baud: int, clock: Clock) -> SerialPort:
    """Open a line (8 data bits, no parity, 1 stop bit) and discard the bytes waiting in it.

    Raises
    ------
    PortError naming the path, also if the line hangs up while it is opened.
    """
    try:
        line = serial.Serial(path, baud, timeout=0, write_timeout=1.0, exclusive=True)
        with contextlib.suppress(ValueError):  # pseudo-terminals and some adapters refuse
            line.set_low_latency_mode(True)
        line.reset_input_buffer()
        os.set_blocking(line.fileno(), False)
        _separate_idle_from_hang_up(line.fileno())
    except (OSError, ValueError, termios.error) as error:
        words = of_system(error)  # the library repeats port and number
        raise PortError(f"serial {path}: cannot be opened at {baud} baud: {words}") from error
    return SerialPort(line, clock, path)


def _separate_idle_from_hang_up(fd: int) -> None:
    """Make a read of an idle line raise EAGAIN, so that an empty read means a hang-up."""
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN] = 1
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


class SerialPort:
    """An open serial line."""

    def __init__(self, line: serial.Serial, clock: Clock, path: str) -> None:
        self._line = line
        self._fd = line.fileno()
        self._clock = clock
        self._path = path

    def read(self) -> list[ByteChunk]:
        """Return the bytes received since the last call, stamped right after each read."""
        chunks: list[ByteChunk] = []
        while len(chunks) < MAX_READS:
            try:
                data = os.read(self._fd, READ_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                raise PortError(f"serial {self._path}: cannot be read: {error}") from error
            if not data:
                raise PortError(f"serial {self._path}: the other end hung up")
            chunks.append(ByteChunk(self._clock.now_ns(), data))
            if len(data) < READ_BYTES:
                break
        return chunks

    def write(self, data: bytes) -> None:
        """Send bytes."""
        try:
            self._line.write(data)
        except (serial.SerialException, OSError) as error:
            raise PortError(f"serial {self._path}: cannot be written: {error}") from error

    def wake_fds(self) -> tuple[int, ...]:
        """Return the line's descriptor: a wake by it gives arrivals a fine stamp."""
        return (self._fd,)

    def close(self) -> None:
        """Release the line."""
        self._line.close()
