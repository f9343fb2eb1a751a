"""Two generations of checkpoints in a directory, replaced in turn and each atomically."""

import zlib
from collections.abc import Callable
from pathlib import Path

from file_delivery.durable import replace_file
from file_delivery.regular import read_regular
from fsw.config import Config
from fsw.config.overlay import noise_of
from fsw.exchange.checkpoint import (
    Checkpoint,
    CheckpointError,
    Identity,
    decode,
    encode,
    sequence_of,
)
from fsw.messages import Snapshot

NAMES = ("checkpoint.0", "checkpoint.1")


def identity_of(config: Config) -> Identity:
    """Return the identity of a configuration: its file, effective noise and robot's file.

    Raises OSError when the robot's file cannot be read.
    """
    robot = read_regular(config.resolve(config.robot.urdf))
    noise = noise_of(config).model_dump_json().encode()
    return Identity(zlib.crc32(noise, config.crc32), zlib.crc32(robot))


class CheckpointStore:
    """Writes and reads the checkpoints of one configuration."""

    def __init__(
        self, directory: Path, identity: Identity, boot_id: Callable[[], str] = str
    ) -> None:
        """`boot_id` returns the identifier of the stamps' clock; empty: it is unknown."""
        self._directory, self._identity, self._boot_id = directory, identity, boot_id
        self._sequences: dict[str, int] | None = None

    def write(self, snapshot: Snapshot) -> int:
        """Replace the older generation; return the number of bytes written. Raises OSError.

        The new file is complete on the disk before it gets the old file's name.
        """
        sequences = self._known()
        name = min(NAMES, key=lambda name: sequences[name])
        sequence = max(sequences.values()) + 1
        data = encode(
            Checkpoint(
                identity=self._identity,
                sequence=sequence,
                boot_id=self._boot_id(),
                snapshot=snapshot,
            )
        )
        replace_file(self._directory / name, data)
        sequences[name] = sequence
        return len(data)

    def read(self) -> tuple[list[Checkpoint], list[str]]:
        """Return the good generations, newest first, and the reasons why others were refused."""
        good, refused = [], []
        for name in NAMES:
            try:
                data = read_regular(self._directory / name)
                good.append(decode(data, self._identity))
            except FileNotFoundError:
                continue
            except OSError as error:
                refused.append(f"{name}: cannot be read: {error.strerror or error}")
            except CheckpointError as error:
                refused.append(f"{name}: {error}")
        return sorted(good, key=lambda checkpoint: -checkpoint.sequence), refused

    def find(self, sequence: int) -> tuple[bytes | None, Checkpoint | None]:
        """Return the checkpoint of a sequence number, as bytes and decoded; None: missing."""
        for name in NAMES:
            try:
                data = read_regular(self._directory / name)
                checkpoint = decode(data, self._identity)
            except (OSError, CheckpointError):
                continue
            if checkpoint.sequence == sequence:
                return data, checkpoint
        return None, None

    def _known(self) -> dict[str, int]:
        """Return the sequence number by file, of any owner; -1: missing or damaged."""
        if self._sequences is None:
            self._sequences = {}
            for name in NAMES:
                path = self._directory / name
                self._sequences[name] = sequence_of(read_regular(path)) if path.exists() else -1
        return self._sequences
