"""Targets for files: checkpoints and recordings."""

import os
import struct
import zlib
from pathlib import Path

from evidence.fuzz.oracle import Target, require
from fsw.errors import ConfigError
from fsw.exchange.checkpoint import (
    FORMAT_VERSION,
    MAGIC,
    Checkpoint,
    CheckpointError,
    Identity,
    decode,
    encode,
)
from fsw.exchange.recording import contents, messages

HEAD = struct.Struct("<8sHIIQQ")
TOPICS = ("/can/arm", "/serial/imu", "/tc")


def sealed_checkpoint(body: bytes) -> bytes:
    """Return a checkpoint file around a body, with correct length and check value."""
    head = HEAD.pack(MAGIC, FORMAT_VERSION, 1, 2, 3, len(body))
    return head + body + struct.pack("<I", zlib.crc32(head + body))


def checkpoint_target() -> Target:
    """Return the target of checkpoints; an input is `+` and a body, or a whole file."""
    identity = Identity(1, 2)

    def one(data: bytes) -> None:
        file = sealed_checkpoint(data[1:]) if data[:1] == b"+" else data
        try:
            found = decode(file, identity)
        except CheckpointError as error:
            require(str(error), "a refusal without words", file)
            return
        require(isinstance(found, Checkpoint), "no checkpoint", file)
        again = encode(found)
        require(encode(decode(again, identity)) == again, "not the same again", file)

    return one


def recording_target() -> Target:
    """Return the target of the reader of recordings; an input is an MCAP file or a damaged one."""
    fd = os.memfd_create("fuzz")
    path = Path(f"/proc/self/fd/{fd}")

    def one(data: bytes) -> None:
        os.ftruncate(fd, 0)
        os.pwrite(fd, data, 0)
        try:
            held = contents(path)
            found = list(messages(path, TOPICS))
        except ConfigError as error:
            require(str(error), "a refusal without words")
            return
        require(all(record.topic in TOPICS for record in found), "topics", found)
        stamps = [record.t_ns for record in found]
        require(stamps == sorted(stamps), "stamps run backwards", stamps)
        require(len(held.topics) <= len(data), "more topics than bytes")

    return one
