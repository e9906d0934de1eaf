"""One MCAP file of a run record while it is written.

It is called ``NAME.mcap.part`` until it is complete. What was flushed survives the end of the process:
:mod:`revnm_server.recording.recovery` makes a readable file of it. A lock tells others that it is being written.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer

from revnm_server.recording.topics import Topic, schema_text

LIBRARY = "revnm-server"
PART = ".part"

_CHUNK_BYTES = 1_000_000


class RecordFile:
    """A file that messages are written into; used by one thread.

    Attributes:
        path: What it is called when it is complete.
        messages: How many it holds.
    """

    def __init__(
        self,
        path: Path,
        *,
        about: Mapping[str, str],
        topics: Iterable[Topic] = (),
        compression: CompressionType = CompressionType.ZSTD,
    ) -> None:
        """Begin a file, with its schemas.

        Args:
            path: ``NAME.mcap``; nothing may be there.
            about: What the record is of.
            topics: What it will hold; others may come.
            compression: Of its chunks.

        Raises:
            OSError: It cannot be written.
        """
        self.path, self.messages = path, 0
        self._waiting_bytes = 0
        self._part = path.with_name(path.name + PART)
        self._stream = self._part.open("xb")
        self._writer = Writer(self._stream, chunk_size=_CHUNK_BYTES, compression=compression)
        self._schemas: dict[str, int] = {}
        self._channels: dict[Topic, int] = {}
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._writer.start(Profile.ROS2, LIBRARY)
            self._writer.add_metadata("revnm", dict(about))
            for topic in topics:
                self._channel(topic)
            self._stream.flush()
        except OSError:
            self.abandon()
            raise

    @property
    def size_bytes(self) -> int:
        """What has gone to the disk, and what of a chunk waits to."""
        return self._stream.tell() + self._waiting_bytes

    def write(self, topic: Topic, payload: bytes, *, log_ns: int, publish_ns: int | None = None) -> None:
        """Add a message.

        Args:
            topic: Where it belongs.
            payload: CDR.
            log_ns: When it was received, nanoseconds, server's clock.
            publish_ns: When it was sent or is of, if that is known.

        Raises:
            OSError: The disk is full or fails.
        """
        publish_ns = log_ns if publish_ns is None else publish_ns
        before_bytes = self._stream.tell()
        self._writer.add_message(self._channel(topic), log_time=log_ns, data=payload, publish_time=publish_ns)
        self._waiting_bytes = self._waiting_bytes + len(payload) if self._stream.tell() == before_bytes else 0
        self.messages += 1

    def flush(self) -> None:
        """Hand everything to the operating system: it outlives this process from now on.

        Raises:
            OSError: The disk is full or fails.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._waiting_bytes = 0

    def finish(self) -> None:
        """Complete the file and give it its name; one that was finished or abandoned stays as it is.

        Raises:
            OSError: The disk is full or fails; what was written before is left as a part.
        """
        if self._stream.closed:
            return
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.flush()
            os.fsync(self._stream.fileno())
            self._part.rename(self.path)
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Leave the file as it is."""
        with contextlib.suppress(OSError):  # what cannot be written now could not be written before
            self._stream.close()

    def _channel(self, topic: Topic) -> int:
        known = self._channels.get(topic)
        if known is not None:
            return known
        if topic.type not in self._schemas:
            text = schema_text(topic.type)
            self._schemas[topic.type] = self._writer.register_schema(topic.type, SchemaEncoding.ROS2, text)
        schema = self._schemas[topic.type]
        self._channels[topic] = self._writer.register_channel(topic.name, MessageEncoding.CDR, schema)
        return self._channels[topic]
