"""The camera's memory: what stays is learnt, what moves is not, and robots never are."""

from __future__ import annotations

import numpy as np
import pytest

from revnm_client.errors import ContractError
from revnm_server.mapping.disparity_memory import DisparityMemory, clipped

from .floor_scene import HW, box, disparity, everywhere, nowhere, wall

EMPTY = disparity(wall(8.0))
WITH_BOX = disparity(box(4.0, 0.0), wall(8.0))
BOX = WITH_BOX > EMPTY + 1e-4


def test_pictures_of_any_scale_and_shift_are_one_background():
    rng, memory = np.random.default_rng(0), DisparityMemory(HW)
    for i in range(20):
        scale, shift = (1.0, 0.0) if i == 0 else (rng.uniform(0.5, 3.0), rng.uniform(-1.0, 1.0))
        got = memory.update((scale * EMPTY + shift).astype(np.float32), nowhere(), 0.1 * i)
        assert got.aligned
        np.testing.assert_allclose(got.disparity, EMPTY, atol=1e-4)
        assert not got.moving.any()


def test_noise_is_averaged():
    rng, memory = np.random.default_rng(1), DisparityMemory(HW)
    for i in range(30):
        got = memory.update((EMPTY + rng.normal(0.0, 0.005, HW)).astype(np.float32), nowhere(), 0.1 * i)
    assert (got.disparity - EMPTY).std() < 0.4 * 0.005


def test_what_robots_hide_comes_from_the_memory_and_what_they_always_hid_is_unknown():
    memory, robot = DisparityMemory(HW), BOX
    first = memory.update(WITH_BOX, robot, 0.0)
    assert not first.usable[robot].any()
    assert np.isinf(first.age_s[robot]).all()
    memory.update(EMPTY, nowhere(), 1.0)
    last = memory.update(WITH_BOX, robot, 3.5)
    assert last.usable[robot].all()
    np.testing.assert_allclose(last.disparity[robot], EMPTY[robot], atol=1e-4)
    np.testing.assert_allclose(last.age_s[robot], 2.5)
    np.testing.assert_allclose(last.age_s[~robot], 0.0)


def test_what_appears_is_there_at_once_and_what_leaves_is_gone_at_once():
    memory = DisparityMemory(HW)
    for i in range(10):
        memory.update(EMPTY, nowhere(), 0.1 * i)
    there = memory.update(WITH_BOX, nowhere(), 1.0)
    np.testing.assert_allclose(there.disparity, WITH_BOX, atol=2e-3)
    assert there.moving[BOX].mean() > 0.9
    gone = memory.update(EMPTY, nowhere(), 1.1)
    np.testing.assert_allclose(gone.disparity, EMPTY, atol=2e-3)


@pytest.mark.parametrize(("stays_s", "learnt"), [(0.4, False), (0.9, True)])
def test_what_stays_becomes_background_after_its_time(stays_s, learnt):
    memory = DisparityMemory(HW)
    memory.update(EMPTY, nowhere(), 0.0)
    for i in range(round(stays_s / 0.1)):
        memory.update(WITH_BOX, nowhere(), 1.0 + 0.1 * i)
    behind = memory.update(EMPTY, BOX, 3.0)  # a robot stands where the box was: only memory can tell
    expected = WITH_BOX if learnt else EMPTY
    np.testing.assert_allclose(behind.disparity[BOX], expected[BOX], atol=1e-2)


def test_a_learnt_thing_that_left_is_forgotten_within_a_second():
    memory = DisparityMemory(HW)
    for i in range(20):
        memory.update(WITH_BOX, nowhere(), 0.1 * i)
    for i in range(10):
        memory.update(EMPTY, nowhere(), 2.0 + 0.1 * i)
    behind = memory.update(EMPTY, BOX, 3.0)
    np.testing.assert_allclose(behind.disparity[BOX], EMPTY[BOX], atol=2e-3)


def test_another_scene_is_not_mixed_in_and_is_taken_over_after_a_second():
    memory = DisparityMemory(HW)
    other = np.flip(EMPTY).copy() * 2.0
    memory.update(EMPTY, nowhere(), 0.0)
    at_once = memory.update(other, nowhere(), 0.2)
    assert not at_once.aligned
    np.testing.assert_array_equal(at_once.disparity, other)
    memory.update(other, nowhere(), 1.3)
    later = memory.update(other, nowhere(), 1.4)
    assert later.aligned
    np.testing.assert_allclose(later.disparity, other, atol=1e-4)


def test_clipped_ends_are_unknown():
    cut = np.clip(EMPTY, 0.2, 0.4)
    got = DisparityMemory(HW).update(cut, nowhere(), 0.0)
    np.testing.assert_array_equal(got.usable, (EMPTY > 0.2) & (EMPTY < 0.4))
    assert not clipped(EMPTY + np.linspace(0.0, 1e-3, EMPTY.size, dtype=np.float32).reshape(HW)).any()


def test_a_picture_that_is_all_robot_changes_nothing():
    memory = DisparityMemory(HW)
    memory.update(EMPTY, nowhere(), 0.0)
    hidden = memory.update(WITH_BOX, everywhere(), 0.1)
    assert not hidden.aligned
    assert not hidden.usable.any()
    again = memory.update(EMPTY, nowhere(), 0.2)
    assert again.aligned
    np.testing.assert_allclose(again.disparity, EMPTY, atol=1e-4)


@pytest.mark.parametrize(("of", "hw"), [("disparity", (HW[0] + 1, HW[1])), ("robots", (1, HW[1]))])
def test_arrays_of_another_size_are_refused(of: str, hw: tuple[int, int]):
    arrays = {"disparity": EMPTY, "robots": nowhere()}
    arrays[of] = np.resize(arrays[of], hw)
    with pytest.raises(ContractError, match=of):
        DisparityMemory(HW).update(**arrays, stamp_s=0.0)
