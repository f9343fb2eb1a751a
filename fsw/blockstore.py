"""The newest blocks in a memory-mapped file: the service writes, the batch worker reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsw.messages import Block

CAPACITY = 8192  # blocks; 55 min at 0.4 s
_FLAGS = ("has_gyro", "has_accelerometer", "has_attitude")


def block_dtype(nodes: int, joints: int) -> np.dtype[np.void]:
    """Return the layout of one stored block."""
    per_joint = ("q_rad", "qd_rad_s", "qdd_rad_s2", "tau_nm", "var_qdd", "var_tau")
    per_axis = (
        "w_NB_B_rad_s",
        "wd_NB_B_rad_s2",
        "f_NS_B_m_s2",
        "var_w",
        "var_wd",
        "var_f",
    )
    fields: list[tuple[str, str, tuple[int, ...]]] = [
        ("serial", "<i8", ()),  # 1-based position in the stream; 0: never written
        ("index", "<i8", ()),
        ("t_ns", "<i8", (nodes,)),
        ("R_NB", "<f8", (nodes, 3, 3)),
        ("has_joint", "?", (joints,)),
    ]
    fields += [(name, "<f8", (nodes, joints)) for name in per_joint]
    fields += [(name, "<f8", (nodes, 3)) for name in per_axis]
    fields += [(name, "?", ()) for name in _FLAGS]
    return np.dtype(fields)


def unpack_block(row: NDArray[np.void] | np.void) -> Block:
    """Return the block of one stored row."""
    names = [name for name in row.dtype.names or () if name not in {"serial", "index", *_FLAGS}]
    values: dict[str, Any] = {name: np.array(row[name]) for name in names}
    for array in values.values():
        array.setflags(write=False)
    values |= {name: bool(row[name]) for name in _FLAGS}
    return Block(index=int(row["index"]), **values)


class BlockWriter:
    """The writing end."""

    def __init__(self, path: Path, nodes: int, joints: int, capacity: int = CAPACITY) -> None:
        self.path = path
        dtype = block_dtype(nodes, joints)
        self._rows = np.memmap(path, dtype=dtype, mode="w+", shape=(capacity,))
        self.count = 0

    def append(self, block: Block) -> None:
        """Store a block over the oldest one."""
        row = self._rows[self.count % len(self._rows)]
        self.count += 1
        row["serial"] = 0
        for name in self._rows.dtype.names or ():
            if name != "serial":
                row[name] = getattr(block, name)
        row["serial"] = self.count


def read_blocks(path: Path, nodes: int, joints: int, *, last_s: float | None = None) -> list[Block]:
    """Return the stored blocks in order; only those of the newest `last_s` seconds when given."""
    rows = np.memmap(path, dtype=block_dtype(nodes, joints), mode="r")
    before = np.array(rows["serial"])
    copy = np.array(rows)
    stable = (before > 0) & (before == rows["serial"])  # not overwritten while it was copied
    copy = copy[stable]
    copy = copy[np.argsort(copy["serial"])]
    return newest([unpack_block(row) for row in copy], last_s)


def newest(blocks: list[Block], last_s: float | None) -> list[Block]:
    """Return the blocks of the newest `last_s` seconds; all when it is None."""
    if last_s is None or not blocks:
        return blocks
    since_ns = int(blocks[-1].t_ns[-1]) - round(last_s * 1e9)
    return [block for block in blocks if int(block.t_ns[0]) >= since_ns]
