"""Reads what is sound of a damaged or cut MCAP file, whatever is wrong with it.

The format: magic, then records of a byte of kind, eight bytes of length, and content; messages lie in compressed chunks
with a checksum (https://mcap.dev/spec). Where a length leads nowhere, the next chunk is looked for.
"""

from __future__ import annotations

import io
import mmap
import struct
import zlib
from collections.abc import Iterator

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema

_HEAD = 9  # kind and length
_LARGEST_CHUNK = 64_000_000  # ours are closed at a million bytes, and a message has eight million at most
_MARK = struct.pack("<I", 4) + b"zstd"  # in every chunk of ours
_MARK_AT = 8 + 8 + 8 + 4  # behind the start of its content: two times, size, checksum
_READERS = {Opcode.SCHEMA: Schema.read, Opcode.CHANNEL: Channel.read, Opcode.METADATA: Metadata.read}
_KINDS = {int(each) for each in Opcode}
_UNREADABLE = (McapError, struct.error, ValueError, zstandard.ZstdError, EOFError)


class McapScan:
    """Goes through a file; may be iterated again and again.

    Attributes:
        damaged: Chunks, other records and gaps that could not be read, of the last time.
    """

    def __init__(self, data: mmap.mmap | bytes) -> None:
        self._data = data
        self.damaged = 0

    def __iter__(self) -> Iterator[Schema | Channel | Metadata | Message]:
        """Yield schemas, channels, metadata and messages, in the order of the file."""
        self.damaged = 0
        place: int | None = 8
        while place is not None and place + _HEAD <= len(self._data):
            kind, length = struct.unpack_from("<BQ", self._data, place)
            end = place + _HEAD + length
            if kind not in _KINDS or end > len(self._data):
                self.damaged += 1
                place = self._next_chunk(place + 1)
                continue
            yield from self._records(kind, place + _HEAD, end)
            place = end

    def _records(self, kind: int, start: int, end: int) -> list[Schema | Channel | Metadata | Message]:
        """Return what a record or a chunk holds; nothing where it is damaged or of another kind."""
        if kind != Opcode.CHUNK and kind not in _READERS:
            return []
        stream = ReadDataStream(io.BytesIO(self._data[start:end]))
        try:
            if kind == Opcode.CHUNK:
                return list(_opened(Chunk.read(stream)))
            return [_READERS[Opcode(kind)](stream)]
        except _UNREADABLE:
            self.damaged += 1
            return []

    def _next_chunk(self, start: int) -> int | None:
        """Return where the next chunk that may be one begins."""
        while True:
            mark = self._data.find(_MARK, start)
            if mark < 0:
                return None
            place = mark - _MARK_AT - _HEAD
            if place >= start:
                kind, length = struct.unpack_from("<BQ", self._data, place)
                if kind == Opcode.CHUNK and place + _HEAD + length <= len(self._data):
                    return place
            start = mark + 1


def _opened(chunk: Chunk) -> Iterator[Schema | Channel | Message]:
    """Yield what lies in a chunk.

    Raises:
        ValueError: It is not what its checksum says, or absurdly large.
        McapError: A record in it is malformed.
        ZstdError: It is not compressed as it says.
    """
    data = _inflated(chunk)
    if zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("the checksum does not fit")
    stream = ReadDataStream(io.BytesIO(data))
    while stream.count < len(data):
        kind, length = stream.read1(), stream.read8()
        content = ReadDataStream(io.BytesIO(stream.read(length)))
        record: McapRecord | None = None
        if kind == Opcode.MESSAGE:
            record = Message.read(content, length)
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            record = _READERS[Opcode(kind)](content)
        if isinstance(record, Schema | Channel | Message):
            yield record


def _inflated(chunk: Chunk) -> bytes:
    if chunk.compression != "zstd":
        raise ValueError(f"compression {chunk.compression!r:.20}: expected zstd")
    sizes = (chunk.uncompressed_size, zstandard.frame_content_size(chunk.data))
    if max(sizes) > _LARGEST_CHUNK:
        raise ValueError(f"a chunk of {max(sizes)} bytes: expected at most {_LARGEST_CHUNK}")
    return bytes(zstandard.decompress(chunk.data, max_output_size=chunk.uncompressed_size))
