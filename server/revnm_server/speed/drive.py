"""Drives a bundle's pipeline through the room and notes what each stage took, tick after tick."""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from revnm_server.assembly import build_map_pipeline, build_pipeline
from revnm_server.calibration.adjustment import Belief
from revnm_server.calibration.store import save_belief
from revnm_server.networks.bundle import Bundle
from revnm_server.settings import PerceptionSettings
from revnm_server.speed.room import CAMERA, Room
from revnm_server.speed.room_picture import RoomPainter
from revnm_server.tick.map_pipeline import MapPipeline
from revnm_server.tick.pipeline import Pipeline

_CAMERA = "bench"
# As a kept calibration is known: 1 % in focal length and height, a third of a degree in pitch and roll.
_KNOWN = np.diag(np.square([0.01, 0.006, 0.006, 0.01, 0.01]))
_WARM_UP_TICKS = {"map": 15, "picture": 2}  # ways and beliefs take a while
_LEAST_TICKS = 5
# Before a policy that sees the picture, robots turn on the spot: nothing that it does depends on where they drive, and
# one of random weights would drive them out of the picture.
_TURN = np.array([[0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class Course:
    """What is driven.

    Attributes:
        robots: How many.
        ticks: That count, at most.
        longest_s: After so long no more ticks begin, if there are five.
        tick_hz: Pictures a second; a tick that takes longer delays the next.
    """

    robots: int
    ticks: int
    longest_s: float
    tick_hz: float


def drive(bundle: Bundle, course: Course) -> list[dict[str, float]]:
    """Drive the pipeline that the server would build for a bundle.

    Returns:
        The duration of the stages of each tick, milliseconds, after warm-up.
    """
    tags = {f"r{number}": number for number in range(course.robots)}
    room, painter = Room(course.robots, period_s=1.0 / course.tick_hz), RoomPainter(tags)
    settings = PerceptionSettings(bundle=bundle.folder)
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(limits=1, user_api="blas"):
        if bundle.sees == "picture":
            return _ticks(build_pipeline(bundle, settings, tags), room, painter, course, bundle)
        save_belief(Path(folder) / f"{_CAMERA}.json", _CAMERA, CAMERA.size_px, Belief(CAMERA.vector, _KNOWN))
        kept = settings.model_copy(update={"calibration_dir": Path(folder)})
        senses = {robot.name: robot for robot in room.robots}
        pipeline = build_map_pipeline(bundle, kept, tags, senses, camera=_CAMERA)
        try:
            return _ticks(pipeline, room, painter, course, bundle)
        finally:
            pipeline.close()


def _ticks(
    pipeline: Pipeline | MapPipeline, room: Room, painter: RoomPainter, course: Course, bundle: Bundle
) -> list[dict[str, float]]:
    """Tick in real time, so that what runs beside and between the ticks does so here, too."""
    found: list[dict[str, float]] = []
    ends_s, warm_up = math.inf, _WARM_UP_TICKS[bundle.sees]
    for number in tqdm(range(warm_up + course.ticks), desc=f"{bundle.name}, {course.robots} robots", unit=" ticks"):
        due_s = time.monotonic() + 1.0 / course.tick_hz
        result = pipeline.step(painter.frame(room), room.goals)
        if number == warm_up:
            ends_s = due_s + course.longest_s
        if number >= warm_up:
            found.append(result.timings_ms)
        plans = {plan.robot: plan.waypoints_m for plan in result.plans}
        room.advance(plans if bundle.sees == "map" else dict.fromkeys(plans, _TURN))
        if len(found) >= _LEAST_TICKS and time.monotonic() > ends_s:
            break
        time.sleep(max(0.0, due_s - time.monotonic()))
    return found
