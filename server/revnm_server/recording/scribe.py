"""Turns what was observed into messages of a record: runs in the recorder's thread, which may take its time."""

from __future__ import annotations

import numpy as np

from revnm_client.errors import MessageError
from revnm_server.camera.jpeg import encode_jpeg
from revnm_server.recording import ros, topics
from revnm_server.recording.diagnosis import diagnose
from revnm_server.recording.entry_queue import LogEntry, TickEntry
from revnm_server.recording.frame_tree import FLOOR, FrameTree
from revnm_server.recording.record_file import RecordFile
from revnm_server.recording.tick_document import encode_tick
from revnm_server.recording.topics import Topic
from revnm_server.recording.wire_tap import WireEntry, wire_topics
from revnm_server.tick.site_report import SiteReport, SiteRoute
from revnm_server.tick.tick_recorder import ObservedTick
from revnm_server.views.view import ServerView

_DEPTH_STEPS = 1000  # a fifth of what floats take, a third of 16 bits: a network is not that exact


class Scribe:
    """Writes entries into one file after another.

    Args:
        camera: The camera's name.
        robots: Their names.
        jpeg_quality: Of pictures that did not come as JPEG.
        site: What was known of the camera and the robots' places when the recording began.

    Attributes:
        refused: Number of malformed payloads, which are not written.
    """

    def __init__(self, camera: str, robots: tuple[str, ...], *, jpeg_quality: int, site: SiteReport | None) -> None:
        self.refused = 0
        self._camera, self._robots, self._quality = camera, robots, jpeg_quality
        self._frames = FrameTree(camera, robots)
        self._site = site
        self._told: object = None  # the calibration that was written last

    @property
    def topics(self) -> list[Topic]:
        """What every file is to have from its beginning."""
        own = [topics.TICKS, topics.TRANSFORMS, topics.STILL_TRANSFORMS, topics.DIAGNOSTICS, topics.LOG]
        own += [topics.picture(self._camera), topics.depth(self._camera)]
        return [*own, *(topic for robot in self._robots for topic in wire_topics(robot).values())]

    def begin(self, file: RecordFile, *, at_ns: int) -> None:
        """Write what the rest of the file needs."""
        self._told = None
        self._write_still(file, at_ns)
        if self._site is not None:
            self._write_moving(file, self._site, self._site.stamp_ns, at_ns)

    def write(self, file: RecordFile, entry: TickEntry | WireEntry | LogEntry) -> None:
        """Write an entry.

        Raises:
            OSError: The disk is full or fails.
        """
        if isinstance(entry, TickEntry):
            self._write_tick(file, entry)
        elif isinstance(entry, WireEntry):
            self._write_wire(file, entry)
        else:
            self._write_log(file, entry)

    def write_view(self, file: RecordFile, view: ServerView, *, at_ns: int) -> None:
        """Write the state of the server."""
        message = ros.diagnostics_message(diagnose(view), stamp_ns=at_ns)
        file.write(topics.DIAGNOSTICS, message, log_ns=at_ns)

    def _write_wire(self, file: RecordFile, entry: WireEntry) -> None:
        payload = entry.payload
        try:
            if entry.topic == topics.state(entry.robot):
                payload = ros.string_message(payload.decode())
            else:
                ros.check_message(payload, entry.topic.type)
            if self._frames.learn(entry):
                self._write_still(file, entry.at_ns)
            ticket = ros.string_message(entry.attachment.decode()) if entry.attachment is not None else None
        except (MessageError, UnicodeDecodeError):
            self.refused += 1
            return
        file.write(entry.topic, payload, log_ns=entry.at_ns)
        if ticket is not None and entry.topic == topics.waypoints(entry.robot):
            file.write(topics.ticket(entry.robot), ticket, log_ns=entry.at_ns)

    def _write_log(self, file: RecordFile, entry: LogEntry) -> None:
        message = ros.log_message(entry.text, stamp_ns=entry.at_ns, level=entry.level, name=entry.name)
        file.write(topics.LOG, message, log_ns=entry.at_ns)

    def _write_tick(self, file: RecordFile, entry: TickEntry) -> None:
        frame, result, at_ns = entry.tick.frame, entry.tick.result, entry.at_ns
        jpeg = frame.jpeg or encode_jpeg(frame.image, quality=self._quality)
        picture = ros.jpeg_message(jpeg, stamp_ns=frame.stamp_ns, frame=self._camera)
        file.write(topics.picture(self._camera), picture, log_ns=at_ns, publish_ns=frame.stamp_ns)
        self._frames.hear(entry.heard)
        site = result.site if result is not None else None
        if site is not None:
            self._site = site
            self._write_moving(file, site, frame.stamp_ns, at_ns)
        if result is not None:
            steps = np.rint(result.disparity * _DEPTH_STEPS).astype(np.uint16)
            self._write_image(file, topics.depth(self._camera), steps, self._camera, entry)
            for robot, ego in result.ego_depths.items():
                self._write_image(file, topics.ego_depth(robot), ego, self._camera, entry)
        self._write_goals(file, entry, site.routes if site is not None else {})
        news = site is not None and site.calibration is not self._told
        calibration = site.calibration if news and site is not None else None
        self._told = site.calibration if site is not None else self._told
        text = encode_tick(entry.tick, entry.heard, number=entry.number, calibration=calibration)
        file.write(topics.TICKS, ros.string_message(text), log_ns=at_ns, publish_ns=frame.stamp_ns)

    def _write_image(self, file: RecordFile, topic: Topic, image: np.ndarray, frame: str, entry: TickEntry) -> None:
        stamp_ns = entry.tick.frame.stamp_ns
        message = ros.image_message(image, stamp_ns=stamp_ns, frame=frame)
        file.write(topic, message, log_ns=entry.at_ns, publish_ns=stamp_ns)

    def _write_goals(self, file: RecordFile, entry: TickEntry, routes: dict[str, SiteRoute]) -> None:
        tick: ObservedTick = entry.tick
        stamp_ns, (width, height) = tick.frame.stamp_ns, tick.frame.size_px
        for robot, goal in tick.goals.items():
            u, v = goal.normalised
            pixel = ros.point_message((u * width, v * height), stamp_ns=stamp_ns, frame=self._camera)
            file.write(topics.goal_pixel(robot), pixel, log_ns=entry.at_ns, publish_ns=stamp_ns)
        for robot, route in routes.items():
            if route.goal_m is not None:
                pose = ros.pose_message(route.goal_m, stamp_ns=stamp_ns, frame=FLOOR)
                file.write(topics.goal(robot), pose, log_ns=entry.at_ns, publish_ns=stamp_ns)
            if route.way_m is not None:
                way = ros.path_message(route.way_m, stamp_ns=stamp_ns, frame=FLOOR)
                file.write(topics.way(robot), way, log_ns=entry.at_ns, publish_ns=stamp_ns)

    def _write_still(self, file: RecordFile, at_ns: int) -> None:
        # Stamped 0: viewers look for a transform at or before a message's stamp, whatever the robot's clock says.
        file.write(topics.STILL_TRANSFORMS, ros.transforms_message(self._frames.still, stamp_ns=0), log_ns=at_ns)

    def _write_moving(self, file: RecordFile, site: SiteReport, stamp_ns: int, at_ns: int) -> None:
        moving = self._frames.moving(site)
        if moving:
            message = ros.transforms_message(moving, stamp_ns=stamp_ns)
            file.write(topics.TRANSFORMS, message, log_ns=at_ns, publish_ns=stamp_ns)
        camera = site.calibration.camera
        if camera is not None:
            message = ros.camera_message(camera, stamp_ns=stamp_ns, frame=self._camera)
            file.write(topics.camera_info(self._camera), message, log_ns=at_ns, publish_ns=stamp_ns)
