"""Image-space servoing: ways in the picture and their metres, by hand."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import Velocity
from revnm_server.mapping.tag_plane import TagPlane
from revnm_sim.bench.image_plan import ImageGrid, ImageRoute, find_path, look_ahead, see_floor
from revnm_sim.bench.methods import METHODS, MethodContext, RobotFeed
from revnm_sim.bench.methods.ibvs import by_image_angles, free_by_pixels, goal_pixel, heading_scale
from revnm_sim.bench.row_scale import RowScale, free_by_metres
from revnm_sim.bench.trial import Trial, TrialKey, TrialResult
from revnm_sim.camera import Camera
from revnm_sim.expert.planner import Expert
from revnm_sim.expert.route import plan_route
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.scenario import Scenario, tag_seen
from revnm_sim.simulation import Simulation
from revnm_sim.site import Pair
from revnm_sim.world import Bounds, Primitive, Shape, World, primitive_arrays

GREY = (150, 150, 150)
BOUNDS = Bounds(-4.0, -3.0, 4.0, 3.0)
ABOVE = Camera(640, 480, math.radians(90.0), (0.0, 0.0, 4.0), 0.0, math.pi / 2.0)
OBLIQUE = Camera(640, 480, math.radians(120.0), (-3.9, 0.0, 3.0), 0.0, math.radians(35.0))


def box(x: float, y: float, size_m: tuple[float, float, float]) -> Primitive:
    return Primitive(shape=Shape.BOX, centre_m=(x, y, size_m[2] / 2.0), size_m=size_m, yaw_rad=0.0, colour=GREY)


WALL_WITH_GAP = (box(0.0, -1.4, (0.2, 3.2, 0.5)), box(0.0, 2.4, (0.2, 1.2, 0.5)))  # open from y = 0.2 to 1.8
WALL = (box(0.0, 0.0, (0.2, 9.0, 0.5)),)  # from edge to edge of the picture


def scenario(*primitives: Primitive, camera: Camera = ABOVE, yaw_rad: float = 0.0) -> Scenario:
    """A room of 8 × 6 m, from (−1.5, −1) to (1.5, −1)."""
    world = World("room", BOUNDS, GREY, primitives)
    return Scenario(world, camera, Pose2(-1.5, -1.0, yaw_rad), (1.5, -1.0), seed=7)


def trial(place: Scenario, method: str) -> TrialResult:
    result = Trial(
        place,
        plan_route(place.world, Pair(place.start, place.goal_m)),
        TrialKey("room", method, "truth", 1, 0, 0, 0, 1, "any", "", "", ""),
    ).run()
    return replace(result, tick_p50_ms=0.0, robot_tick_p50_ms=0.0)


def first_waypoints(place: Scenario, method: str) -> np.ndarray:
    with Simulation(place, place.seed) as simulation:
        field = Expert(scenario().world).field(place.goal_m)
        waypoints = METHODS[method](MethodContext(place, simulation, field, "truth", "", RobotFeed())).waypoints()
    assert waypoints is not None
    return waypoints


def way(place: Scenario, *, margin: float) -> np.ndarray | None:
    grid = ImageGrid(place.camera)
    free = free_by_pixels(see_floor(place.world, place.camera, grid), margin)
    start_px, _ = place.camera.project(np.array([place.start.x_m, place.start.y_m, 0.0]))
    return find_path(free, grid, start_px, goal_pixel(place.camera, place.goal_m), reach_px=20.0)


# The picture.


def test_floor_is_what_the_camera_sees_of_it_rugs_included() -> None:
    rug, crate = box(1.0, 1.0, (0.5, 0.5, 0.01)), box(1.0, -1.0, (0.5, 0.5, 0.5))
    grid = ImageGrid(ABOVE)
    floor = see_floor(scenario(rug, crate).world, ABOVE, grid)
    pixels, _ = ABOVE.project(np.array([[1.0, 1.0, 0.01], [1.0, -1.0, 0.5], [-1.0, 0.0, 0.0]]))
    assert [floor[tuple(cell)] for cell in np.round(grid.cells(pixels)).astype(int)] == [True, False, True]


def test_cells_and_pixels_are_inverse() -> None:
    grid = ImageGrid(ABOVE)
    assert grid.shape == (240, 320)
    np.testing.assert_allclose(grid.cells(np.array([0.5, 2.5])), [1.0, 0.0])  # between pixels 0 and 1, and 2 and 3
    np.testing.assert_allclose(grid.pixels(grid.cells(np.array([123.0, 45.0]))), [123.0, 45.0])


def test_the_way_leads_through_the_gap() -> None:
    place = scenario(*WALL_WITH_GAP)
    path = way(place, margin=2.0)
    assert path is not None
    places = np.array([place.camera.floor_point(pixel) for pixel in path])
    at_wall = places[np.abs(places[:, 0]) < 0.1]
    assert len(at_wall)
    assert at_wall[:, 1].min() > 0.2
    assert at_wall[:, 1].max() < 1.0  # it takes the near side
    np.testing.assert_allclose(places[-1], place.goal_m, atol=1e-6)


def test_a_margin_wider_than_the_gap_closes_it() -> None:
    # 160 px for 2 m at 4 m under 90°: the gap of 1.6 m is 64 cells wide, less where the wall's top leans over it.
    assert way(scenario(*WALL_WITH_GAP), margin=20.0) is not None
    assert way(scenario(*WALL_WITH_GAP), margin=33.0) is None


def test_a_start_beside_the_free_floor_is_moved_as_far_as_told() -> None:
    grid = ImageGrid(ABOVE)
    free = np.zeros(grid.shape, dtype=bool)
    free[100:140, 100:200] = True
    start, goal = grid.pixels(np.array([[120.0, 90.0], [120.0, 150.0]]))
    path = find_path(free, grid, start, goal, reach_px=20.0)
    assert path is not None
    np.testing.assert_allclose(path[0], grid.pixels(np.array([120.0, 100.0])))
    assert find_path(free, grid, start, goal, reach_px=19.0) is None


def test_pure_pursuit_begins_at_the_nearest_point_and_ends_at_the_goal() -> None:
    path = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 9.0]])
    points = look_ahead(path, np.array([6.0, -3.0]), spacing=4.0, count=5)  # from (6, 0)
    np.testing.assert_allclose(points, [[10, 0], [10, 4], [10, 8], [10, 9], [10, 9]])


def test_a_plan_stays_for_a_second() -> None:
    grid = ImageGrid(ABOVE)
    route = ImageRoute(grid, np.array([600.0, 240.0]))
    everywhere, nowhere = np.ones(grid.shape, dtype=bool), np.zeros(grid.shape, dtype=bool)
    start = np.array([20.0, 240.0])
    first = route.path(0, start, lambda: everywhere, reach_px=10.0)
    assert route.path(999_999_999, start + 50.0, lambda: nowhere, reach_px=10.0) is first
    direct = route.path(1_000_000_000, start, lambda: nowhere, reach_px=10.0)
    np.testing.assert_array_equal(direct, [start, [600.0, 240.0]])


# By image angles.


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, math.pi, -2.0])
def test_from_straight_above_image_angles_are_exact(yaw_rad: float) -> None:
    robot, pose = RobotSpec(), Pose2(0.5, -0.7, yaw_rad)
    sighting = see_robot(ABOVE, pose, robot, robot="rover", stamp_ns=0)
    scale = heading_scale(sighting, robot.tag_m)
    assert scale == pytest.approx(320.0 / (4.0 - robot.top_m))
    points = np.array([[1.0, 0.0], [0.0, 1.0], [-0.5, -0.5]])
    pixels, _ = ABOVE.project(np.column_stack([pose.apply(points), np.full(3, robot.top_m)]))
    np.testing.assert_allclose(by_image_angles(sighting, pixels, px_per_m=scale), points, atol=1e-4)


def test_under_an_oblique_camera_image_angles_are_wrong() -> None:
    robot, pose = RobotSpec(), Pose2(0.0, 0.0, math.pi / 2.0)  # across the view
    sighting = see_robot(OBLIQUE, pose, robot, robot="rover", stamp_ns=0)
    pixel, _ = OBLIQUE.project(np.array([[1.0, 1.0, robot.top_m]]))
    point = by_image_angles(sighting, pixel, px_per_m=heading_scale(sighting, robot.tag_m))[0]
    assert abs(math.atan2(point[1], point[0]) + math.pi / 4.0) > math.radians(10.0)


# By the tag's scale.


def scale_from(camera: Camera, *places: tuple[float, float]) -> RowScale:
    robot, scale = RobotSpec(), RowScale(tag_height_m=RobotSpec().top_m)
    for x, y in places:
        sighting = see_robot(camera, Pose2(x, y, 0.7), robot, robot="rover", stamp_ns=0)
        scale.add(TagPlane(sighting, tag_size_m=robot.tag_m))
    return scale


def test_the_scale_of_every_row_is_learnt_from_two() -> None:
    scale = scale_from(OBLIQUE, (-1.5, 0.5), (1.5, -0.5))
    for x in (-1.0, 0.0, 3.0):
        place = np.array([[x, 0.0, 0.0], [x, 0.1, 0.0], [x, -0.1, 0.0], [x + 0.1, 0.0, 0.0], [x - 0.1, 0.0, 0.0]])
        pixels, _ = OBLIQUE.project(place)
        across, away = (np.linalg.norm(pixels[i] - pixels[i + 1]) / 0.2 for i in (1, 3))
        assert scale.across(pixels[0, 1]) == pytest.approx(across, rel=0.08)  # the tag is nearer than its floor
        assert scale.away(pixels[0, 1]) == pytest.approx(away, rel=0.12)


def test_before_two_rows_the_scale_is_the_tag_s_everywhere() -> None:
    scale = scale_from(OBLIQUE, (0.0, 0.5), (0.0, -0.5))
    high, middle, low = scale.across(np.array([100.0, 200.0, 400.0]))
    assert high == middle == low > 0.0


def test_the_foot_is_the_floor_under_the_tag() -> None:
    scale = scale_from(OBLIQUE, (2.0, 0.0), (0.0, 0.0))
    tag, _ = OBLIQUE.project(np.array([0.0, 0.0, RobotSpec().top_m]))
    foot = OBLIQUE.floor_point(scale.foot(tag))
    assert foot is not None
    np.testing.assert_allclose(foot, [0.0, 0.0], atol=0.06)
    np.testing.assert_allclose(scale.lift(scale.foot(tag)[None])[0], tag, atol=0.5)


def test_the_margin_grows_with_the_row() -> None:
    # A bar from the top to the bottom of the picture: on each row as many free cells are lost as the radius is wide.
    scale, grid = scale_from(OBLIQUE, (-1.5, 0.5), (1.5, -0.5)), ImageGrid(OBLIQUE)
    floor = np.ones(grid.shape, dtype=bool)
    floor[:, 160] = False
    free = free_by_metres(floor, grid, scale, radius_m=0.25)
    lost = (~free).sum(axis=1)
    rows = np.array([80, 120, 200])
    np.testing.assert_allclose(lost[rows], 0.5 * scale.across(grid.rows_px()[rows]) / grid.cell_px, atol=1.01)
    assert lost[80] < lost[120] < lost[200]


def test_the_margin_of_a_spot_is_the_disc_s_picture() -> None:
    scale, grid = scale_from(OBLIQUE, (-1.5, 0.5), (1.5, -0.5)), ImageGrid(OBLIQUE)
    floor = np.ones(grid.shape, dtype=bool)
    floor[120, 160] = False
    free = free_by_metres(floor, grid, scale, radius_m=0.5)
    spot = OBLIQUE.floor_point(grid.pixels(np.array([120.0, 160.0])))
    assert spot is not None
    near, _ = OBLIQUE.project(np.array([[spot[0] + 0.4, 0.0, 0.0], [spot[0] - 0.4, 0.0, 0.0]]))
    far, _ = OBLIQUE.project(np.array([[spot[0] + 0.7, 0.0, 0.0], [spot[0] - 0.7, 0.0, 0.0]]))
    assert not any(free[tuple(cell)] for cell in np.round(grid.cells(near)).astype(int))
    assert all(free[tuple(cell)] for cell in np.round(grid.cells(far)).astype(int))


# Trials.


@pytest.mark.parametrize("method", ["ibvs", "ibvs_scale"])
def test_a_free_way_is_driven(method: str) -> None:
    result = trial(scenario(camera=OBLIQUE), method)
    assert result.success
    assert result == trial(scenario(camera=OBLIQUE), method)


@pytest.mark.parametrize("method", ["ibvs", "ibvs_scale"])
def test_waypoints_lead_to_the_gap_or_where_there_is_none_to_the_goal(method: str) -> None:
    through = first_waypoints(scenario(*WALL_WITH_GAP), method)
    assert through[-1, 1] > 0.8  # the gap begins at (1.5, 1.2) in the robot's frame
    direct = first_waypoints(scenario(*WALL), method)
    np.testing.assert_allclose(direct[:, 1], 0.0, atol=0.03)
    assert (np.diff(direct[:, 0]) > 0.3).all()


@pytest.mark.parametrize("method", ["ibvs", "ibvs_scale"])
def test_a_hidden_robot_keeps_its_last_sighting(method: str) -> None:
    # The robot turns as it drives, so that fresh waypoints change in its frame; then it passes behind a post.
    place = scenario(box(-2.6, -0.25, (0.1, 0.3, 2.5)), camera=OBLIQUE)
    tags = primitive_arrays(place.world.obstacles)
    with Simulation(place, place.seed) as simulation:
        field = Expert(place.world).field(place.goal_m)
        servo = METHODS[method](MethodContext(place, simulation, field, "truth", "", RobotFeed()))
        told = []
        for _ in range(13):
            waypoints, pose = servo.waypoints(), simulation.true_pose
            assert waypoints is not None
            seen = tag_seen(tags, OBLIQUE, np.array([[pose.x_m, pose.y_m]]), place.robot)[0]
            told.append((bool(seen), pose.yaw_rad, waypoints))
            simulation.command(Velocity(0.5, 0.4))
            simulation.advance(0.2)
    first = [seen for seen, _, _ in told].index(False)
    _, seen_yaw, last_seen = told[first - 1]
    hidden = list(itertools.takewhile(lambda entry: not entry[0], told[first:]))
    assert hidden[-1][1] - seen_yaw > 0.2  # 2 m ahead a fresh waypoint would have moved by 0.4 m
    for _, _, waypoints in hidden:
        np.testing.assert_allclose(waypoints, last_seen, atol=0.02)
