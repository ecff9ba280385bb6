# SPDX-License-Identifier: Apache-2.0
"""What is inside a chunk, decompressed within bounds: a few bytes of a file must not take the computer's memory.

zstd packs zeros 30,000 times over, so a file of some kilobytes may say that it holds gigabytes. The sizes that chunk
and frame say are compared before anything is decompressed. Source: MCAP specification, "Chunk"; RFC 8878, 3.1.1.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Any

import lz4.frame
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Chunk

#: [byte] a chunk up to this size may be packed as tightly as it likes: black pictures are.
FREE_BYTES = 64 << 20
#: Beyond it, times its size in the file.
MAX_RATIO = 100
_RECORD = struct.Struct("<BQ")


class ChunkError(McapError):
    """A chunk that is damaged, or that would take more memory than one of its size may."""


def chunk_bytes(chunk: Chunk) -> bytes:
    """Return the records of a chunk, decompressed and checked.

    Raises:
        ChunkError: too large, unknown compression, damaged, or not what its checksum says.
    """
    limit = max(FREE_BYTES, MAX_RATIO * len(chunk.data))
    if chunk.uncompressed_size > limit:
        raise ChunkError(
            f"expected at most {limit} bytes in a chunk of {len(chunk.data)}, found one that says "
            f"{chunk.uncompressed_size}; made to take memory, or damaged"
        )
    data = _decompressed(chunk)
    if len(data) != chunk.uncompressed_size:
        raise ChunkError(f"expected {chunk.uncompressed_size} bytes in a chunk, found {len(data)}")
    if chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
        raise ChunkError(f"expected a chunk with checksum {chunk.uncompressed_crc}, found {zlib.crc32(data)}")
    return data


def chunk_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and size of each record in a chunk's bytes.

    Raises:
        EndOfFile: a record reaches beyond the end.
    """
    start = 0
    while start < len(data):
        if start + _RECORD.size > len(data):
            raise EndOfFile
        opcode, size = _RECORD.unpack_from(data, start)
        start += _RECORD.size
        if start + size > len(data):
            raise EndOfFile
        yield opcode, start, size
        start += size


def _decompressed(chunk: Chunk) -> bytes:
    try:
        if chunk.compression == "zstd":
            return _zstd(chunk.data, chunk.uncompressed_size)
        if chunk.compression == "lz4":
            return _lz4(chunk.data, chunk.uncompressed_size)
    except (zstandard.ZstdError, RuntimeError, ValueError) as error:  # RuntimeError is lz4's
        raise ChunkError(f"expected {chunk.compression} in a chunk, found {error}") from error
    if chunk.compression == "":
        return bytes(chunk.data)
    raise ChunkError(f"expected a chunk packed with zstd, lz4 or not at all, found {chunk.compression!r}")


def _zstd(data: bytes, size: int) -> bytes:
    said = zstandard.frame_content_size(data)  # -1 = the frame does not say
    if said not in {-1, size}:
        raise ChunkError(f"expected a frame of {size} bytes in a chunk, found one of {said}")
    unpacked: bytes = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    return unpacked


def _lz4(data: bytes, size: int) -> bytes:
    unpacker: Any = lz4.frame.LZ4FrameDecompressor()
    unpacked: bytes = unpacker.decompress(data, max_length=size + 1)
    return unpacked
