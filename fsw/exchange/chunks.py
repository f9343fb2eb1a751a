"""Expands the chunks of MCAP files within bounds: a few hundred bytes can expand to gigabytes."""

from dataclasses import replace
from zlib import crc32

import lz4.frame
import zstandard
from mcap.exceptions import UnsupportedCompressionError
from mcap.records import Chunk

MAX_CHUNK_BYTES = 256 << 20  # of one chunk, expanded; writers close theirs at some megabytes


def expanded(chunk: Chunk) -> Chunk:
    """Return the chunk without compression.

    Raises
    ------
    ValueError if it is larger than MAX_CHUNK_BYTES or than it says, or if its CRC is wrong;
    McapError, ZstdError or RuntimeError (lz4) if it cannot be decompressed.
    """
    size, data = chunk.uncompressed_size, chunk.data
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk of {size} bytes; at most {MAX_CHUNK_BYTES} are read")
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(data) > size:  # would be its limit instead of `size`
            raise ValueError("a chunk expands to more bytes than it says")
        data = zstandard.decompress(data, size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif chunk.compression:
        raise UnsupportedCompressionError(chunk.compression)
    if len(data) != size:
        raise ValueError("a chunk does not expand to as many bytes as it says")
    if chunk.uncompressed_crc not in (0, crc32(data)):
        raise ValueError("the CRC of a chunk is wrong")
    return replace(chunk, compression="", data=data, uncompressed_crc=0)
