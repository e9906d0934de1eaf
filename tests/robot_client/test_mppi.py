"""The controller and its parts: rollouts, reference path, sampling, smoothing, determinism."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.errors import ConfigError
from revnm_client.messages import STANDSTILL, Velocity
from revnm_client.mppi import Footprint, Mppi, MppiConfig, MppiInput
from revnm_client.mppi.distance_field import DistanceField
from revnm_client.mppi.reference_path import path_ahead
from revnm_client.mppi.rollout import clearance, clearance_now, roll_out
from revnm_client.mppi.sampling import Sampler
from revnm_client.mppi.smoothing import savitzky_golay

CONFIG = MppiConfig(samples=200)
AHEAD = np.array([[0.4, 0.0], [0.8, 0.0], [1.2, 0.0], [1.6, 0.0], [2.0, 0.0]])
NOTHING = np.empty((0, 2))


def constant(value: float) -> np.ndarray:
    return np.full((1, CONFIG.steps), value, dtype=np.float32)


@pytest.mark.parametrize(
    ("footprint", "count"),
    [
        (Footprint(), 2),
        (Footprint(0.387, 0.24), 2),
        (Footprint(0.138, 0.178, center_x_m=-0.032), 1),
        (Footprint(0.281, 0.306, center_x_m=-0.064), 2),
        (Footprint(1.0, 0.5, center_x_m=0.3), 4),
    ],
)
def test_circles_cover_the_footprint_and_overhang_its_sides_little(footprint: Footprint, count: int) -> None:
    edge = np.linspace(-0.5, 0.5, 101)
    x, y = np.meshgrid(footprint.center_x_m + footprint.length_m * edge, footprint.width_m * edge)
    circles, radius = footprint.circles_x_m, footprint.circle_radius_m
    assert len(circles) == count
    assert (np.min([np.hypot(x - middle, y) for middle in circles], axis=0) <= radius).all()
    assert radius - footprint.width_m / 2.0 <= 0.05
    assert np.hypot(x, y).max() == pytest.approx(footprint.circumscribed_m)
    assert (x.min(), x.max()) == pytest.approx((footprint.rear_x_m, footprint.front_x_m))


def test_the_default_robot_has_two_circles_of_21_cm() -> None:
    assert Footprint().circle_radius_m == 0.21
    assert Footprint().circles_x_m == pytest.approx((-0.1075, 0.1075))


@pytest.mark.parametrize("bad", [(0.0, 0.3), (0.4, -0.3), (0.4, math.nan), (9.0, 0.3), (0.4, 0.3, 0.25)])
def test_senseless_footprints_are_refused(bad: tuple[float, ...]) -> None:
    with pytest.raises(ConfigError, match="footprint"):
        Footprint(*bad)


def test_a_field_too_small_for_the_footprint_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"reaches 0\.68 m: expected at least 0\.8"):
        MppiConfig(footprint=Footprint(1.4, 0.8))


@pytest.mark.parametrize("bad", [{"samples": 3}, {"steps": 5}, {"knots": 1}, {"period_s": 0.2}, {"period_s": 0.0}])
def test_senseless_sizes_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ConfigError):
        MppiConfig(**bad)  # type: ignore[arg-type]


def test_rollout_accelerates_within_the_limits() -> None:
    drive = roll_out(constant(0.5), constant(0.0), STANDSTILL, CONFIG)
    # 1 m/s^2 in steps of 0.1 s: 0.1, 0.2, ... 0.5, then steady.
    np.testing.assert_allclose(drive.v_mps[0, :6], [0.1, 0.2, 0.3, 0.4, 0.5, 0.5], rtol=1e-6)
    np.testing.assert_allclose(drive.x_m[0, -1], 0.1 * (0.1 + 0.2 + 0.3 + 0.4) + 26 * 0.05, rtol=1e-5)
    np.testing.assert_allclose(drive.y_m, 0.0)


def test_rollout_drives_circles() -> None:
    drive = roll_out(constant(0.4), constant(0.5), Velocity(0.4, 0.5), CONFIG)
    # Radius v / w = 0.8 m about (0, 0.8).
    np.testing.assert_allclose(np.hypot(drive.x_m, drive.y_m - 0.8), 0.8, atol=2e-3)
    np.testing.assert_allclose(drive.x_m[0, -1], 0.8 * math.sin(1.5), atol=2e-3)


def test_rollout_never_drives_backwards_or_too_fast() -> None:
    rng = np.random.default_rng(0)
    v, w = rng.normal(0.0, 2.0, (2, 50, CONFIG.steps)).astype(np.float32)
    drive = roll_out(v, w, STANDSTILL, CONFIG)
    assert drive.v_mps.min() >= 0.0
    assert drive.v_mps.max() <= np.float32(0.5)
    assert np.abs(drive.w_radps).max() <= np.float32(0.7)
    assert np.abs(np.diff(drive.w_radps, axis=1)).max() <= 0.2 + 1e-6


def test_clearance_is_that_of_the_nearer_circle() -> None:
    field = DistanceField.from_points(np.array([[0.6, 0.0]]), half_m=2.4, resolution_m=0.02, reach_m=0.7)
    stand = roll_out(constant(0.0), constant(0.0), STANDSTILL, CONFIG)
    # Front circle at 0.1075: 0.6 - 0.1075 - 0.21 = 0.2825.
    np.testing.assert_allclose(clearance(stand, field, CONFIG.footprint), 0.2825, atol=0.03)
    # With the middle 0.1 m ahead, so much less.
    np.testing.assert_allclose(clearance(stand, field, Footprint(center_x_m=0.1)), 0.1825, atol=0.03)
    np.testing.assert_allclose(clearance_now(field, Footprint(center_x_m=0.1)), 0.1825, atol=0.03)


def test_path_ahead_forgets_what_is_passed() -> None:
    path = path_ahead(np.array([[-1.0, 0.3], [1.0, 0.3], [1.0, 1.3]]))
    np.testing.assert_allclose(path.points_m[0], [0.0, 0.3], atol=1e-9)
    np.testing.assert_allclose(path.points_m[-1], [1.0, 1.3])
    np.testing.assert_allclose(path.at(1.5), [1.0, 0.8], atol=1e-9)
    steps = np.hypot(*np.diff(path.points_m, axis=0).T)
    assert steps.max() <= 0.1 + 1e-9


def test_path_ahead_takes_repeated_and_single_waypoints() -> None:
    goal = np.array([0.3, 0.1])
    assert path_ahead(np.tile(goal, (5, 1))).points_m.tolist() == [[0.3, 0.1]]
    repeated = path_ahead(np.array([[0.0, 0.0], *[goal] * 4]))
    np.testing.assert_allclose(repeated.points_m[-1], goal)
    passed = path_ahead(np.array([[-2.0, 0.0], [-1.0, 0.0]]))
    np.testing.assert_allclose(passed.points_m, [[-1.0, 0.0]])


def test_samples_hold_the_last_solution_and_turns_on_the_spot() -> None:
    nominal = np.stack([np.full(30, 0.3), np.full(30, -0.2)]).astype(np.float32)
    v, w = Sampler(CONFIG, 0).draw(nominal)
    assert v.shape == w.shape == (200, 30)
    np.testing.assert_allclose(v[0], 0.3)
    np.testing.assert_allclose(w[0], -0.2)
    spot = (v == 0.0).all(axis=1)
    assert {round(float(rate), 3) for rate in w[spot, 0]} >= {-0.7, 0.0, 0.7}
    assert np.std(w[1:150]) == pytest.approx(CONFIG.sigma_w_radps, rel=0.3)


def test_smoothing_keeps_parabolas_and_calms_noise() -> None:
    t = np.arange(30.0)
    parabola = 0.3 + 0.02 * t - 0.001 * t**2
    matrix = savitzky_golay(30)
    np.testing.assert_allclose(matrix @ parabola, parabola, atol=1e-5)
    noise = np.random.default_rng(1).normal(size=(30, 200))
    assert np.std(matrix @ noise) < 0.7 * np.std(noise)


def test_same_seed_same_velocities() -> None:
    points = np.array([[1.0, 0.1], [1.2, -0.3]])
    twins = Mppi(CONFIG, seed=4), Mppi(CONFIG, seed=4)
    for _ in range(5):
        a, b = (twin.plan(MppiInput(AHEAD, points, Velocity(0.2, 0.0))) for twin in twins)
        assert a == b


def test_starts_straight_along_a_free_path() -> None:
    velocity = Mppi(CONFIG).plan(MppiInput(AHEAD, NOTHING, STANDSTILL))
    assert velocity.v_mps > 0.07
    assert abs(velocity.w_radps) < 0.1


@pytest.mark.parametrize(("y", "sign"), [(1.0, 1.0), (-1.0, -1.0)])
def test_turns_on_the_spot_towards_a_path_that_leads_sideways(y: float, sign: float) -> None:
    waypoints = np.array([[0.0, 0.0], [0.0, 0.5 * y], [0.0, y]])
    velocity = Mppi(CONFIG).plan(MppiInput(waypoints, NOTHING, STANDSTILL))
    assert velocity == Velocity(0.0, pytest.approx(0.2 * sign))  # 2 rad/s^2 for 0.1 s


def test_keeps_turning_the_same_way_when_the_path_lies_straight_behind() -> None:
    mppi = Mppi(CONFIG)
    for y in (0.01, -0.01, 0.01):
        path = np.array([[0.0, 0.0], [-1.0, y]])
        assert mppi.plan(MppiInput(path, NOTHING, STANDSTILL)).w_radps > 0.0


def test_turns_back_the_short_way_when_the_path_leads_elsewhere() -> None:
    mppi, left, right = Mppi(CONFIG), np.array([[0.0, 0.0], [-0.5, 1.0]]), np.array([[0.0, 0.0], [0.5, -1.0]])
    assert mppi.plan(MppiInput(left, NOTHING, STANDSTILL)).w_radps > 0.0
    assert mppi.plan(MppiInput(right, NOTHING, STANDSTILL)).w_radps < 0.0


def test_does_not_turn_first_towards_a_blocked_place() -> None:
    waypoints = np.array([[0.0, 0.0], [0.0, 0.5], [0.0, 1.0]])
    wall = np.stack([np.linspace(-1.5, 1.5, 200), np.full(200, 0.4)], axis=1)
    mppi = Mppi(CONFIG)
    moved = [mppi.plan(MppiInput(waypoints, wall, STANDSTILL)).v_mps for _ in range(3)]
    assert all(v >= 0.0 for v in moved)
    assert mppi.plan(MppiInput(waypoints, wall, STANDSTILL)).w_radps != pytest.approx(0.2)


@pytest.mark.parametrize("now", [Velocity(5.0, 0.0), Velocity(-3.0, 0.0), Velocity(0.3, 6.0), Velocity(0.0, -5.0)])
@pytest.mark.parametrize("waypoints", [AHEAD, np.array([[0.0, 0.0], [0.0, 1.0]])])
def test_whatever_odometry_claims_the_command_is_within_the_limits(now: Velocity, waypoints: np.ndarray) -> None:
    velocity = Mppi(CONFIG).plan(MppiInput(waypoints, NOTHING, now))
    assert 0.0 <= velocity.v_mps <= CONFIG.max_v_mps
    assert abs(velocity.w_radps) <= CONFIG.max_w_radps


def test_full_speed_towards_a_wall_is_never_wanted() -> None:
    wall = np.stack([np.full(200, 0.45), np.linspace(-1.5, 1.5, 200)], axis=1)
    mppi = Mppi(CONFIG)
    for _ in range(5):
        velocity = mppi.plan(MppiInput(AHEAD, wall, STANDSTILL))
    assert velocity.v_mps < 0.06


def test_turns_a_body_that_lies_behind_its_frame_away_from_a_wall() -> None:
    # The short way is to the left; the rear, 0.45 m from the frame, would sweep over the wall on the right.
    wall = np.column_stack([np.linspace(-1.5, 1.5, 150), np.full(150, -0.36)])
    behind = np.column_stack([-0.4 * np.arange(1, 6), np.full(5, 0.15)])
    turns = {}
    for middle in (0.0, -0.2):
        config = MppiConfig(samples=200, footprint=Footprint(center_x_m=middle))
        turns[middle] = Mppi(config).plan(MppiInput(behind, wall, STANDSTILL)).w_radps
    assert turns == {0.0: pytest.approx(0.2), -0.2: pytest.approx(-0.2)}


def test_turns_beside_a_wall_that_its_corners_just_clear() -> None:
    # The corners reach 0.28 m, the wall is 0.32 m away; the covering circles would reach 0.3175 m.
    wall = np.column_stack([np.linspace(-1.5, 1.5, 150), np.full(150, -0.32)])
    behind = np.column_stack([-0.4 * np.arange(1, 6), np.full(5, 0.15)])
    mppi, velocity = Mppi(MppiConfig(), seed=0), STANDSTILL
    for _ in range(20):
        velocity = mppi.plan(MppiInput(behind, wall, velocity))
    assert abs(velocity.w_radps) == pytest.approx(0.7)
    assert velocity.v_mps == 0.0
