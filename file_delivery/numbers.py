"""Transaction numbers of 63 bits that are never used twice, even if the stored one is lost."""

import secrets
import time
from pathlib import Path

from file_delivery.durable import replace_file
from file_delivery.locks import locked
from file_delivery.regular import read_regular

NUMBER_BITS = 63  # in a field of 8 octets
RANDOM_BITS = 10
WAIT_S = 0.5  # for another process that takes a number


class Numbers:
    """The numbers of one sender, stored in a file; several processes may use it at once.

    Numbers increase by one. Without a stored number, they begin at the time of day in microseconds
    with random low bits: above all numbers of the past, which grew more slowly than the time.

    Parameters
    ----------
    path : path of the file; its folder must exist
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def take(self) -> int:
        """Return the next number; without lock or file, a new one that is out of order."""
        try:
            with locked(self._path.with_suffix(".lock"), WAIT_S):
                number = self._kept() + 1
                replace_file(self._path, f"{number}\n")
                return number
        except OSError:
            return beginning()

    def _kept(self) -> int:
        try:
            number = int(read_regular(self._path))
        except (FileNotFoundError, ValueError):
            return beginning()
        return number if 0 <= number < (1 << NUMBER_BITS) - 1 else beginning()


def beginning() -> int:
    """Return a number above all that were ever used."""
    return time.time_ns() // 1000 << RANDOM_BITS | secrets.randbits(RANDOM_BITS)
