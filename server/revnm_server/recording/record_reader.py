"""Reads a run record for a replay: tick after tick, with what each was given."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader

from revnm_client.cdr import decode_image, decode_odometry, decode_scan
from revnm_client.errors import FileError, MessageError
from revnm_client.messages import Odometry, Scan
from revnm_server.camera.jpeg import decode_jpeg
from revnm_server.frame import Frame
from revnm_server.ports import Heard
from revnm_server.recording import topics
from revnm_server.recording.about import FORMAT
from revnm_server.recording.heard_log import Listening
from revnm_server.recording.ros import read_string
from revnm_server.recording.tick_document import HeardStamps, TickDocument, decode_tick

_AHEAD = 10  # ticks: a message may be written later than the tick that heard it
_KEPT = 20_000  # messages in which a tick's are looked for


@dataclass(frozen=True, slots=True)
class RecordedTick:
    """A tick as it can be made again.

    Attributes:
        document: What was told of it.
        frame: Its picture.
        heard: What it heard, in its order.
        missing: Messages that it heard and the record lacks.
    """

    document: TickDocument
    frame: Frame
    heard: tuple[Listening, ...]
    missing: int


@dataclass(frozen=True, slots=True)
class RecordAbout:
    """What a record says of the server that made it.

    Attributes:
        camera: The camera's name.
        robots: Tag id of each robot.
        perception: The settings of that name, as in the settings file.
        depth: Those of a depth network that took the place of the bundle's; empty where none did.
        bundle: Name of the folder of its models.
        bundle_sha256: Hash of their manifest.
    """

    camera: str
    robots: dict[str, int]
    perception: dict[str, Any]
    depth: dict[str, Any]
    bundle: str
    bundle_sha256: str


class RecordReader:
    """Reads the files of one record.

    Attributes:
        about: What the first file says of the server.
        broken: Ticks whose picture or document is missing or malformed, so far.
        early: Ticks at its beginning that heard what came before the record, and are passed over.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        """Open a record.

        Args:
            paths: Its files, in the order in which they were written.

        Raises:
            FileError: The first is no record of this program.
        """
        self._paths = paths
        self.broken = self.early = 0
        self._begun = False
        self.about = _about(paths[0])

    def ticks(self) -> Iterator[RecordedTick]:
        """Yield the ticks in their order.

        Raises:
            FileError: A file cannot be read.
        """
        gathered = _Gathered(self.about)
        waiting: deque[TickDocument] = deque()
        for path in self._paths:
            for topic, payload in _messages(path):
                if topic == topics.TICKS.name:
                    self._take_document(payload, waiting)
                else:
                    gathered.take(topic, payload)
                if len(waiting) > _AHEAD:
                    yield from self._made(waiting.popleft(), gathered)
        for document in waiting:
            yield from self._made(document, gathered)

    def _take_document(self, payload: bytes, waiting: deque[TickDocument]) -> None:
        try:
            waiting.append(decode_tick(read_string(payload)))
        except (FileError, MessageError):
            self.broken += 1

    def _made(self, document: TickDocument, gathered: _Gathered) -> Iterator[RecordedTick]:
        try:
            image = decode_jpeg(gathered.pictures.pop(document.stamp_ns))
        except (KeyError, MessageError):
            self.broken += 1
            return
        heard = tuple(gathered.heard(each) for each in document.heard)
        told = sum(len(each.odometry_ns) + len(each.scans_ns) for each in document.heard)
        found = sum(len(each.heard.odometry) + len(each.heard.scans) for each in heard)
        self._begun |= told == found
        if not self._begun:
            self.early += 1
            return
        yield RecordedTick(document, Frame(image, document.stamp_ns, document.seq), heard, told - found)


class _Gathered:
    """The newest pictures and messages, by their stamps."""

    def __init__(self, about: RecordAbout) -> None:
        self.pictures: dict[int, bytes] = {}
        self._odometry: dict[tuple[str, int], Odometry] = {}
        self._scans: dict[tuple[str, int], Scan] = {}
        self._picture = topics.picture(about.camera).name
        self._odometry_of = {topics.odometry(robot).name: robot for robot in about.robots}
        self._scans_of = {topics.scan(robot).name: robot for robot in about.robots}

    def take(self, topic: str, payload: bytes) -> None:
        """Keep a message for the tick that asks for it."""
        try:
            if topic == self._picture:
                image = decode_image(payload)
                self.pictures[image.stamp_ns] = image.data
                _forget(self.pictures, 2 * _AHEAD)
            elif topic in self._odometry_of:
                odometry = decode_odometry(payload)
                self._odometry[self._odometry_of[topic], odometry.stamp_ns] = odometry
                _forget(self._odometry, _KEPT)
            elif topic in self._scans_of:
                scan = decode_scan(payload)
                self._scans[self._scans_of[topic], scan.stamp_ns] = scan
                _forget(self._scans, _KEPT)
        except MessageError:
            return  # the server did not hear it either

    def heard(self, told: HeardStamps) -> Listening:
        """Return what was heard in a turn, in the server's clock, as far as it is there."""
        odometry = (self._odometry.get((told.robot, stamp_ns)) for stamp_ns in told.odometry_ns)
        scans = (self._scans.get((told.robot, stamp_ns)) for stamp_ns in told.scans_ns)
        heard = Heard(
            tuple(replace(o, stamp_ns=o.stamp_ns + told.offset_ns) for o in odometry if o is not None),
            tuple(
                replace(s, stamp_ns=s.stamp_ns + told.offset_ns, robot_from_lidar=told.robot_from_lidar)
                for s in scans
                if s is not None
            ),
            told.offset_ns,
            told.robot_from_lidar,
        )
        return Listening(told.robot, heard)


def _forget(kept: dict[Any, Any], most: int) -> None:
    if len(kept) > most:
        del kept[next(iter(kept))]


def _messages(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield topic and payload in the order in which they were written."""
    try:
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
                yield channel.topic, message.data
    except (OSError, McapError, ValueError) as error:
        raise _unreadable(path, error) from error


def _about(path: Path) -> RecordAbout:
    try:
        with path.open("rb") as file:
            told = next((each.metadata for each in make_reader(file).iter_metadata() if each.name == "revnm"), {})
    except (OSError, McapError, ValueError) as error:
        raise _unreadable(path, error) from error
    try:
        if told["format"] != FORMAT:
            raise FileError(f"{path}: format is {told['format']!r:.80}: expected {FORMAT!r}")
        settings = json.loads(told["settings"])
        return RecordAbout(
            camera=str(settings["camera"]["name"]),
            robots={str(robot): int(tag) for robot, tag in settings["robots"].items()},
            perception=dict(settings["perception"]),
            depth=dict(settings["depth"]),
            bundle=told["bundle"],
            bundle_sha256=told["bundle_manifest_sha256"],
        )
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise FileError(f"{path}: expected a run record of this program: {error!r}") from error


def _unreadable(path: Path, error: Exception) -> FileError:
    if isinstance(error, OSError) and error.strerror:
        return FileError(f"{path}: {error.strerror}")
    return FileError(f"{path} cannot be read ({error or type(error).__name__}): see revnm-server record recover")
