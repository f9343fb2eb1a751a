"""The newest blocks in a memory-mapped file: the service writes, the batch worker reads.

Layout: 4096 bytes of header (JSON: name, type and largest shape of the fields of a row), then a
ring of fixed-size rows. Each row begins with its 1-based position in the stream; 0: not written.
The room of an array is the largest shape for this number of joints and nodes, whatever noise is
configured; the actual shape is stored with it.
"""

import json
import os
from dataclasses import fields
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from file_delivery.regular import open_regular
from file_delivery.room import check_room
from fsw.errors import WRONG_CONTENT, FswError
from fsw.messages import PARTS, Block

CAPACITY = 8192  # blocks; 55 min at 0.4 s
HEADER_BYTES = 4096
_NAMES = tuple(item.name for item in fields(Block))
_LAYOUTS = tuple(
    ("serial", *(name for name in _NAMES if all(name not in part for part in without)))
    for without in product(*(((), part) for part in PARTS))
)
_SHAPE = ".shape"  # of the array whose name stands before it


class BlockStoreError(FswError):
    """A file is not a block store, or a block does not fit into its row."""


def row_fields(block: Block) -> list[tuple[str, str, list[int]]]:
    """Return name, type and largest shape of every field of a stored row."""
    rows: list[tuple[str, str, list[int]]] = [("serial", "<i8", [])]
    n, m = len(block.cov_joint), len(block.t_ns)
    for name in block.stored:
        value = np.asarray(getattr(block, name))
        room = (n, 3 * m, 3 * m) if name == "cov_joint" else value.shape
        rows.append((name, value.dtype.str, list(room)))
        if room:
            rows.append((name + _SHAPE, "<i4", [len(room)]))
    return rows


def _pack(row: np.void, block: Block) -> None:
    """Write a block into a row. Raises BlockStoreError if it does not fit; the row is unchanged."""
    values = {name: np.asarray(getattr(block, name)) for name in block.stored}
    for name, value in values.items():
        room = row[name].shape
        if value.ndim != len(room) or any(
            size > most for size, most in zip(value.shape, room, strict=True)
        ):
            raise BlockStoreError(f"{name} {value.shape} has no room in {room}")
    row["serial"] = 0
    for name, value in values.items():
        if value.ndim:
            row[name][tuple(map(slice, value.shape))] = value
            row[name + _SHAPE] = value.shape
        else:
            row[name] = value


def _unpack(row: np.void) -> Block:
    values: dict[str, Any] = {}
    for name in _NAMES:
        if name not in (row.dtype.names or ()):
            continue  # of a part that this robot does not have
        value = np.array(row[name])
        if value.ndim:
            value = value[tuple(map(slice, row[name + _SHAPE]))].copy()
        value.setflags(write=False)
        values[name] = value if value.ndim else value.item()
    return Block(**values)


class BlockWriter:
    """Writes blocks into the store; the first block creates the file.

    `keep` continues the file of a writer that has ended without closing. The file has its full size
    at once and leaves `reserve_bytes` of the disk free.

    Raises
    ------
    BlockStoreError when the file is not a block store.
    """

    def __init__(
        self, path: Path, capacity: int = CAPACITY, *, keep: bool = False, reserve_bytes: int = 0
    ) -> None:
        self.path, self._reserve_bytes = path, reserve_bytes
        self.count = 0
        self._capacity = capacity
        self._rows: NDArray[np.void] | None = None
        if keep and path.exists():
            self._rows = _open(path, "r+")
            self._capacity = len(self._rows)
            self.count = int(self._rows["serial"].max())
        else:
            path.unlink(missing_ok=True)

    def append(self, block: Block) -> None:
        """Store a block; a full store loses its oldest one. Raises OSError or BlockStoreError."""
        if self._rows is None:
            self._rows = self._create(block)
        row = self._rows[self.count % self._capacity]
        _pack(row, block)
        self.count += 1
        row["serial"] = self.count

    def _create(self, block: Block) -> NDArray[np.void]:
        layout = row_fields(block)
        dtype = _dtype(layout)
        size = HEADER_BYTES + dtype.itemsize * self._capacity
        check_room(self.path.parent, self._reserve_bytes, size, new_file=True)
        new = self.path.with_suffix(".new")  # complete before a reader finds it
        try:
            with open_regular(new, "wb") as file:
                file.write(json.dumps(layout).encode().ljust(HEADER_BYTES))
                file.flush()
                os.posix_fallocate(file.fileno(), 0, size)  # a full disk shows here, not as SIGBUS
            new.replace(self.path)
        except OSError:
            new.unlink(missing_ok=True)
            raise
        return _open(self.path, "r+")


def read_blocks(path: Path, *, last_s: float | None = None) -> list[Block]:
    """Return the stored blocks in order; only those of the newest `last_s` [s] if it is given.

    Raises
    ------
    BlockStoreError when the file is not a block store.
    """
    if not path.exists():
        return []
    rows = _open(path, "r")
    before = np.array(rows["serial"])
    copy = np.array(rows)
    stable = (before > 0) & (before == rows["serial"])  # not overwritten while it was copied
    copy = copy[stable]
    copy = copy[np.argsort(copy["serial"])]
    return newest([_unpack(row) for row in copy], last_s)


def newest(blocks: list[Block], last_s: float | None) -> list[Block]:
    """Return the blocks of the newest `last_s` [s]; all blocks if it is None."""
    if last_s is None or not blocks:
        return blocks
    since_ns = int(blocks[-1].t_ns[-1]) - round(last_s * 1e9)
    return [block for block in blocks if int(block.t_ns[0]) >= since_ns]


def _open(path: Path, mode: Literal["r", "r+"]) -> NDArray[np.void]:
    try:
        with open_regular(path, "rb") as file:
            dtype = _dtype(json.loads(file.read(HEADER_BYTES)))
        if tuple(n for n in dtype.names or () if not n.endswith(_SHAPE)) not in _LAYOUTS:
            raise BlockStoreError(f"{path}: fields {dtype.names}")
        rows = np.memmap(path, dtype=dtype, mode=mode, offset=HEADER_BYTES)
    except (OSError, MemoryError, *WRONG_CONTENT) as error:
        raise BlockStoreError(f"{path}: {error}") from error
    if not 0 < len(rows) <= CAPACITY:
        raise BlockStoreError(f"{path}: {len(rows)} rows; must be 1 to {CAPACITY}")
    return rows


def _dtype(layout: list[Any]) -> np.dtype[np.void]:
    return np.dtype([(name, kind, tuple(shape)) for name, kind, shape in layout])
