"""Two generations of checkpoints in a directory, replaced in turn and each atomically."""

import zlib
from pathlib import Path

from file_delivery.durable import replace_file
from fsw.clock import suspended_s
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
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


def identity_of(config: Config) -> Identity:
    """Return the identity of a configuration: its file, effective noise and robot's file.

    Raises OSError when the robot's file cannot be read.
    """
    robot = config.resolve(config.robot.urdf).read_bytes()
    noise = noise_of(config).model_dump_json().encode()
    return Identity(zlib.crc32(noise, config.crc32), zlib.crc32(robot))


def boot_id() -> str:
    """Return the identifier of the monotonic clock; empty if the system does not provide it.

    It is the kernel's boot identifier. After the machine was suspended, the time suspended is added
    to it: the clock stood still, so a time from before tells no age.
    """
    try:
        boot = BOOT_ID.read_text(encoding="ascii").strip()
    except OSError:
        return ""
    asleep_s = suspended_s()
    return f"{boot} +{asleep_s}" if asleep_s else boot


class CheckpointStore:
    """Writes and reads the checkpoints of one configuration."""

    def __init__(self, directory: Path, identity: Identity) -> None:
        self._directory, self._identity = directory, identity
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
                boot_id=boot_id(),
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
                data = (self._directory / name).read_bytes()
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
                data = (self._directory / name).read_bytes()
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
                self._sequences[name] = sequence_of(path.read_bytes()) if path.exists() else -1
        return self._sequences
