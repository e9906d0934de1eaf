"""When a calibration is written, and what becomes of a file that was refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revnm_server.calibration.adjustment import Belief
from revnm_server.calibration.keeper import CalibrationKeeper
from revnm_server.calibration.prior import wide_prior
from revnm_server.calibration.store import load_belief, save_belief

from .waiting import eventually

SIZE = (640, 480)


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def keeper(tmp_path: Path, clock: Clock) -> CalibrationKeeper:
    return CalibrationKeeper(tmp_path / "kept", "hall", now_s=clock)


def belief(pitch_rad: float) -> Belief:
    mean = wide_prior().mean.copy()
    mean[1] = pitch_rad
    return Belief(mean, wide_prior().covariance)


def pitch_on_disk(tmp_path: Path) -> float | None:
    kept = load_belief(tmp_path / "kept" / "hall.json", "hall", SIZE)
    return None if kept is None else float(kept.mean[1])


def test_it_is_written_when_it_becomes_good_and_then_now_and_then(
    keeper: CalibrationKeeper, tmp_path: Path, clock: Clock
) -> None:
    assert keeper.load(SIZE) is None
    keeper.offer(SIZE, belief(0.1), good=False)
    keeper.offer(SIZE, belief(0.2), good=True)
    eventually(lambda: pitch_on_disk(tmp_path) == 0.2)
    clock.now_s += 29.0
    keeper.offer(SIZE, belief(0.3), good=True)
    assert pitch_on_disk(tmp_path) == 0.2
    clock.now_s += 2.0
    keeper.offer(SIZE, belief(0.3), good=True)
    eventually(lambda: pitch_on_disk(tmp_path) == 0.3)


def test_what_is_not_written_yet_is_at_the_end(keeper: CalibrationKeeper, tmp_path: Path) -> None:
    keeper.offer(SIZE, belief(0.2), good=True)
    keeper.offer(SIZE, belief(0.4), good=True)
    keeper.close()
    assert pitch_on_disk(tmp_path) == 0.4


def test_what_is_not_good_any_more_is_not_written(keeper: CalibrationKeeper, tmp_path: Path) -> None:
    keeper.offer(SIZE, belief(0.2), good=True)
    keeper.offer(SIZE, belief(0.4), good=False)
    keeper.close()
    assert pitch_on_disk(tmp_path) == 0.2


def test_what_was_kept_is_loaded_and_not_written_again(keeper: CalibrationKeeper, tmp_path: Path, clock: Clock) -> None:
    path = tmp_path / "kept" / "hall.json"
    save_belief(path, "hall", SIZE, belief(0.5))
    before = path.stat().st_mtime_ns
    kept = keeper.load(SIZE)
    assert kept is not None
    clock.now_s += 100.0
    keeper.offer(SIZE, kept, good=True)
    keeper.close()
    assert path.stat().st_mtime_ns == before
    assert np.array_equal(kept.mean, belief(0.5).mean)


@pytest.mark.parametrize("size", [SIZE, (1280, 960)])
def test_a_refused_file_stays_until_there_is_a_better_one(
    keeper: CalibrationKeeper, tmp_path: Path, size: tuple[int, int], caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "kept" / "hall.json"
    save_belief(path, "hall", SIZE, belief(0.5))
    if size == SIZE:
        path.write_text("{")
    text = path.read_text()
    assert keeper.load(size) is None
    assert keeper.trouble is not None
    assert str(path) in keeper.trouble
    assert keeper.trouble in caplog.text
    keeper.offer(size, belief(0.6), good=False)
    keeper.close()
    assert path.read_text() == text
    keeper.offer(size, belief(0.6), good=True)
    keeper.close()
    assert keeper.trouble is None
    assert load_belief(path, "hall", size) is not None
    assert path.with_name("hall.json.refused").read_text() == text


def test_a_disk_that_cannot_be_written_is_told_and_tried_again(tmp_path: Path, clock: Clock) -> None:
    (tmp_path / "kept").write_text("a file where the folder should be")
    keeper = CalibrationKeeper(tmp_path / "kept", "hall", now_s=clock)
    keeper.offer(SIZE, belief(0.2), good=True)
    eventually(lambda: keeper.trouble is not None)
    assert "hall.json" in str(keeper.trouble)
    (tmp_path / "kept").unlink()
    clock.now_s += 31.0
    keeper.offer(SIZE, belief(0.2), good=True)
    eventually(lambda: keeper.trouble is None)
    assert pitch_on_disk(tmp_path) == 0.2
