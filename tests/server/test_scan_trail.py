from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from revnm_client.geometry import Pose2
from revnm_client.messages import Scan
from revnm_server.calibration.keyframes import Travel
from revnm_server.mapping.scan_trail import PastScan, ScanTrail


class Drive:
    """A robot that scans at every pose it is put to."""

    def __init__(self, number: int = 0) -> None:
        self.trail, self.number = ScanTrail(), number
        self._travel = Travel(Pose2(0.0, 0.0, 0.0))
        self._scans = 0

    def to(self, x: float, y: float, yaw: float = 0.0) -> None:
        self._travel = self._travel.on(Pose2(x, y, yaw))
        scan = Scan(self._scans, 0.0, 0.1, 0.1, 10.0, np.ones(3, np.float32))
        self._scans += 1
        self.trail.push(PastScan(scan, self._travel, self.number))

    def along(self, *corners: tuple[float, float], step: float = 0.05) -> None:
        for (x0, y0), (x1, y1) in pairwise(corners):
            count = round(math.dist((x0, y0), (x1, y1)) / step)
            for share in np.arange(1, count + 1) / count:
                self.to(x0 + share * (x1 - x0), y0 + share * (y1 - y0))


def test_a_robot_that_stands_writes_one_scan_that_stands_for_all():
    drive = Drive()
    for _ in range(200):
        drive.to(1.0, 0.0)
    kept = drive.trail.all()
    assert len(kept) == 1
    assert kept[0].times == 200


def test_a_place_far_back_is_remembered_and_no_scan_is_lost_from_the_count():
    drive = Drive()
    drive.to(0.0, 0.0)
    drive.along((0.0, 0.0), (12.0, 0.0))
    kept = drive.trail.all()
    x = np.array([past.travel.odom_from_robot.x_m for past in kept])
    assert x[0] < 0.5
    assert np.diff(x).max() < 0.85  # a cell's side and a scan's distance, twice
    assert len(kept) < 60
    assert sum(past.times for past in kept) == 241
    stamps = [past.scan.stamp_ns for past in kept]
    assert stamps == sorted(stamps)


def test_of_a_place_the_newest_scan_is_kept_for_each_heading():
    drive = Drive()
    for yaw in np.linspace(0.0, math.tau, 40):
        drive.to(0.0, 0.0, math.remainder(yaw, math.tau))
    drive.along((0.0, 0.0), (6.0, 0.0))
    at_begin = [past for past in drive.trail.all() if past.travel.odom_from_robot.x_m < 0.2]
    headings = np.sort([past.travel.odom_from_robot.yaw_rad for past in at_begin])
    assert len(headings) >= 5
    assert np.diff(headings).max() < 1.7


def test_the_oldest_places_are_forgotten_on_an_endless_drive():
    drive = Drive()
    drive.along((0.0, 0.0), (80.0, 0.0), step=0.2)
    kept = drive.trail.all()
    assert len(kept) == 120
    assert kept[0].travel.odom_from_robot.x_m > 20.0
