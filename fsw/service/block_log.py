"""The service's side of the block store: it keeps every block, and reports when it cannot."""

from collections.abc import Callable
from pathlib import Path

from fsw.messages import Block
from fsw.service.blockstore import BlockStoreError, BlockWriter, read_blocks

Report = Callable[[str, str, str], None]  # severity, code, text


class BlockLog:
    """Stores blocks for batch jobs; the next block tries again what has failed.

    Parameters
    ----------
    reserve_bytes : free space of the disk that the store leaves alone [B]
    report : receives severity, code and text of an event at the first of successive failures
    """

    def __init__(self, path: Path, reserve_bytes: int, report: Report) -> None:
        self._path, self._reserve_bytes, self._report = path, reserve_bytes, report
        self._has_failed = False
        self._writer = BlockWriter(path, keep=True, reserve_bytes=reserve_bytes)

    @classmethod
    def begin(
        cls, path: Path, reserve_bytes: int, report: Report, resumed: Callable[[Block], None] | None
    ) -> "BlockLog":
        """Begin a store; with `resumed` continue one, whose blocks that function receives."""
        if resumed is not None:
            try:
                for block in read_blocks(path):
                    resumed(block)
                return cls(path, reserve_bytes, report)
            except BlockStoreError as error:
                report("medium", "BLOCKS_FAILED", str(error))
        path.unlink(missing_ok=True)
        return cls(path, reserve_bytes, report)

    def append(self, block: Block) -> None:
        """Store a block; report the first of successive failures."""
        try:
            self._writer.append(block)
        except (OSError, BlockStoreError) as error:
            if not self._has_failed:
                self._report("medium", "BLOCKS_FAILED", str(error))
            self._has_failed = True
        else:
            self._has_failed = False

    def begin_again(self) -> None:
        """Begin a new store, because somebody has removed the file."""
        self._writer = BlockWriter(self._path, reserve_bytes=self._reserve_bytes)
