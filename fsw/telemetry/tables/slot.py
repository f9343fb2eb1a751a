"""One table: its active, staged and previous content, and its state."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum

from fsw.errors import ConfigError
from fsw.telemetry.dictionary.codes import Error
from fsw.telemetry.state.store import GenerationStore


class TableState(IntEnum):
    """State of a table; the names are those of the dictionary's labels."""

    ACTIVE = 0
    LOADING = 1
    STAGED = 2
    VALIDATED = 3
    ACTIVATING = 4


class Copy(IntEnum):
    """Copy of a table: active, staged or previous."""

    ACTIVE = 0
    STAGED = 1
    PREVIOUS = 2


@dataclass(slots=True)
class Slot:
    """State of one table: its staged, active and previous content."""

    store: GenerationStore
    state: TableState = TableState.ACTIVE
    staged: bytearray = field(default_factory=bytearray)
    size: int = 0
    crc32: int = 0
    active: bytes = b""  # empty: as in the configuration
    previous: bytes | None = None
    generation: int = 0
    error: Error = Error.NONE

    def values(self) -> dict[str, int]:
        """Return the fields of the table in housekeeping set 6, without the table's name."""
        return {
            "state": int(self.state),
            "generation": self.generation,
            "active_crc32": zlib.crc32(self.active),
            "staged_crc32": zlib.crc32(self.staged),
            "staged_bytes": len(self.staged),
            "error": int(self.error),
        }

    def drop(self) -> None:
        """Discard the staged content and the error."""
        self.state, self.staged, self.size, self.crc32 = TableState.ACTIVE, bytearray(), 0, 0
        self.error = Error.NONE

    def recall(self, validate: Callable[[bytes], None]) -> int:
        """Activate the newest valid stored generation; return the number of invalid ones.

        Parameters
        ----------
        validate : raises ConfigError
        """
        generations, damaged = self.store.read()
        good = []
        for generation in generations:
            try:
                validate(generation.content)
            except ConfigError:
                damaged += 1
            else:
                good.append(generation)
        if good:
            self.active, self.generation = good[0].content, good[0].number
            self.previous = good[1].content if len(good) > 1 else b""
        return damaged
