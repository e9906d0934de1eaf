"""A drive over the map, recorded and made again: what the robots said must be heard in the same turns."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tests.server.recording_parts import VIEW, read, records

from revnm_client import keys
from revnm_client.cdr import encode_odometry, encode_scan
from revnm_client.geometry import FloatArray
from revnm_client.link import open_router
from revnm_client.messages import Scan
from revnm_server.camera.jpeg import encode_jpeg
from revnm_server.frame import Frame, RobotSighting
from revnm_server.networks.bundle import default_bundle_path
from revnm_server.observation import Image32
from revnm_server.ports import Senses
from revnm_server.recording.about import describe
from revnm_server.recording.heard_log import HeardLog
from revnm_server.recording.record_reader import RecordReader
from revnm_server.recording.recorder import Recorder
from revnm_server.recording.replay import Comparison, RecordedSenses, known_before, replay
from revnm_server.robots.mission import Goal
from revnm_server.robots.robot_senses import RobotSenses
from revnm_server.settings import load_settings
from revnm_server.tick.map_pipeline import MapPipeline
from revnm_server.tick.tick_recorder import ObservedTick

from .map_room import GOAL_M, HW, SHAPE, SIZE_PX, Room, pixel_of

BASE_NS, TICK_NS = 1_700_000_000_000_000_000, 200_000_000
GOALS = {"rover": Goal("g", pixel_of(*GOAL_M), SIZE_PX)}
TICKS, SECOND_FROM = 36, 24


class Remembered:
    """What depth and tags of the room were at each stamp; asked again, they are the same."""

    def __init__(self, room: Room) -> None:
        self._room = room
        self._disparities: dict[int, Image32] = {}
        self._sightings: dict[int, list[RobotSighting]] = {}

    def disparity(self, frame: Frame) -> Image32:
        if frame.stamp_ns not in self._disparities:
            self._disparities[frame.stamp_ns] = self._room.disparity(frame)
        return self._disparities[frame.stamp_ns]

    def sightings(self, frame: Frame, expected: Mapping[str, FloatArray] | None = None) -> list[RobotSighting]:
        if frame.stamp_ns not in self._sightings:
            self._sightings[frame.stamp_ns] = self._room.sightings(frame)
        return self._sightings[frame.stamp_ns]


def pipeline_of(seen: Remembered, senses: Senses) -> MapPipeline:
    return MapPipeline(depth=seen, disparity_hw=HW, tags=seen, senses={"rover": senses}, shape=SHAPE)


def drive(folder: Path, *, ticks: int = TICKS) -> Remembered:
    """Drive the room's robot, in two records: the second begins under way."""
    settings = load_settings(overrides={"recording": {"folder": folder, "least_free_gb": 0.0}})
    room, heard, now_ns = Room(), HeardLog(), BASE_NS
    seen = Remembered(room)
    image = np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8)
    jpeg = encode_jpeg(image)
    with open_router(["tcp/127.0.0.1:0"]) as router:
        senses = RobotSenses(router, "rover", now_ns=lambda: now_ns)
        pipeline = pipeline_of(seen, heard.along("rover", senses))
        about = describe(settings, default_bundle_path())
        recorder = Recorder(settings.recording, router, camera="camera", robots=("rover",), about=about, heard=heard)
        recorder.watch(lambda: VIEW)
        recorder.start()
        for tick in range(ticks):
            if tick == SECOND_FROM:
                recorder.stop()
                recorder.start()
            now_ns = BASE_NS + tick * TICK_NS
            router.put(keys.odom("rover"), encode_odometry(room.odometry(now_ns)))
            ranges = np.full(90, 2.0 + 0.1 * (tick % 3), np.float32)
            router.put(keys.scan("rover"), encode_scan(Scan(now_ns, -1.5, 1.0 / 30.0, 0.1, 8.0, ranges)))
            frame = Frame(image, now_ns, tick, jpeg)
            result = pipeline.step(frame, GOALS)
            recorder.observe(ObservedTick(frame, GOALS, result, frozenset()))
            for plan in result.plans:
                room.drive(plan.waypoints_m)
        recorder.close()
        pipeline.close()
        senses.close()
    return seen


def again(files: list[Path], seen: Remembered) -> tuple[Comparison, RecordReader]:
    reader, senses = RecordReader(files), RecordedSenses()
    pipeline = pipeline_of(seen, senses)
    comparison = replay(reader.ticks(), pipeline, {"rover": senses}, progress=lambda: None)
    pipeline.close()
    return comparison, reader


def test_a_drive_over_the_map_replays_exactly(tmp_path: Path) -> None:
    seen = drive(tmp_path)
    files = records(tmp_path)
    comparison, reader = again(files, seen)
    assert (comparison.ticks, reader.broken, comparison.missing) == (TICKS, 0, 0)
    [row] = comparison.rows()
    assert row["plans_recorded"] >= TICKS // 2
    assert (row["agreement"], row["same_reason"], row["max_m"]) == (1.0, 1.0, 0.0)
    assert comparison.within(0.0)

    # The second alone lacks what was learnt before, but says what was known of the camera.
    first, second = (next(RecordReader([path]).ticks()).document for path in files)
    assert first.belief is not None
    assert known_before(first) is None
    assert known_before(second) is second.belief is not None
    late, _ = again(files[1:], seen)
    assert late.ticks == TICKS - SECOND_FROM
    assert not late.within(0.0)


def test_viewers_find_a_place_for_every_message_of_the_drive(tmp_path: Path) -> None:
    drive(tmp_path, ticks=12)
    messages = read(records(tmp_path)[0])
    places = [
        stamp_ns(each.header)
        for message in messages["/tf"]
        for each in message.transforms
        if (each.header.frame_id, each.child_frame_id) == ("floor", "rover/base_link")
    ]
    still = {each.child_frame_id: each for message in messages["/tf_static"] for each in message.transforms}
    assert still["base_link"].header.frame_id == "rover/base_link"
    assert still["odom"].header.frame_id == "rover/odom"
    known = [scan for scan in messages["/rover/scan"] if stamp_ns(scan.header) >= places[0]]
    assert len(known) >= 10
    assert {scan.header.frame_id for scan in known} == {"base_link"}


def stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)
