from __future__ import annotations

import math
import random
import time
from dataclasses import replace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from revnm_client import cdr
from revnm_client.control_messages import decode_attachment
from revnm_client.errors import MessageError
from revnm_client.geometry import Pose2
from revnm_client.messages import CompressedImage, Odometry, Plan, Scan, Velocity

SCAN = Scan(
    stamp_ns=1_000_000_002,
    angle_min_rad=-1.0,
    angle_increment_rad=0.5,
    range_min_m=0.125,
    range_max_m=8.0,
    ranges_m=np.array([1.5, math.inf, 0.0], dtype=np.float32),
)
ODOMETRY = Odometry(5_000_000_001, Pose2(1.0, -2.0, 0.0), Velocity(0.5, -0.25))
VELOCITY = Velocity(0.5, -0.25)
PLAN = Plan(7_000_000_002, np.array([[0.5, 0.0], [1.0, 0.0], [1.0, 0.0]]), epoch=3, seq=4, goal_id="g1", server="edge")
ATTACHMENT = b'{"epoch":3,"seq":4,"goal":"g1","server":"edge"}'
IMAGE = CompressedImage(1_500_000_000, "jpeg", b"\xff\xd8\xff\xe0rest")

# Every message begins with 00 01 00 00: CDR, little endian. Offsets count from behind these four bytes. A number
# lies at a multiple of its size; text is its length with the final 0, the characters, and the 0.
CDR = "00010000"
ZERO = "0000000000000000"
ONE = "000000000000f03f"  # 1.0 = 0x3ff0000000000000
HALF = "000000000000e03f"  # 0.5 = 0x3fe0000000000000
BASE_LINK = "0a000000 626173655f6c696e6b 00"

# linear (x, y, z), angular (x, y, z)
GOLDEN_VELOCITY = bytes.fromhex(f"{CDR} {HALF} {ZERO} {ZERO} {ZERO} {ZERO} 000000000000d0bf")

GOLDEN_SCAN = bytes.fromhex(
    f"{CDR}"
    f"01000000 02000000 {BASE_LINK} 0000"  # 1 s, 2 ns, frame; padding from 22 to 24
    "000080bf 00000000 0000003f"  # angle_min -1, angle_max -1 + 2 * 0.5 = 0, angle_increment 0.5
    "00000000 00000000"  # time_increment, scan_time
    "0000003e 00000041"  # range_min 0.125, range_max 8
    "03000000 0000c03f 0000807f 00000000"  # three ranges: 1.5, inf, 0
    "00000000"  # no intensities
)

GOLDEN_ODOMETRY = bytes.fromhex(
    f"{CDR}"
    "05000000 01000000 05000000 6f646f6d 00 000000"  # 5 s, 1 ns, "odom"; padding from 17 to 20
    f"{BASE_LINK} 000000000000"  # padding from 34 to 40
    f"{ONE} 00000000000000c0 {ZERO}"  # position 1, -2, 0
    f"{ZERO} {ZERO} {ZERO} {ONE} {ZERO * 36}"  # orientation (x, y, z, w), covariance
    f"{HALF} {ZERO} {ZERO} {ZERO} {ZERO} 000000000000d0bf {ZERO * 36}"  # velocity, covariance
)

PLAN_HEADER = f"07000000 02000000 {BASE_LINK}"  # 22 bytes
GOLDEN_PLAN = bytes.fromhex(
    f"{CDR} {PLAN_HEADER} 0000 03000000"  # padding from 22 to 24, three poses
    f"{PLAN_HEADER} 000000000000 {HALF} {ZERO} {ZERO} {ZERO} {ZERO} {ZERO} {ONE}"  # padding from 50 to 56
    f"{PLAN_HEADER} 0000 {ONE} {ZERO} {ZERO} {ZERO} {ZERO} {ZERO} {ONE}"  # padding from 134 to 136
    f"{PLAN_HEADER} 0000 {ONE} {ZERO} {ZERO} {ZERO} {ZERO} {ZERO} {ONE}"
)

GOLDEN_IMAGE = bytes.fromhex(
    f"{CDR}"
    "01000000 0065cd1d"  # 1 s, 500 000 000 ns = 0x1dcd6500
    "07000000 63616d657261 00 00"  # "camera"; padding from 19 to 20
    "05000000 6a706567 00 000000"  # "jpeg"; padding from 29 to 32
    "08000000 ffd8ffe0 72657374"  # eight bytes
)


def decode_plan(payload: bytes) -> Plan:
    return cdr.decode_plan(payload, ATTACHMENT)


MESSAGES = [
    pytest.param(cdr.encode_scan, cdr.decode_scan, SCAN, GOLDEN_SCAN, id="scan"),
    pytest.param(cdr.encode_odometry, cdr.decode_odometry, ODOMETRY, GOLDEN_ODOMETRY, id="odometry"),
    pytest.param(cdr.encode_velocity, cdr.decode_velocity, VELOCITY, GOLDEN_VELOCITY, id="velocity"),
    pytest.param(cdr.encode_plan, decode_plan, PLAN, GOLDEN_PLAN, id="plan"),
    pytest.param(cdr.encode_image, cdr.decode_image, IMAGE, GOLDEN_IMAGE, id="image"),
]


def assert_same(a: object, b: object) -> None:
    assert type(a) is type(b)
    for field in a.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field), err_msg=field)


@pytest.mark.parametrize(("encode", "decode", "message", "golden"), MESSAGES)
def test_golden_bytes(encode, decode, message, golden):
    assert encode(message).hex(" ") == golden.hex(" ")
    assert_same(decode(golden), message)


def test_sizes_on_the_wire():
    assert len(GOLDEN_VELOCITY) == 52
    assert len(GOLDEN_ODOMETRY) == 724


def test_attachment():
    assert cdr.encode_attachment(PLAN) == ATTACHMENT
    ticket = decode_attachment(ATTACHMENT)
    assert (ticket.epoch, ticket.seq, ticket.goal_id, ticket.server) == (3, 4, "g1", "edge")


def test_round_trips_of_random_messages():
    rng = np.random.default_rng(5)
    for _ in range(50):
        stamp_ns = int(rng.integers(0, 2**31 * 10**9))
        scan = Scan(stamp_ns, -3.0, 0.0078125, 0.0625, 10.0, rng.uniform(0, 12, 720).astype(np.float32))
        pose = Pose2(*rng.uniform((-99, -99, -math.pi), (99, 99, math.pi)))
        odometry = Odometry(stamp_ns, pose, Velocity(*rng.uniform(-1, 1, 2)))
        plan = replace(PLAN, stamp_ns=stamp_ns, waypoints_m=rng.uniform(-9, 9, (5, 2)))
        assert_same(cdr.decode_scan(cdr.encode_scan(scan)), scan)
        assert_same(decode_plan(cdr.encode_plan(plan)), plan)
        back = cdr.decode_odometry(cdr.encode_odometry(odometry))
        assert back.odom_from_robot == pytest.approx(pose, abs=1e-12)
        assert (back.stamp_ns, back.velocity) == (stamp_ns, odometry.velocity)


def test_plan_poses_look_along_the_path():
    # From the robot at the origin: 1 m ahead, then 1 m left of that, where it stays.
    plan = replace(PLAN, waypoints_m=np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 1.0]]))
    path = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(cdr.encode_plan(plan), "nav_msgs/msg/Path")
    turns = [2 * math.atan2(pose.pose.orientation.z, pose.pose.orientation.w) for pose in path.poses]
    assert turns == pytest.approx([math.pi / 2] * 3)


@pytest.mark.parametrize(("encode", "decode", "message", "golden"), MESSAGES)
def test_padding_of_other_writers_is_read(encode, decode, message, golden):
    assert_same(decode(golden + b"\0\0\0"), message)


def test_big_endian_is_read():
    store = get_typestore(Stores.ROS2_JAZZY)
    message = store.deserialize_cdr(GOLDEN_SCAN, "sensor_msgs/msg/LaserScan")
    payload = bytes(store.serialize_cdr(message, "sensor_msgs/msg/LaserScan", little_endian=False))
    assert payload != GOLDEN_SCAN
    scan = cdr.decode_scan(payload)
    assert_same(scan, SCAN)
    assert scan.ranges_m.dtype == np.dtype("=f4")


def mutations(golden: bytes, count: int, seed: int):
    """Truncations, bit flips, splices of absurd numbers, and noise."""
    rng = random.Random(seed)
    absurd = [b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\xc0\x7f", b"\0\0\0\0\0\0\xf8\x7f", b"\0\0\0\0\0\0\xf0\xff"]
    yield from (golden[:length] for length in range(len(golden)))
    for index in range(count):
        bad = bytearray(golden)
        if index % 4 == 3:
            bad[4:] = rng.randbytes(rng.randrange(300))
        elif index % 4 == 2:
            place = rng.randrange(len(bad) // 4) * 4
            splice = rng.choice(absurd)
            bad[place : place + len(splice)] = splice
        else:
            for _ in range(rng.randint(1, 4)):
                bad[rng.randrange(len(bad))] ^= 1 << rng.randrange(8)
        yield bytes(bad)


def assert_trustworthy(message: object) -> None:
    """What the rest of the program takes for granted."""
    assert 0 <= getattr(message, "stamp_ns", 0) < 2**31 * 10**9
    if isinstance(message, Scan):
        assert 1 <= len(message.ranges_m) <= cdr.MAX_BEAMS
        assert 0 <= message.range_min_m < message.range_max_m
        assert message.angle_increment_rad != 0
        assert np.isfinite(message.points_m()).all()
    elif isinstance(message, Plan):
        assert message.waypoints_m.shape[1:] == (2,)
        assert 1 <= len(message.waypoints_m) <= cdr.MAX_WAYPOINTS
        assert (np.abs(message.waypoints_m) <= cdr.MAX_WAYPOINT_M).all()
    elif isinstance(message, Odometry):
        assert all(map(math.isfinite, message.odom_from_robot))
        assert_trustworthy(message.velocity)
    elif isinstance(message, Velocity):
        assert abs(message.v_mps) <= cdr.MAX_SPEED
        assert abs(message.w_radps) <= cdr.MAX_SPEED
    else:
        assert message.format in ("jpeg", "png")


@pytest.mark.parametrize(("encode", "decode", "message", "golden"), MESSAGES)
def test_any_bytes_give_a_good_message_or_a_message_error(encode, decode, message, golden):
    refused = 0
    worst_s = 0.0
    for payload in mutations(golden, count=4000, seed=11):
        begin_s = time.thread_time()
        try:
            decoded = decode(payload)
        except MessageError:
            refused += 1
        else:
            assert_trustworthy(decoded)
        worst_s = max(worst_s, time.thread_time() - begin_s)
    assert refused > 1000
    assert worst_s < 0.1  # no huge allocation for a huge length


@pytest.mark.parametrize(
    "bad",
    [
        replace(SCAN, ranges_m=np.array([1.0, math.nan], dtype=np.float32)),
        replace(SCAN, ranges_m=np.array([1.0, -0.5], dtype=np.float32)),
        replace(SCAN, ranges_m=np.array([-math.inf], dtype=np.float32)),
        replace(SCAN, ranges_m=np.empty(0, dtype=np.float32)),
        replace(SCAN, ranges_m=np.ones(20_001, dtype=np.float32), angle_increment_rad=1e-4),
        replace(SCAN, angle_increment_rad=0.0),
        replace(SCAN, angle_increment_rad=math.nan),
        replace(SCAN, angle_increment_rad=math.inf),
        replace(SCAN, angle_increment_rad=3.2),  # two steps of it are more than a turn
        replace(SCAN, angle_min_rad=7.0),
        replace(SCAN, range_min_m=8.0),
        replace(SCAN, range_min_m=-0.1),
        replace(SCAN, range_max_m=math.inf),
        replace(SCAN, range_max_m=1e6),
    ],
)
def test_absurd_scans_are_refused(bad):
    with np.errstate(invalid="ignore"):
        payload = cdr.encode_scan(bad)
    with pytest.raises(MessageError):
        cdr.decode_scan(payload)


@pytest.mark.parametrize(
    "bad",
    [
        replace(ODOMETRY, odom_from_robot=Pose2(math.nan, 0.0, 0.0)),
        replace(ODOMETRY, odom_from_robot=Pose2(0.0, 2e6, 0.0)),
        replace(ODOMETRY, odom_from_robot=Pose2(0.0, 0.0, math.nan)),
        replace(ODOMETRY, velocity=Velocity(10.1, 0.0)),
        replace(ODOMETRY, velocity=Velocity(0.0, -math.inf)),
    ],
)
def test_absurd_odometry_is_refused(bad):
    with pytest.raises(MessageError):
        cdr.decode_odometry(cdr.encode_odometry(bad))


def test_an_unset_orientation_is_refused():
    orientation = 4 + 64  # three numbers of position behind offset 40, then x, y, z; w is the fourth
    payload = bytearray(GOLDEN_ODOMETRY)
    payload[orientation + 24 : orientation + 32] = bytes(8)
    with pytest.raises(MessageError, match="quaternion"):
        cdr.decode_odometry(bytes(payload))


@pytest.mark.parametrize("bad", [Velocity(11.0, 0.0), Velocity(0.0, math.nan), Velocity(-math.inf, 0.0)])
def test_absurd_velocities_are_refused(bad):
    with pytest.raises(MessageError):
        cdr.decode_velocity(cdr.encode_velocity(bad))


@pytest.mark.parametrize(
    "waypoints", [np.empty((0, 2)), np.zeros((65, 2)), [[math.nan, 0.0]], [[0.0, math.inf]], [[50.1, 0.0]]]
)
def test_absurd_plans_are_refused(waypoints):
    with np.errstate(invalid="ignore"):
        payload = cdr.encode_plan(replace(PLAN, waypoints_m=np.asarray(waypoints)))
    with pytest.raises(MessageError):
        decode_plan(payload)


def test_a_plan_of_a_million_waypoints_is_refused_at_once():
    more = 10**6 - 3
    payload = GOLDEN_PLAN[:28] + (10**6).to_bytes(4, "little") + GOLDEN_PLAN[32:] + GOLDEN_PLAN[-88:] * more
    begin_s = time.thread_time()
    with pytest.raises(MessageError, match="expected at most 16384"):
        decode_plan(payload)
    assert time.thread_time() - begin_s < 0.1


def test_a_plan_in_another_frame_is_refused():
    for place in (4 + 12, 4 + 40):  # the first letter of the frame in the path's and in the first pose's header
        payload = bytearray(GOLDEN_PLAN)
        payload[place : place + 1] = b"B"
        with pytest.raises(MessageError, match="Base_link"):
            decode_plan(bytes(payload))


@pytest.mark.parametrize(
    "bad",
    [
        replace(IMAGE, data=b""),
        replace(IMAGE, data=b"\x89PNG----"),
        replace(IMAGE, format="h264"),
        replace(IMAGE, format="jpeg" * 20),
        replace(IMAGE, data=b"\xff\xd8\xff" + bytes(cdr.MAX_IMAGE_BYTES)),
    ],
)
def test_absurd_images_are_refused(bad):
    with pytest.raises(MessageError):
        cdr.decode_image(cdr.encode_image(bad))


def test_long_image_formats_of_ros_are_understood():
    image = cdr.decode_image(cdr.encode_image(replace(IMAGE, format="rgb8; jpeg compressed bgr8")))
    assert image.format == "jpeg"


def test_impossible_stamps_are_refused():
    for sec, nanosec in ((b"\xff\xff\xff\xff", bytes(4)), (bytes(4), b"\x00\xca\x9a\x3b")):  # -1 s; 1e9 ns
        with pytest.raises(MessageError, match="stamp"):
            cdr.decode_scan(GOLDEN_SCAN[:4] + sec + nanosec + GOLDEN_SCAN[12:])
