"""Numbers of transactions: 63 bits, never used twice, also when what was kept of them is lost."""

import fcntl
import secrets
import time
from pathlib import Path

from file_delivery.durable import replace_file

NUMBER_BITS = 63  # of a field of 8 octets
RANDOM_BITS = 10


class Numbers:
    """The numbers of one sender, kept in a file; several processes may take numbers at once.

    Successive numbers follow one another. Where nothing is kept, they begin at the time of day in
    microseconds with random low bits: beyond all numbers of the past, which grew more slowly.

    Parameters
    ----------
    path : of the file; its folder must exist
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def take(self) -> int:
        """Return the next number. A file that cannot be written costs the order, never a reuse."""
        try:
            with self._path.with_suffix(".lock").open("w") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                number = self._kept() + 1
                replace_file(self._path, f"{number}\n")
                return number
        except OSError:
            return beginning()

    def _kept(self) -> int:
        try:
            number = int(self._path.read_text())
        except (FileNotFoundError, ValueError):
            return beginning()
        return number if 0 <= number < (1 << NUMBER_BITS) - 1 else beginning()


def beginning() -> int:
    """Return a number beyond all that were ever used."""
    return time.time_ns() // 1000 << RANDOM_BITS | secrets.randbits(RANDOM_BITS)
