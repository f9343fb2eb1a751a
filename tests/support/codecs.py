"""Helpers for the tests of codecs of inertial units."""

from typing import Any

from fsw.drivers.codecs.imu_datagram import ImuCodec
from fsw.drivers.wire import ByteChunk


def decoded(codec: ImuCodec, data: bytes) -> list[Any]:
    """Return what each frame of a stream is decoded to."""
    return [codec.decode(frame) for frame in codec.framer.feed(ByteChunk(0, data))]
