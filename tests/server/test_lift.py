"""A disparity becomes places: oracles are arithmetic by hand and the simulator's ray caster."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest

from revnm_client.errors import ContractError
from revnm_server.mapping.floor_fit import FloorLine, fit_floor
from revnm_server.mapping.floor_view import floor_view
from revnm_server.mapping.lift import FloorLifter, Kind, Lifted, NoFloor

from .floor_scene import HW, OURS, box, disparity, everywhere, view, wall


def lifted(picture, camera=OURS, covariance=None, usable=None) -> Lifted:
    result = FloorLifter(view(camera, covariance)).lift(picture, everywhere() if usable is None else usable)
    assert isinstance(result, Lifted), result
    return result


def test_the_floors_nearness_is_that_of_the_ray_caster():
    found = view().nearness
    expected = disparity()
    below = expected > 0.0
    np.testing.assert_allclose(found[below], expected[below], atol=1e-6)
    assert (found[~below] <= 1e-6).all()


def test_a_box_stands_where_it_stands_and_is_as_high_as_it_is():
    # The box reaches from x = 3.75 to 4.25, y = 0.75 to 1.25, and 0.6 high.
    picture = lifted(disparity(box(4.0, 1.0), wall(8.0)))
    box_pixels = (picture.kind == Kind.OBSTACLE) & (picture.x_m < 6.0)
    assert box_pixels.sum() > 50
    x, y, height = (layer[box_pixels] for layer in (picture.x_m, picture.y_m, picture.height_m))
    assert x.min() == pytest.approx(3.75, abs=0.01)
    assert x.max() == pytest.approx(4.25, abs=0.08)  # within the last row of its lid
    assert (y.min(), y.max()) == (pytest.approx(0.75, abs=0.06), pytest.approx(1.25, abs=0.06))
    assert height.max() == pytest.approx(0.6, abs=0.01)


def test_everything_but_box_and_wall_is_floor():
    picture = lifted(disparity(box(4.0, 1.0), wall(8.0)))
    bare = lifted(disparity(wall(8.0)))
    below_wall = bare.kind == Kind.FLOOR
    changed = picture.kind != bare.kind
    assert (picture.kind[below_wall & ~changed] == Kind.FLOOR).all()
    assert not (picture.kind[changed] == Kind.FLOOR).any()
    assert (picture.kind[changed] == Kind.OBSTACLE).mean() > 0.9


@pytest.mark.parametrize(("scale", "shift"), [(0.3, 0.0), (7.0, -2.0), (1.0, 100.0)])
def test_scale_and_shift_change_nothing(scale, shift):
    picture = disparity(box(3.0, -0.5), wall(7.0)).astype(np.float64)
    plain, other = lifted(picture), lifted(scale * picture + shift)
    assert (plain.kind == other.kind).mean() > 0.999
    obstacle = (plain.kind == Kind.OBSTACLE) & (other.kind == Kind.OBSTACLE)
    np.testing.assert_allclose(plain.x_m[obstacle], other.x_m[obstacle], atol=0.01)


def test_obstacles_may_fill_most_of_the_picture():
    boxes = [box(x, y, side=0.7, height=1.5) for x in (2.6, 4.0) for y in (-2.6, -1.3, 0.0, 1.3, 2.6)]
    picture = lifted(disparity(*boxes, wall(5.0)))
    assert (picture.kind == Kind.OBSTACLE).mean() > 0.6
    assert picture.line.scale == pytest.approx(1.0, rel=0.01)
    assert picture.line.shift == pytest.approx(0.0, abs=0.005)


def test_the_line_is_found_by_hand():
    # d = 2 n + 0.5 on 300 pixels; 500 others stand before it by 0.1 to 0.6.
    rng = np.random.default_rng(3)
    n = rng.uniform(0.05, 0.8, 800)
    d = 2.0 * n + 0.5
    d[300:] += rng.uniform(0.1, 0.6, 500)
    line = fit_floor(n, d)
    assert isinstance(line, FloorLine)
    assert (line.scale, line.shift) == (pytest.approx(2.0, abs=0.01), pytest.approx(0.5, abs=0.005))


def test_noise_widens_the_tolerance_instead_of_making_obstacles():
    noisy = disparity(wall(8.0)) + np.random.default_rng(5).normal(0.0, 0.006, HW)
    picture = lifted(noisy.astype(np.float32))
    assert picture.line.nearness_sigma == pytest.approx(0.006, rel=0.15)
    bare = lifted(disparity(wall(8.0)))
    floor = (bare.kind == Kind.FLOOR) & (view().nearness > 0.2)
    assert (picture.kind[floor] == Kind.OBSTACLE).mean() < 0.005


def test_a_wrong_roll_shows_in_the_bend_and_a_wrong_pitch_hides_in_the_shift():
    # On a plane the disparity is linear in the pixel: pitch, height and focal length change its size and offset along
    # the same direction of the picture, roll its direction.
    picture = disparity(wall(8.0))
    pitched = dataclasses.replace(OURS, pitch_rad=OURS.pitch_rad + math.radians(2.0))
    rolled = dataclasses.replace(OURS, roll_rad=math.radians(2.0))
    bend = {name: lifted(picture, c).bend_rms for name, c in (("pitch", pitched), ("roll", rolled))}
    assert bend["pitch"] < 1e-3
    assert bend["roll"] > 5.0 * max(bend["pitch"], 1e-3)


def test_covariance_of_roll_widens_the_tolerance_and_that_of_pitch_does_not():
    pitch, roll = (floor_view(OURS, HW, np.diag(np.eye(5)[i] * 0.02**2)) for i in (1, 2))
    near = pitch.nearness > 0.2
    assert pitch.nearness_sigma[near].max() < 0.1 * roll.nearness_sigma[near].max()


@pytest.mark.parametrize("kind", ["uniform", "normal", "smooth", "flat", "inverted", "wall"])
def test_a_picture_without_floor_is_refused_with_a_reason(kind):
    rng = np.random.default_rng(7)
    smooth = np.kron(rng.random((6, 8)), np.ones((16, 16)))
    pictures = {
        "uniform": rng.random(HW),
        "normal": rng.normal(size=HW),
        "smooth": smooth,
        "flat": np.ones(HW),
        "inverted": -disparity(box(3.0, 0.0), wall(8.0)),
        "wall": np.full(HW, 0.7) + rng.normal(0.0, 0.01, HW),
    }
    result = FloorLifter(view()).lift(pictures[kind].astype(np.float32), everywhere())
    assert isinstance(result, NoFloor)
    assert len(result.reason) > 10


def test_nothing_usable_is_refused_and_the_next_picture_is_taken():
    lifter = FloorLifter(view())
    picture = disparity(wall(8.0))
    refused = lifter.lift(picture, np.zeros(HW, dtype=np.bool_))
    assert isinstance(refused, NoFloor)
    assert "0 usable pixels" in refused.reason
    assert isinstance(lifter.lift(picture, everywhere()), Lifted)


def test_what_is_not_usable_is_unknown():
    usable = everywhere()
    usable[60:70, 40:60] = False
    picture = lifted(disparity(wall(8.0)), usable=usable)
    assert (picture.kind[60:70, 40:60] == Kind.UNKNOWN).all()


def test_a_smooth_error_of_the_network_is_taken_off_floor_and_obstacles():
    # A bowl of 0.02 1/m: at 6 m it would raise the floor by 2.5 m · 0.02 · 6 = 0.3 m, and move the box by 0.5 m.
    across = np.cos(2.0 * np.pi * (np.arange(HW[1]) + 0.5) / HW[1])
    scene = disparity(box(4.5, 0.0), wall(9.0))
    picture = lifted((scene + 0.02 * across).astype(np.float32))
    plain = lifted(scene)
    floor, standing = plain.kind == Kind.FLOOR, (plain.kind == Kind.OBSTACLE) & (plain.x_m < 6.0)
    assert (picture.kind[floor] == Kind.OBSTACLE).mean() < 0.02
    found = standing & (picture.kind == Kind.OBSTACLE)
    assert found.sum() > 0.8 * standing.sum()
    np.testing.assert_allclose(np.median(picture.x_m[found] - plain.x_m[found]), 0.0, atol=0.05)
    assert 0.005 < picture.bend_rms < 0.03


def test_softened_edges_leave_nothing_between_the_surfaces():
    scene = disparity(box(3.0, 0.0, side=0.5, height=1.5), wall(9.0))
    soft = lifted(cv2.GaussianBlur(scene, (0, 0), 1.0))
    obstacle = (soft.kind == Kind.OBSTACLE) & (np.abs(soft.y_m) < 0.2)
    between = obstacle & (soft.x_m > 3.6) & (soft.x_m < 8.5)  # the box ends at 3.25, the wall begins at 9
    assert between.sum() < 0.03 * obstacle.sum()


def test_a_picture_of_another_size_is_refused():
    lifter = FloorLifter(view())
    for picture, usable in ((np.zeros((2, 2), np.float32), everywhere()), (disparity(wall(9.0)), everywhere()[:1])):
        with pytest.raises(ContractError, match="shape expected"):
            lifter.lift(picture, usable)
