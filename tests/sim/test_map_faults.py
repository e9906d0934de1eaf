"""Faults while a robot drives by the map, in closed loop: no contact, the state tells, and it arrives after all."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.frame import RobotSighting
from revnm_server.observation import Image32
from revnm_sim.bench import trial
from revnm_sim.bench.methods import MethodContext
from revnm_sim.bench.methods.bev import BevMethod
from revnm_sim.bench.methods.pose import ROBOT, NoisySightings
from revnm_sim.bench.methods.truth import PixelGoal, TrueDisparity
from revnm_sim.bench.trial import TrialKey, run_trial

S = 1_000_000_000
BEGINS_S, ENDS_S = 6.0, 10.0
SETTING = TrialKey("random_pillar", "bev", "truth", 5000, 6, 0, 0, 2, "blocked", "", "", "")


@dataclass
class Faults:
    """What is changed on the way to the navigator, by the time; each may be None."""

    sightings: Callable[[float, list[RobotSighting]], list[RobotSighting]] | None = None
    odometry: Callable[[float, Pose2], Pose2] | None = None
    disparity: Callable[[float, Image32], Image32] | None = None
    scans: Callable[[float], bool] | None = None
    knock_rad: float = 0.0
    said: list[tuple[float, str]] = field(default_factory=list)


class FaultyBev(BevMethod):
    """The method with something broken; the operator clicks the goal again when the camera was knocked."""

    faults: ClassVar[Faults]

    def __init__(self, context: MethodContext) -> None:
        super().__init__(context)
        self._context = context
        self._navigator.step = self._listening(self._navigator.step)  # type: ignore[method-assign]

    def _listening(self, step: Callable) -> Callable:  # type: ignore[type-arg]
        def said(stamp_ns: int, disparity: Image32, sightings: list[RobotSighting], goals: dict) -> object:  # type: ignore[type-arg]
            now, faults = stamp_ns / S, self.faults
            if faults.sightings is not None:
                sightings = faults.sightings(now, sightings)
            if faults.disparity is not None:
                disparity = faults.disparity(now, disparity)
            tick = step(stamp_ns, disparity, sightings, goals)
            self.faults.said.append((now, f"{tick.routes[ROBOT].reason} | {tick.calibration.event}"))
            return tick

        return said

    def waypoints(self):  # type: ignore[no-untyped-def]
        now, faults = self._simulation.time_ns / S, self.faults
        if faults.knock_rad and now >= BEGINS_S:
            self._knock(faults.knock_rad)
            faults.knock_rad = 0.0
        if faults.odometry is not None:
            moved = [
                replace(each, odom_from_robot=faults.odometry(now, each.odom_from_robot))
                for each in self._feed.odometry
            ]
            self._feed.odometry[:] = moved
        if faults.scans is not None and not faults.scans(now):
            self._feed.scans.clear()
        return super().waypoints()

    def _knock(self, pitch_rad: float) -> None:
        scenario = self._context.scenario
        camera = replace(scenario.camera, pitch_rad=scenario.camera.pitch_rad + pitch_rad)
        knocked = replace(scenario, camera=camera)
        self._depth = TrueDisparity(knocked, self._simulation, (192, 256))
        self._sightings = NoisySightings(knocked, self._simulation)  # type: ignore[assignment]
        pixel, _ = camera.project(np.array([*scenario.goal_m, 0.0]))
        place = (float(pixel[0] + 0.5) / camera.width_px, float(pixel[1] + 0.5) / camera.height_px)
        self._goals = {ROBOT: PixelGoal("clicked again", place)}


def during(now: float) -> bool:
    return BEGINS_S <= now < ENDS_S


def strange_tag(now: float, sightings: list[RobotSighting]) -> list[RobotSighting]:
    """Another robot with the same tag stands where the camera sees it instead of ours."""
    if not during(now):
        return sightings
    elsewhere = np.array([500.0, 200.0])
    return [replace(each, pixel=elsewhere, corners=each.corners - each.pixel + elsewhere) for each in sightings]


def jump(now: float, pose: Pose2) -> Pose2:
    return Pose2(3.0, 1.0, 0.5) @ pose if now >= BEGINS_S else pose


RNG = np.random.default_rng(0)


def noise(now: float, disparity: Image32) -> Image32:
    return RNG.random(disparity.shape).astype(np.float32) if during(now) else disparity


FAULTS: dict[str, tuple[Faults, str | None]] = {
    "a knock of 5 degrees": (Faults(knock_rad=math.radians(5.0)), "jumped"),
    "another robot's tag": (Faults(sightings=strange_tag), "jumped"),
    "a jump of odometry": (Faults(odometry=jump), None),
    "no scans": (Faults(scans=lambda now: not during(now)), None),
    "pictures of noise": (Faults(disparity=noise), "the depth picture is noise"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_on_the_way_costs_no_contact_and_the_robot_arrives(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    faults, words = FAULTS[name]
    monkeypatch.setattr(trial, "METHODS", {"bev": FaultyBev})
    monkeypatch.setattr(FaultyBev, "faults", faults, raising=False)
    result = run_trial(SETTING)
    assert not result.collision
    assert result.success
    assert result.duration_s > ENDS_S + 5.0  # the fault came on the way
    before = [text for now, text in faults.said if now < BEGINS_S]
    after = [text for now, text in faults.said if now >= BEGINS_S]
    assert all(text.endswith("| None") for text in before)
    if words is not None:
        assert any(words in text for text in after)
    assert after[-1].startswith(" |")  # nothing is provisional any more
