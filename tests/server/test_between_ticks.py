"""Who only looks waits for the tick, and not for long."""

from __future__ import annotations

import asyncio

from revnm_server.api.between_ticks import BetweenTicks


class Ticks:
    """A tick that runs until it is asked for the n-th time."""

    def __init__(self, looks: float) -> None:
        self.looks, self.asked = looks, 0

    def __call__(self) -> bool:
        self.asked += 1
        return self.asked <= self.looks


def test_between_ticks_nobody_waits() -> None:
    ticks = Ticks(0)
    asyncio.run(BetweenTicks(ticks).wait())
    assert ticks.asked == 1


def test_all_who_look_wait_together_until_the_tick_has_ended() -> None:
    ticks = Ticks(4)

    async def look() -> None:
        between = BetweenTicks(ticks)
        await asyncio.gather(*(between.wait() for _ in range(50)))
        assert ticks.asked == 5  # not for each of them
        ticks.asked = 0  # the next tick
        await between.wait()
        assert ticks.asked == 5

    asyncio.run(asyncio.wait_for(look(), 5.0))


def test_a_long_tick_is_not_waited_for() -> None:
    asyncio.run(asyncio.wait_for(BetweenTicks(Ticks(float("inf"))).wait(), 5.0))


def test_one_who_leaves_takes_nothing_from_the_others() -> None:
    ticks = Ticks(3)

    async def look() -> None:
        between = BetweenTicks(ticks)
        leaving, staying = (asyncio.ensure_future(between.wait()) for _ in range(2))
        await asyncio.sleep(0)
        leaving.cancel()
        await staying
        assert ticks.asked == 4

    asyncio.run(asyncio.wait_for(look(), 5.0))
