"""Speed by what the LiDAR can see."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from revnm_client.braking import BrakingConfig
from revnm_client.geometry import Pose2
from revnm_client.messages import Scan
from revnm_client.mppi import Footprint
from revnm_client.sight import seen_ahead_m, speed_limit_mps, speed_to_stop_within_mps

BRAKING = BrakingConfig(delay_s=0.15, braking_mps2=1.0, margin_m=0.03)
ANGLES = np.arange(720) * (math.tau / 720) - math.pi


def scan(ranges: object, *, range_max_m: float = 12.0) -> Scan:
    return Scan(0, -math.pi, math.tau / 720, 0.1, range_max_m, np.broadcast_to(ranges, 720).astype(np.float32))


def masked(low_rad: float, high_rad: float, value: float = 0.0) -> Scan:
    return scan(np.where((low_rad <= ANGLES) & (high_rad >= ANGLES), value, 5.0))


def test_speed_by_hand() -> None:
    # 0.5 * 0.15 + 0.5^2 / 2 + 0.03 = 0.23.
    assert speed_to_stop_within_mps(0.23, BRAKING) == pytest.approx(0.5)
    assert speed_to_stop_within_mps(0.03, BRAKING) == 0.0
    assert speed_to_stop_within_mps(0.0, BRAKING) == 0.0


@pytest.mark.parametrize("ranges", [12.0, math.inf, 5.0, 0.3])
def test_nothing_limits_a_lidar_of_twelve_metres(ranges: float) -> None:
    assert seen_ahead_m(scan(ranges), Footprint(), 0.2) == pytest.approx(12.0 - 0.215)
    assert speed_limit_mps(scan(ranges), 0.5, BRAKING) == 0.5


def test_a_lidar_of_short_range_slows_it_down() -> None:
    # It sees to 0.4 m, so 0.185 m ahead of the front: v * 0.15 + v^2 / 2 = 0.155 at v = 0.4266.
    assert speed_limit_mps(scan(math.inf, range_max_m=0.4), 0.5, BRAKING) == pytest.approx(0.4266, abs=1e-4)
    assert speed_limit_mps(scan(math.inf, range_max_m=0.2), 0.5, BRAKING) == 0.0


@pytest.mark.parametrize("value", [0.0, math.nan, 0.05, -math.inf])
def test_a_blind_sector_ahead_stops_it(value: float) -> None:
    assert speed_limit_mps(masked(-0.1, 0.1, value), 0.5, BRAKING) == 0.0
    assert speed_limit_mps(masked(0.2, 0.5, value), 0.5, BRAKING) == 0.0


def test_blind_sectors_beside_and_dropped_beams_do_not() -> None:
    # The lane is looked at 0.415 m ahead: 0.18 m to the side are 0.409 rad.
    assert speed_limit_mps(masked(0.42, 2.0), 0.5, BRAKING) == 0.5
    assert speed_limit_mps(masked(0.1, 0.17), 0.5, BRAKING) == 0.5
    dropped = np.full(720, 5.0)
    dropped[::3] = math.nan
    assert speed_limit_mps(scan(dropped), 0.5, BRAKING) == 0.5


def test_outside_of_the_field_of_view_it_is_blind() -> None:
    ahead = Scan(0, -0.5, 0.01, 0.1, 12.0, np.full(101, 5.0, dtype=np.float32))
    aside = Scan(0, 0.2, 0.01, 0.1, 12.0, np.full(101, 5.0, dtype=np.float32))
    assert speed_limit_mps(ahead, 0.5, BRAKING) == 0.5
    assert speed_limit_mps(aside, 0.5, BRAKING) == 0.0


def test_the_front_is_where_the_footprint_has_it() -> None:
    assert seen_ahead_m(scan(math.inf, range_max_m=1.0), Footprint(center_x_m=0.1), 0.2) == pytest.approx(0.685)


def test_a_lidar_that_looks_backwards_sees_ahead_behind_it() -> None:
    turned = {"robot_from_lidar": Pose2(-0.1, 0.0, math.pi)}
    behind = np.abs(ANGLES) > math.pi - 0.3
    assert speed_limit_mps(replace(scan(np.where(behind, 0.0, 5.0)), **turned), 0.5, BRAKING) == 0.0
    assert speed_limit_mps(replace(masked(-0.3, 0.3), **turned), 0.5, BRAKING) == 0.5
    short = replace(scan(math.inf, range_max_m=1.0), **turned)
    assert seen_ahead_m(short, Footprint(), 0.2) == pytest.approx(0.685)
