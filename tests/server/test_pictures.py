"""Streams that many look at: what is drawn, how often, and for whom."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import numpy as np
import pytest

from revnm_server.api.between_ticks import BetweenTicks
from revnm_server.api.pictures import Drawing, SharedPictures
from revnm_server.camera.jpeg import decode_jpeg
from revnm_server.views.depth_picture import depth_picture, ego_picture


class Easel:
    """Draws on request, and counts."""

    def __init__(self) -> None:
        self.stamp_ns, self.drawn, self.closed, self.empty = 1_000_000, 0, False, False
        self.ticking = False
        between_ticks = BetweenTicks(lambda: self.ticking)
        self.shared = SharedPictures(self.newest, between_ticks=between_ticks, closing=lambda: self.closed)

    def newest(self) -> Drawing | None:
        return None if self.empty else Drawing(self.stamp_ns, self.draw)

    def draw(self) -> np.ndarray:
        self.drawn += 1
        return np.full((48, 64, 3), self.drawn, np.uint8)


async def take(parts: AsyncIterator[bytes]) -> bytes:
    return await asyncio.wait_for(anext(parts), 5.0)


def test_many_who_look_get_one_drawing() -> None:
    easel = Easel()

    async def look() -> None:
        viewers = [easel.shared.parts() for _ in range(50)]
        first = await asyncio.gather(*(take(viewer) for viewer in viewers))
        assert len(set(first)) == 1
        assert easel.drawn == 1
        easel.stamp_ns += 100_000_000
        second = await asyncio.gather(*(take(viewer) for viewer in viewers))
        assert len(set(second)) == 1
        assert easel.drawn == 2
        assert second[0] != first[0]
        late = await take(easel.shared.parts())  # who comes later sees the newest without a new drawing
        assert late == second[0]
        assert easel.drawn == 2

    asyncio.run(look())


def test_a_picture_is_sent_once_and_at_most_ten_times_a_second() -> None:
    easel = Easel()

    async def look() -> None:
        loop = asyncio.get_running_loop()
        viewer = easel.shared.parts()
        began_s = loop.time()
        for _ in range(4):
            await take(viewer)
            easel.stamp_ns += 1
        assert loop.time() - began_s > 0.29
        await take(viewer)
        waiting = asyncio.ensure_future(anext(viewer))
        await asyncio.wait({waiting}, timeout=0.25)
        assert not waiting.done()  # the same picture again is none
        assert easel.drawn == 5
        easel.closed = True
        with pytest.raises(StopAsyncIteration):
            await asyncio.wait_for(waiting, 5.0)

    asyncio.run(look())


def test_a_picture_waits_for_the_tick() -> None:
    easel = Easel()
    easel.ticking = True

    async def look() -> None:
        waiting = asyncio.ensure_future(anext(easel.shared.parts()))
        for _ in range(5):
            await asyncio.sleep(0)
        assert easel.drawn == 0
        easel.ticking = False
        assert await asyncio.wait_for(waiting, 5.0)
        assert easel.drawn == 1

    asyncio.run(look())


def test_nobody_looks_and_nothing_is_drawn() -> None:
    easel = Easel()

    async def look() -> None:
        viewer = easel.shared.parts()
        await take(viewer)
        await viewer.aclose()  # type: ignore[attr-defined]
        for _ in range(3):
            easel.stamp_ns += 1
            await asyncio.sleep(0)
        assert easel.drawn == 1
        assert easel.shared.available
        easel.empty = True
        assert not easel.shared.available

    asyncio.run(look())


def test_one_who_leaves_takes_nothing_from_the_others() -> None:
    easel = Easel()

    async def look() -> None:
        leaving, staying = asyncio.ensure_future(anext(easel.shared.parts())), easel.shared.parts()
        await asyncio.sleep(0)
        waiting = asyncio.ensure_future(anext(staying))
        await asyncio.sleep(0)
        leaving.cancel()
        assert await asyncio.wait_for(waiting, 5.0)

    asyncio.run(look())


def test_a_part_says_how_long_it_is_and_when_its_picture_was_taken() -> None:
    easel = Easel()

    async def look() -> bytes:
        return await take(easel.shared.parts())

    head, _, body = asyncio.run(look()).partition(b"\r\n\r\n")
    lines = head.decode().split("\r\n")
    assert lines[0] == "--frame"
    assert "X-Frame-Stamp-Ms: 1.0" in lines
    assert f"Content-Length: {len(body) - 2}" in lines
    assert decode_jpeg(body[:-2]).shape == (48, 64, 3)


def test_near_is_bright_and_warm_in_the_cameras_proportions() -> None:
    disparity = np.linspace(0.0, 1.0, 32, dtype=np.float32)[None].repeat(24, axis=0)
    picture = depth_picture(disparity, size_px=(1280, 720))
    assert picture.shape == (360, 640, 3)
    near, far = picture[180, -1].astype(int), picture[180, 0].astype(int)
    assert near.sum() > far.sum() + 300
    assert near[0] > near[2] + 50  # red over blue
    assert far.sum() < 30


def test_an_imagined_view_shows_near_as_the_cameras_depth_does() -> None:
    ego = np.full((32, 32), 1.0, np.float32)
    ego[:, :16] = -1.0
    picture = ego_picture(ego)
    assert picture.shape == (320, 320, 3)
    assert picture[160, 10].astype(int).sum() > picture[160, 310].astype(int).sum() + 300
