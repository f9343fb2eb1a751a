"""The service's side of the block store: it keeps every block, and reports when it cannot."""

from collections.abc import Callable
from pathlib import Path

from fsw.messages import Block
from fsw.service.blockstore import BlockStoreError, BlockWriter, read_blocks

Report = Callable[[str, str, str], None]  # severity, code, text


class BlockLog:
    """Stores blocks for batch jobs; after a failure, the next block is tried again.

    Parameters
    ----------
    reserve_bytes : free space of the disk that the store leaves alone [B]
    report : receives severity, code and text of an event at the first of successive failures
    """

    def __init__(self, path: Path, reserve_bytes: int, report: Report) -> None:
        self._path, self._reserve_bytes, self._report = path, reserve_bytes, report
        self._has_failed = False
        self._writer: BlockWriter | None = None

    def resume(self, receive: Callable[[Block], None]) -> None:
        """Continue the store of a crashed service; `receive` gets its blocks."""
        try:
            for block in read_blocks(self._path):
                receive(block)
            self._writer = BlockWriter(self._path, keep=True, reserve_bytes=self._reserve_bytes)
        except BlockStoreError as error:
            self._fail(error)

    def append(self, block: Block) -> None:
        """Store a block; the first begins a new store. Report the first of successive failures."""
        try:
            if self._writer is None:
                self._writer = BlockWriter(self._path, reserve_bytes=self._reserve_bytes)
            self._writer.append(block)
        except (OSError, BlockStoreError) as error:
            self._fail(error)
        else:
            self._has_failed = False

    def begin_again(self) -> None:
        """Begin a new store with the next block, because the file was removed."""
        self._writer = None

    def _fail(self, error: Exception) -> None:
        if not self._has_failed:
            self._report("medium", "BLOCKS_FAILED", str(error))
        self._has_failed = True
