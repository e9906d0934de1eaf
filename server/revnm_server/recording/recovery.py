"""Makes a readable record of one that was cut or damaged: the power failed, or the disk did."""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel, Message, Metadata, Schema
from mcap.well_known import Profile
from mcap.writer import Writer

from revnm_client.errors import FileError
from revnm_server.recording.mcap_scan import McapScan
from revnm_server.recording.record_file import LIBRARY, PART

_NONE = 0  # id of the schema of channels that have none


@dataclass(frozen=True, slots=True)
class Recovered:
    """What could be saved.

    Attributes:
        path: The readable file.
        messages: How many it holds.
        orphans: Messages that nothing says the topic of.
        damaged: Chunks and other places of the file that could not be read.
    """

    path: Path
    messages: int
    orphans: int
    damaged: int


def recover(path: Path) -> Recovered:
    """Write what is sound of a file into ``NAME.recovered.mcap`` next to it; the file itself stays as it is.

    Raises:
        FileError: It cannot be read, nothing in it can be, or the new one is there already or cannot be written.
    """
    target = path.with_name(path.name.removesuffix(PART).removesuffix(".mcap") + ".recovered.mcap")
    if target.exists():
        raise FileError(f"{target} is there already: move it away, or use it")
    fresh = target.with_name(target.name + ".new")
    try:
        with _mapped(path) as scan:
            channels = _channels(scan)
            saved = _copy(scan, channels, fresh)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        raise FileError(f"{error.filename or fresh}: {error.strerror}") from error
    if not saved.messages:
        fresh.unlink()
        raise FileError(f"{path}: no message can be read: expected a record of this program, an MCAP file")
    fresh.rename(target)
    return Recovered(target, saved.messages, saved.orphans, saved.damaged)


@contextmanager
def _mapped(path: Path) -> Iterator[McapScan]:
    with path.open("rb") as file:
        if path.stat().st_size == 0:
            yield McapScan(b"")
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield McapScan(data)


_Known = dict[int, tuple[Channel, Schema | None]]


def _channels(scan: McapScan) -> _Known:
    """Return what is said of each channel, wherever it stands: a file repeats at its end what its first chunk said."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for record in scan:
        if isinstance(record, Schema):
            schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            channels.setdefault(record.id, record)
    return {
        number: (channel, schemas.get(channel.schema_id))
        for number, channel in channels.items()
        if channel.schema_id == _NONE or channel.schema_id in schemas
    }


def _copy(scan: McapScan, channels: _Known, fresh: Path) -> Recovered:
    messages = orphans = 0
    with fresh.open("wb") as stream:
        writer = Writer(stream)
        writer.start(Profile.ROS2, LIBRARY)
        numbers = _registered(writer, channels)
        for record in scan:
            if isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Message):
                if record.channel_id not in numbers:
                    orphans += 1
                    continue
                messages += 1
                writer.add_message(
                    numbers[record.channel_id],
                    log_time=record.log_time,
                    data=record.data,
                    publish_time=record.publish_time,
                    sequence=record.sequence,
                )
        writer.finish()  # type: ignore[no-untyped-call]
    return Recovered(fresh, messages, orphans, scan.damaged)


def _registered(writer: Writer, channels: _Known) -> dict[int, int]:
    """Tell the new file of the channels; return its numbers for theirs."""
    schemas: dict[int, int] = {}
    numbers = {}
    for number, (channel, schema) in channels.items():
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        schema_id = schemas[schema.id] if schema is not None else _NONE
        numbers[number] = writer.register_channel(channel.topic, channel.message_encoding, schema_id, channel.metadata)
    return numbers
