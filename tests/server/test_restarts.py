from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from revnm_server.frame import Frame
from revnm_server.robots.mission import Goal
from revnm_server.tick.pipeline import TickResult
from revnm_server.tick.restarts import RestartingPipeline, RestartLimits

FRAME = Frame(np.zeros((32, 32, 3), np.uint8), 1, 1)
LIMITS = RestartLimits(failures=3, pictures=6, pause_s=1.0, longest_pause_s=4.0, restarts=4, window_s=100.0)


class Part:
    """A pipeline that works until it is broken."""

    def __init__(self) -> None:
        self.broken = False
        self.closed = False

    def step(self, frame: Frame, goals: Mapping[str, Goal]) -> TickResult:
        if self.broken:
            raise RuntimeError("the device is lost")
        return TickResult((), (), np.zeros((4, 4), np.float32), {}, {})

    def close(self) -> None:
        self.closed = True
        if self.broken:
            raise RuntimeError("the device is lost")


class Bench:
    """Builds parts, and owns the clock."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.parts: list[Part] = []
        self.born_broken = False
        self.unbuildable = False
        self.tried = 0
        self.pipeline = RestartingPipeline(self._build(), self._build, limits=LIMITS, now_s=lambda: self.now_s)

    def _build(self) -> Part:
        self.tried += 1
        if self.unbuildable:
            raise OSError("no file")
        part = Part()
        part.broken = self.born_broken
        self.parts.append(part)
        return part

    def step(self) -> str:
        """Process a picture; returns what was raised, empty if nothing was."""
        try:
            self.pipeline.step(FRAME, {})
        except Exception as error:
            return str(error)
        return ""


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_pipeline_that_fails_now_and_then_is_kept(bench: Bench) -> None:
    for _ in range(10):  # two of any six pictures
        bench.parts[0].broken = True
        assert bench.step() == "the device is lost"
        bench.parts[0].broken = False
        assert [bench.step() for _ in range(2)] == [""] * 2
    assert (len(bench.parts), bench.pipeline.restarts) == (1, 0)


def test_one_that_keeps_failing_is_closed_and_built_anew(bench: Bench) -> None:
    bench.parts[0].broken = True
    assert [bench.step() for _ in range(4)] == ["the device is lost"] * 3 + [""]
    assert bench.parts[0].closed
    assert (len(bench.parts), bench.pipeline.restarts) == (2, 1)
    bench.pipeline.close()
    assert bench.parts[1].closed


def test_one_that_fails_on_every_second_picture_is_built_anew(bench: Bench) -> None:
    """As one does whose failure beside the tick shows at the next picture, which it does not begin then."""
    for broken in (True, False, True, False, True):
        bench.parts[0].broken = broken
        assert bench.step() == ("the device is lost" if broken else "")
    assert bench.step() == ""
    assert bench.pipeline.restarts == 1


def test_it_waits_longer_each_time_and_gives_up_in_the_end(bench: Bench) -> None:
    bench.born_broken = bench.parts[0].broken = True
    built_at_s = []
    while bench.now_s < 60.0:
        before = len(bench.parts)
        bench.step()
        if len(bench.parts) > before:
            built_at_s.append(bench.now_s)
        bench.now_s += 0.125
    # Three failures of 0.125 s come first each time; pauses of 1, 2 and 4 s between the builds.
    assert built_at_s == [0.375, 1.375, 3.375, 7.375]
    said = bench.step()
    assert "4 times in 2 minutes" in said
    assert "the device is lost" in said
    bench.born_broken = False
    bench.now_s = 110.0  # the first builds are forgotten, and it works again
    assert bench.step() == ""


def test_one_that_cannot_be_built_is_tried_again(bench: Bench) -> None:
    bench.parts[0].broken = bench.unbuildable = True
    for _ in range(3):
        bench.step()
    assert "could not be built anew: no file" in bench.step()
    assert "built anew after 1 s" in bench.step()
    bench.unbuildable, bench.now_s = False, 2.0
    assert bench.step() == ""
