# SPDX-License-Identifier: Apache-2.0
"""Every whole record of an MCAP file, however the file ends.

The library's readers stop with whatever exception the first bad byte happens to cause; here a file that was cut off or
damaged gives all that is intact in it: a record counts when it is complete, a chunk when its checksum holds.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, breakup_chunk

from softgrip_bag.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_KINDS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}
#: Stand beside the chunks, and are found without opening these.
BESIDE_CHUNKS = frozenset({Opcode.ATTACHMENT, Opcode.METADATA})
#: What damaged bytes make the library's parsers raise: they trust lengths and texts. zstandard and lz4 have errors of
#: their own, RuntimeError is the latter's.
_DAMAGE = (McapError, CRCValidationError, struct.error, ValueError, EOFError, OverflowError, MemoryError, RuntimeError)


@dataclass
class Damage:
    """What is wrong with a file: bytes that belong to no whole record, and chunks with a wrong checksum."""

    lost_bytes: int = 0
    bad_chunks: int = 0
    complete: bool = False  # the file has its end


def is_finished(path: Path) -> bool:
    """Return whether a file begins and ends as MCAP does."""
    with path.open("rb") as stream:
        size = stream.seek(0, io.SEEK_END)
        if size < 2 * len(MAGIC) + _HEAD.size:
            return False
        stream.seek(-len(MAGIC), io.SEEK_END)
        tail = stream.read()
        stream.seek(0)
        return stream.read(len(MAGIC)) == MAGIC and tail == MAGIC


def records(
    path: Path, damage: Damage | None = None, opcodes: Collection[int] = frozenset({Opcode.MESSAGE, *_KINDS})
) -> Iterator[McapRecord]:
    """Yield header, schemas, channels, messages, attachments and metadata records in the order of the file.

    Args:
        path: of the file.
        damage: filled in on the way.
        opcodes: the kinds of record to read; others are passed over.

    Raises:
        BagError: when the file does not begin as MCAP, not even the part that is there.
    """
    damage = damage if damage is not None else Damage()
    with path.open("rb") as stream:
        size = stream.seek(0, io.SEEK_END)
        stream.seek(0)
        start = stream.read(len(MAGIC))
        if not MAGIC.startswith(start):
            raise BagError(f"{path}: expected MCAP, found a file that begins with {start!r}")
        yield from _body(stream, size, damage, opcodes)


def _body(stream: IO[bytes], size: int, damage: Damage, opcodes: Collection[int]) -> Iterator[McapRecord]:
    while True:
        at = stream.tell()
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            break
        opcode, length = _HEAD.unpack(head)
        if opcode == Opcode.DATA_END and at + _HEAD.size + length <= size:
            damage.complete = True
            return
        if opcode == 0 or at + _HEAD.size + length > size:
            break
        if opcode in opcodes:
            yield from _parsed(opcode, stream.read(length), damage)
        else:
            stream.seek(length, io.SEEK_CUR)
    damage.lost_bytes = size - at


def _parsed(opcode: int, body: bytes, damage: Damage) -> Iterator[McapRecord]:
    data = ReadDataStream(io.BytesIO(body))
    try:
        if opcode == Opcode.MESSAGE:
            found: list[McapRecord] = [Message.read(data, len(body))]
        else:
            record = _KINDS[opcode].read(data)
            found = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
    except _DAMAGE:
        damage.bad_chunks += 1
        return
    except Exception as error:
        if type(error).__module__.partition(".")[0] not in {"zstandard", "zstd", "lz4"}:
            raise
        damage.bad_chunks += 1
        return
    yield from found
