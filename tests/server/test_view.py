from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from revnm_client.geometry import Pose2
from revnm_client.messages import Scan
from revnm_server.floor_camera import FloorCamera
from revnm_server.views.view import FloorCameraView, scan_view


def scan(ranges: np.ndarray) -> Scan:
    count = len(ranges)
    return Scan(5_000_000_000, -np.pi, 2 * np.pi / max(count, 1), 0.1, 10.0, ranges.astype(np.float32))


def test_a_scan_is_thinned_out_and_a_thin_leg_stays() -> None:
    ranges = np.full(720, 4.0)
    ranges[361] = 0.5  # one beam of a group of four: half a degree left of ahead
    shown = scan_view(scan(ranges), now_ns=5_250_000_000)
    assert shown.age_s == 0.25
    assert len(shown.points_m) == 180
    assert min(np.hypot(*point) for point in shown.points_m) == 0.5
    assert (0.5, 0.0) in shown.points_m


def test_what_a_beam_did_not_hit_is_not_shown() -> None:
    ranges = np.full(360, np.inf)
    ranges[:4] = 2.0
    ranges[4:8] = 0.05  # below the sensor's shortest
    ranges[8:12] = np.nan
    shown = scan_view(scan(ranges), now_ns=0)
    assert len(shown.points_m) == 2
    assert scan_view(scan(np.full(7, np.inf)), now_ns=0).points_m == []
    assert scan_view(scan(np.empty(0)), now_ns=0).points_m == []


def test_odd_numbers_of_beams_are_thinned_out_too() -> None:
    shown = scan_view(scan(np.full(1081, 3.0)), now_ns=0)
    assert 150 <= len(shown.points_m) <= 180
    assert np.allclose(np.hypot(*np.transpose(shown.points_m)), 3.0, atol=0.01)


def test_a_cameras_view_names_its_numbers() -> None:
    view = FloorCameraView.of(FloorCamera((640, 480), 400.0, 0.5, 0.01, 2.5, -0.1))
    assert (view.focal_px, view.pitch_rad, view.roll_rad, view.height_m, view.distortion) == (
        400.0,
        0.5,
        0.01,
        2.5,
        -0.1,
    )


def test_a_scan_is_shown_where_the_lidar_sits():
    ranges = np.full(4, np.inf)
    ranges[0] = 1.0
    ahead = scan(ranges)
    turned = replace(ahead, angle_min_rad=0.0, robot_from_lidar=Pose2(0.1, 0.2, math.pi))
    assert scan_view(turned, now_ns=0).points_m == [(-0.9, 0.2)]
