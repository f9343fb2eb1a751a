"""The service's part in checkpoints: joins a state with the blocks it refers to and writes both."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fsw.clock import boot_id
from fsw.config import Config
from fsw.exchange.checkpoint_store import CheckpointStore, identity_of
from fsw.messages import Block, Snapshot

MOST_LATER = 1024  # kept blocks newer than those of the newest state: gated, or not used yet


class CheckpointKeeper:
    """Keeps the blocks that a state may refer to, and writes every received state.

    Parameters
    ----------
    report : receives severity, code and text of an event at the first of successive failures
    """

    def __init__(
        self, config: Config, directory: Path, report: Callable[[str, str, str], None]
    ) -> None:
        self._report, self._directory = report, directory
        self._blocks: dict[int, Block] = {}
        self._store: CheckpointStore | None = None
        self._written = self._failed = self._bytes = 0
        self._told = False
        self.configured(config)

    def configured(self, config: Config) -> None:
        """Adopt the effective configuration for checkpoints written from now on."""
        if config.service.checkpoint_period_s is None:
            return
        try:
            self._store = CheckpointStore(self._directory, identity_of(config), boot_id)
        except OSError as error:
            self._fail(f"{config.robot.urdf}: {error.strerror or error}")

    def block(self, block: Block) -> None:
        """Keep a block until a state no longer refers to it."""
        if self._store is not None:
            self._blocks[block.index] = block

    def adopt(self, sequence: int) -> bytes | None:
        """Keep the blocks of the checkpoint from which this run continues; return its bytes."""
        if self._store is None:
            return None
        data, checkpoint = self._store.find(sequence)
        if checkpoint is not None:
            for block in checkpoint.snapshot.blocks:
                self._blocks.setdefault(block.index, block)
        return data

    def write(self, snapshot: Snapshot) -> None:
        """Write a state with its blocks; if blocks of the state were lost, write nothing."""
        if self._store is None:
            return
        wanted = snapshot.refers
        if self._missing(wanted):
            self._take_back(self._store, snapshot.grid_ns)
        missing = self._missing(wanted)
        if missing:
            self._fail(f"{len(missing)} blocks of the state did not come")
            return
        blocks = tuple(self._blocks[index] for index in wanted)
        self._forget(wanted)
        try:
            self._bytes = self._store.write(replace(snapshot, blocks=blocks))
        except OSError as error:
            self._fail(str(error.strerror or error))
            return
        self._written += 1
        self._told = False

    def _missing(self, wanted: Sequence[int]) -> list[int]:
        return [index for index in wanted if index not in self._blocks]

    def _take_back(self, store: CheckpointStore, grid_ns: int | None) -> None:
        """Read the missing blocks from the checkpoints of a crashed service of the same loop.

        Only on the same grid does an index mean the same block.
        """
        for checkpoint in store.read()[0]:
            if checkpoint.snapshot.grid_ns == grid_ns:
                for block in checkpoint.snapshot.blocks:
                    self._blocks.setdefault(block.index, block)

    def _forget(self, wanted: Sequence[int]) -> None:
        """Keep the blocks of the newest state, and the newest ones: a later state may need them."""
        keep, newest = set(wanted), max(wanted, default=-1)
        later = sorted(index for index in self._blocks if index > newest)
        keep |= set(later[-MOST_LATER:])
        self._blocks = {i: block for i, block in self._blocks.items() if i in keep}

    def summary(self) -> dict[str, Any]:
        """Return counters as plain values."""
        return {"written": self._written, "failed": self._failed, "bytes": self._bytes}

    def _fail(self, why: str) -> None:
        self._failed += 1
        if not self._told:
            self._told = True
            self._report("medium", "CHECKPOINT_FAILED", why)
