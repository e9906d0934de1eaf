"""Malformed and absurd scans, odometries and plans, through the driver's own inboxes into the agent.

A session of Zenoh hands its own messages over before ``put`` returns, and the time is simulated: every run is the
same. Hostile messages come between sound ones, so that there is always something to spoil.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from contextlib import closing
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

from revnm_client import cdr, keys
from revnm_client.agent import AgentConfig, RobotAgent, Tick
from revnm_client.control_messages import encode_state
from revnm_client.drivers import DriverContext
from revnm_client.drivers.zenoh_driver import ZenohDriver
from revnm_client.geometry import Pose2
from revnm_client.link import Inbox, LatestSubscriber
from revnm_client.messages import STANDSTILL, Odometry, Plan, Scan, Velocity
from revnm_client.mppi import MppiConfig

ROBOT = "rover"
NS = 1_000_000_000
TICK_NS = NS // 20
OFFSET_NS = 7 * NS  # the server's clock is ahead
SMALL = MppiConfig(samples=50, steps=10)
COUNTS = [3_000, pytest.param(100_000, marks=pytest.mark.slow)]

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = {
    "scan": "sensor_msgs/msg/LaserScan",
    "odom": "nav_msgs/msg/Odometry",
    "waypoints": "nav_msgs/msg/Path",
}
FLOATS = [math.nan, math.inf, -math.inf, 3e38, -3e38, 1e-45, -1e-45, 0.0, -0.0, -1.0, 1e6, 9.9, 6.28, 1e-7]
DOUBLES = [*FLOATS, 1e308, -1e308, 5e-324]
INTEGERS = [0, 1, 999_999_999, NS, 2**31 - 1, -1, -(2**31)]
TEXTS = ["", "map", "base_link\0", "\n" * 64, "x" * 65, "é" * 40, "%s%n"]
TICKET = b'{"epoch":%s,"seq":%s,"goal":%s,"server":""}'
ATTACHMENTS = [
    b"",
    b"{}",
    b"null",
    b"[" * 3000,
    b'{"epoch":1,"seq":1}',
    *(TICKET % (bad, b"1", b'"g"') for bad in (b"-1", b"1e3", b"NaN", b"true", b'"1"', b"9" * 4000)),
    *(TICKET % (b"1000000", bad, b'"g"') for bad in (b"-1", b"1.0", b"null", b"[1]", b"9223372036854775808")),
    *(TICKET % (b"1000000", b"1", bad) for bad in (b"1", b'"\\u0000"', b'"' + b"g" * 65 + b'"', b'"\xff"')),
]


class Wire(NamedTuple):
    """What is sent."""

    name: str
    payload: bytes
    attachment: bytes = b""


class World:
    """A robot that obeys, in the open, and the sound messages of its LiDAR, wheels and server."""

    def __init__(self, session: zenoh.Session) -> None:
        self.now_ns = 1_700_000_000 * NS
        self.pose, self.velocity = Pose2(0.0, 0.0, 0.0), STANDSTILL
        self.agent = RobotAgent(AgentConfig(robot=ROBOT, mppi=SMALL))
        self.agent.set_clock_offset(OFFSET_NS)
        self.driver = ZenohDriver(DriverContext(ROBOT, session))
        self.plans = Inbox.with_attachment(LatestSubscriber(session, keys.waypoints(ROBOT)), cdr.decode_plan)
        self._session = session
        self._noise = np.random.default_rng(0)

    def scan(self) -> Wire:
        ranges = self._noise.normal(6.0, 0.01, 90).astype(np.float32)
        ranges[40:50] -= 3.0
        return Wire("scan", cdr.encode_scan(Scan(self.now_ns, -math.pi, math.tau / 90, 0.1, 10.0, ranges)))

    def odometry(self) -> Wire:
        return Wire("odom", cdr.encode_odometry(Odometry(self.now_ns, self.pose, self.velocity)))

    def plan(self, *, ago_ns: int = 0) -> Wire:
        """A plan of a newer epoch than the robot's, so that it is refused for nothing but what is done to it."""
        waypoints = np.stack([np.linspace(0.4, 2.0, 5), np.linspace(0.0, 0.5, 5)], axis=1)
        plan = Plan(self.now_ns + OFFSET_NS - ago_ns, waypoints, self.agent.epoch + 1, 0, "g")
        return Wire("waypoints", cdr.encode_plan(plan), cdr.encode_attachment(plan))

    def hear(self, wire: Wire) -> None:
        """Send a message, and let the robot take it as its loop does."""
        self._session.put(f"{ROBOT}/{wire.name}", wire.payload, attachment=wire.attachment)
        if (odometry := self.driver.take_odometry()) is not None:
            self.agent.on_odometry(odometry, self.now_ns)
        if (scan := self.driver.take_scan()) is not None:
            self.agent.on_scan(scan, self.now_ns)
        if (plan := self.plans.take()) is not None:
            self.agent.on_plan(plan, self.now_ns)

    def tick(self) -> Tick:
        """Decide, check the velocity, move."""
        tick = self.agent.tick(self.now_ns)
        v, w = tick.velocity.v_mps, tick.velocity.w_radps
        assert 0.0 <= v <= SMALL.max_v_mps  # False for NaN, too
        assert -SMALL.max_w_radps <= w <= SMALL.max_w_radps
        self.driver.drive(tick.velocity)
        encode_state(self.agent.state(self.now_ns))
        self.now_ns += TICK_NS
        self.velocity = Velocity(v, w)
        self.pose = self.pose @ Pose2(0.05 * v, 0.0, 0.05 * w)
        return tick

    @property
    def rejected(self) -> int:
        return self.driver.rejected + self.plans.rejected


@pytest.fixture
def world(router: zenoh.Session) -> Iterator[World]:
    world = World(router)
    with closing(world.driver):
        yield world


def flipped(rng: random.Random, wire: Wire) -> Wire:
    """One to three bits are others."""
    bad = bytearray(wire.payload)
    for _ in range(rng.randint(1, 3)):
        bad[rng.randrange(len(bad))] ^= 1 << rng.randrange(8)
    return wire._replace(payload=bytes(bad))


def truncated(rng: random.Random, wire: Wire) -> Wire:
    return wire._replace(payload=wire.payload[: rng.randrange(len(wire.payload))])


def noise(rng: random.Random, wire: Wire) -> Wire:
    """Random bytes, behind a header that is right or not."""
    return wire._replace(payload=wire.payload[: rng.choice((0, 4, 12))] + rng.randbytes(rng.randrange(400)))


def spoilt(rng: random.Random, wire: Wire) -> Wire:
    """One to three fields have extreme values, in a message that is well-formed."""
    message = STORE.deserialize_cdr(wire.payload, TYPES[wire.name])
    places = list(leaves(message))
    for owner, name in rng.sample(places, rng.randint(1, 3)):
        setattr(owner, name, extreme(rng, getattr(owner, name), wire.name, name))
    return wire._replace(payload=bytes(STORE.serialize_cdr(message, TYPES[wire.name])))


def leaves(message: Any) -> Iterator[tuple[Any, str]]:
    """Yield owner and name of all that is no message itself: numbers, texts, arrays, lists."""
    for field in fields(message):
        value = getattr(message, field.name)
        if is_dataclass(value):
            yield from leaves(value)
        elif field.name != "__msgtype__":
            yield message, field.name
        if isinstance(value, list):
            for item in value:
                yield from leaves(item)


def extreme(rng: random.Random, value: Any, message: str, name: str) -> Any:
    if isinstance(value, np.ndarray):
        return extreme_array(rng, value)
    if isinstance(value, list):
        return value * rng.choice((0, 2, 13, 200))
    if isinstance(value, str):
        return rng.choice(TEXTS)
    if isinstance(value, int):
        wanted = rng.choice([*INTEGERS, value + rng.choice((-3600, -1, 1, 3600))])
        return wanted % 2**32 if name == "nanosec" else wanted
    return rng.choice(FLOATS if message == "scan" else DOUBLES)


def extreme_array(rng: random.Random, value: np.ndarray) -> np.ndarray:
    if value.dtype == np.float64:  # covariances have a fixed size
        return np.full_like(value, rng.choice(DOUBLES))
    size = rng.choice((0, 1, 2, len(value), 20_000, 20_001))
    return np.full(size, rng.choice(FLOATS), dtype=np.float32)


def hostile(rng: random.Random, wire: Wire) -> Wire:
    """A message that may be anything; by chance it can be sound."""
    return rng.choice((flipped, truncated, noise, spoilt))(rng, wire)


def unsound_plan(rng: random.Random, world: World) -> Wire:
    """A plan that no robot should drive, whatever chance does."""
    kind = rng.randrange(7)
    if kind == 0:
        return world.plan()._replace(attachment=rng.choice(ATTACHMENTS))
    if kind == 1:
        return truncated(rng, world.plan())
    if kind == 2:
        return noise(rng, world.plan())
    if kind == 3:  # of another time, by six bits of the seconds at least: three that are flipped do not mend it
        return flipped(rng, world.plan(ago_ns=NS * 0b1111_1100_0000_0000))
    if kind == 4:
        ago_ns = rng.choice((600_000_000, 60 * NS, -201_000_000, -3 * NS, -400_000_000 * NS, world.now_ns))
        return world.plan(ago_ns=ago_ns)
    return senseless(rng, world.plan())


def senseless(rng: random.Random, wire: Wire) -> Wire:
    """A plan with a waypoint nowhere, in another frame, or with an impossible number of them."""
    path = STORE.deserialize_cdr(wire.payload, TYPES["waypoints"])
    pose = rng.choice(path.poses)
    kind = rng.randrange(4)
    if kind == 0:
        axis = rng.choice("xy")
        setattr(pose.pose.position, axis, rng.choice((math.nan, math.inf, -math.inf, 1e308, -1e308, 50.1, -1e6)))
    elif kind == 1:
        rng.choice((path, pose)).header.frame_id = rng.choice(("map", "odom", "Base_link", "\n"))
    elif kind == 2:
        path.poses = path.poses * rng.choice((0, 13, 300))
    payload = bytes(STORE.serialize_cdr(path, TYPES["waypoints"]))
    if kind == 3:  # 4 bytes behind the header's 24 and CDR's own 4 say how many waypoints follow
        payload = payload[:28] + rng.choice((6, 10**6, 2**31 - 1, 2**32 - 1)).to_bytes(4, "little") + payload[32:]
    return wire._replace(payload=payload)


def sound_seconds(world: World, seconds: float) -> list[Tick]:
    """Let only sound messages come."""
    ticks = []
    for _ in range(round(20 * seconds)):
        for wire in (world.odometry(), world.scan(), world.plan()):
            world.hear(wire)
        ticks.append(world.tick())
    return ticks


@pytest.mark.parametrize("count", COUNTS)
def test_a_driving_robot_keeps_its_limits_whatever_it_hears(world, count):
    rng = random.Random(1)
    reasons, sent = [], 0
    while sent < count:
        for sound in (world.odometry, world.scan, world.plan):
            world.hear(sound())
            for _ in range(rng.choice((0, 0, 1, 1, 4))):
                source = rng.choice((world.odometry, world.scan, world.plan))
                world.hear(hostile(rng, source()))
                sent += 1
        reasons.append(world.tick().reason)
    assert reasons.count(None) > len(reasons) / 10  # else nothing has been tried
    assert world.rejected > count / 3
    assert sound_seconds(world, 3.0)[-1].velocity.v_mps > 0.1  # nothing is broken for good


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("drove", [False, True])
def test_no_robot_moves_by_absurd_plans(world, count, drove):
    if drove:
        assert sound_seconds(world, 2.0)[-1].velocity.v_mps > 0.1
    rng = random.Random(2)
    replay = world.plan()  # of the epoch after the last one, so new once at most
    if drove:
        world.hear(replay)
    sent, begin_ns = 0, world.now_ns
    while sent < count / 2:
        for wire in (world.odometry(), world.scan()):
            world.hear(wire)
            for _ in range(rng.choice((0, 1, 2, 3))):
                world.hear(replay if drove and rng.random() < 0.1 else unsound_plan(rng, world))
                sent += 1
        tick = world.tick()
        if not drove or world.now_ns - begin_ns > 600_000_000:  # a plan is driven for half a second
            assert tick.velocity == STANDSTILL
            assert "plan" in tick.reason
    assert world.rejected > count / 4
    assert sound_seconds(world, 2.0)[-1].velocity.v_mps > 0.1  # it was able to, all the time
