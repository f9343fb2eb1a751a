"""Checkpoints: an estimator's state as bytes, with checks that refuse damaged and foreign ones.

Layout, little-endian: magic (8), format version u16, CRC-32 of the configuration u32, CRC-32 of the
robot's file u32, sequence u64, length of the body u64; body; CRC-32 of all before. The body is
MessagePack; an array is extension type 1: MessagePack of type, shape and bytes.
"""

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np

from fsw.errors import WRONG_CONTENT, FswError
from fsw.messages import Block, Snapshot

MAGIC = b"FSWCKPT\n"
FORMAT_VERSION = 11  # rises with every change of the content of states
_HEAD = struct.Struct("<8sHIIQQ")
_CRC = struct.Struct("<I")
_ARRAY = 1
_TYPES = ("|b1", "<i8", "<f8")


class CheckpointError(FswError):
    """A checkpoint is refused; the message names the reason."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Owner of a state: check values of the configuration and of the robot's file."""

    config_crc32: int
    robot_crc32: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """A snapshot with the data that another process needs to use it."""

    identity: Identity
    sequence: int  # number of the write to its state directory
    boot_id: str  # the monotonic clock of another boot has another origin
    snapshot: Snapshot


def encode(checkpoint: Checkpoint) -> bytes:
    """Return the bytes of a checkpoint."""
    snapshot, identity = checkpoint.snapshot, checkpoint.identity
    body = _packed(
        {
            "boot_id": checkpoint.boot_id,
            "t_ns": snapshot.t_ns,
            "grid_ns": snapshot.grid_ns,
            "state": snapshot.state,
            "changes": snapshot.changes,
            "identifying": snapshot.identifying,
            "blocks": [
                {name: getattr(block, name) for name in block.stored} for block in snapshot.blocks
            ],
        }
    )
    head = _HEAD.pack(
        MAGIC,
        FORMAT_VERSION,
        identity.config_crc32,
        identity.robot_crc32,
        checkpoint.sequence,
        len(body),
    )
    return head + body + _CRC.pack(zlib.crc32(body, zlib.crc32(head)))


def sequence_of(data: bytes) -> int:
    """Return the sequence number of a checkpoint of any owner; -1 if it is damaged."""
    try:
        return int(_checked(data)[4])
    except CheckpointError:
        return -1


def decode(data: bytes, identity: Identity | None = None) -> Checkpoint:
    """Return the checkpoint in `data`, which must have this identity; None: any identity.

    Raises
    ------
    CheckpointError naming the reason: damaged, of another version, or foreign.
    """
    _, version, config_crc32, robot_crc32, sequence, _ = _checked(data)
    if version != FORMAT_VERSION:
        raise CheckpointError(f"format version {version}; this software has {FORMAT_VERSION}")
    found = Identity(config_crc32, robot_crc32)
    if identity is not None and config_crc32 != identity.config_crc32:
        raise CheckpointError("foreign: made with another configuration")
    if identity is not None and robot_crc32 != identity.robot_crc32:
        raise CheckpointError("foreign: made for another robot")
    try:
        read = msgpack.unpackb(data[_HEAD.size : -_CRC.size], ext_hook=_array, strict_map_key=False)
        body = _mapping(read)
        blocks = [_mapping(values) for values in _list(body["blocks"])]
        snapshot = Snapshot(
            t_ns=_integer(body["t_ns"]),
            grid_ns=None if body["grid_ns"] is None else _integer(body["grid_ns"]),
            state=_mapping(body["state"]),
            changes=tuple(_mapping(changes) for changes in _list(body["changes"])),
            identifying=body["identifying"] is True,
            refers=tuple(_integer(values["index"]) for values in blocks),
            blocks=tuple(Block(**values) for values in blocks),
        )
        boot_id = str(body["boot_id"])
    except (*WRONG_CONTENT, msgpack.exceptions.UnpackException) as error:
        raise CheckpointError(f"damaged: its body cannot be read: {error}") from error
    return Checkpoint(identity=found, sequence=sequence, boot_id=boot_id, snapshot=snapshot)


def _checked(data: bytes) -> tuple[Any, ...]:
    """Return the header's fields; raise CheckpointError if magic, length or CRC is wrong."""
    if len(data) < _HEAD.size + _CRC.size:
        raise CheckpointError(f"damaged: {len(data)} bytes are too few")
    head = _HEAD.unpack_from(data)
    if head[0] != MAGIC:
        raise CheckpointError("damaged: not a checkpoint")
    length = _HEAD.size + head[5] + _CRC.size
    if len(data) != length:
        raise CheckpointError(f"damaged: {len(data)} bytes instead of {length}")
    (crc,) = _CRC.unpack_from(data, len(data) - _CRC.size)
    if zlib.crc32(memoryview(data)[: -_CRC.size]) != crc:
        raise CheckpointError("damaged: check value is wrong")
    return head


def _packed(values: object) -> bytes:
    packed: bytes = msgpack.packb(values, default=_extension)
    return packed


def _extension(value: object) -> Any:  # noqa: ANN401 - MessagePack's hook
    if isinstance(value, np.ndarray) and value.dtype.str in _TYPES:
        parts = (value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes())
        return msgpack.ExtType(_ARRAY, _packed(parts))
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} has no place in a checkpoint")


def _array(code: int, data: bytes) -> Any:  # noqa: ANN401 - MessagePack's hook
    if code != _ARRAY:
        raise ValueError(f"extension type {code} is unknown")
    kind, shape, content = _list(msgpack.unpackb(data))
    if kind not in _TYPES:
        raise ValueError(f"arrays of type {kind!r} have no place in a checkpoint")
    if not isinstance(content, bytes):
        raise TypeError(f"an array's content is bytes, not {type(content).__name__}")
    array = np.frombuffer(content, kind).reshape([_integer(size) for size in _list(shape)])
    array.setflags(write=False)
    return array


def _mapping(values: object) -> dict[str, Any]:
    if not isinstance(values, dict):
        raise TypeError(f"a mapping is expected, not {type(values).__name__}")
    return values


def _list(values: object) -> list[Any]:
    if not isinstance(values, list):
        raise TypeError(f"a list is expected, not {type(values).__name__}")
    return values


def _integer(value: object) -> int:
    if not isinstance(value, int):
        raise TypeError(f"a whole number is expected, not {type(value).__name__}")
    return value
