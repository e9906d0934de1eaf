"""ROS 2 CDR to and from :mod:`revnm_client.messages`: the wire format between server, robot and simulator.

Decoding is total: any bytes give a checked message or :class:`MessageError`, nothing else. Fields that the
program does not use (covariances, intensities, the height of a planar robot) are not looked at.
Types: ROS 2 Jazzy; little and big endian are read, little endian is written.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from revnm_client import validate
from revnm_client.control_messages import decode_attachment, encode_attachment
from revnm_client.errors import MessageError
from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import CompressedImage, Odometry, Plan, Scan, Velocity

__all__ = [
    "decode_image",
    "decode_odometry",
    "decode_plan",
    "decode_scan",
    "decode_velocity",
    "encode_attachment",
    "encode_image",
    "encode_odometry",
    "encode_plan",
    "encode_scan",
    "encode_stamped_velocity",
    "encode_velocity",
    "odometry_from",
    "scan_from",
    "type_hash",
]

ROBOT_FRAME = "base_link"
ODOM_FRAME = "odom"

MAX_BEAMS = 20_000
MAX_RANGE_M = 1_000.0
LEAST_RANGE_M = 1e-3  # a driver may say 0 for the shortest range, and says 0 for masked beams: those are shorter
MAX_WAYPOINTS = 64
MAX_WAYPOINT_M = 50.0
MAX_SPEED = 10.0
MAX_POSITION_M = 1e6
MAX_IMAGE_BYTES = 8_000_000

_MAX_PAYLOAD_BYTES = 8_388_608
_MAX_PLAN_BYTES = 16_384  # 64 waypoints take 6,000; a path that fills 8 MB takes two seconds to decode
_NS_PER_S = 1_000_000_000
_IMAGE_MAGIC = {"jpeg": b"\xff\xd8\xff", "png": b"\x89PNG"}

_SCAN = "sensor_msgs/msg/LaserScan"
_ODOMETRY = "nav_msgs/msg/Odometry"
_TWIST = "geometry_msgs/msg/Twist"
_TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
_PATH = "nav_msgs/msg/Path"
_IMAGE = "sensor_msgs/msg/CompressedImage"


@functools.cache
def _store() -> Typestore:
    """Return the ROS 2 types; made at the first use, since that takes some 50 ms."""
    return get_typestore(Stores.ROS2_JAZZY)


def type_hash(typename: str) -> str:
    """Return the hash of a ROS 2 type, such as ``geometry_msgs/msg/Twist``: ``RIHS01_`` and 64 digits (REP 2016)."""
    return str(_store().hash_rihs01(typename))


def _make(typename: str, **fields: Any) -> Any:
    return _store().types[typename](**fields)


def _header(stamp_ns: int, frame_id: str) -> Any:
    sec, nanosec = divmod(stamp_ns, _NS_PER_S)
    stamp = _make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return _make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def _pose(pose: Pose2) -> Any:
    half = 0.5 * pose.yaw_rad
    return _make(
        "geometry_msgs/msg/Pose",
        position=_make("geometry_msgs/msg/Point", x=pose.x_m, y=pose.y_m, z=0.0),
        orientation=_make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)),
    )


def _twist(velocity: Velocity) -> Any:
    linear = _make("geometry_msgs/msg/Vector3", x=velocity.v_mps, y=0.0, z=0.0)
    angular = _make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=velocity.w_radps)
    return _make(_TWIST, linear=linear, angular=angular)


def _encode(message: Any, typename: str) -> bytes:
    return bytes(_store().serialize_cdr(message, typename, little_endian=True))


def _decode(payload: bytes, typename: str, *, max_bytes: int = _MAX_PAYLOAD_BYTES) -> Any:
    if len(payload) > max_bytes:
        raise MessageError(f"{typename} of {len(payload)} bytes: expected at most {max_bytes}")
    try:
        return _store().deserialize_cdr(payload, typename)
    except SerdeError as error:
        raise MessageError(f"{typename}: {error}") from error


def _decode_stamp(message: Any) -> int:
    validate.name(message.header.frame_id, what="frame_id")
    return validate.stamp_ns(message.header.stamp.sec, message.header.stamp.nanosec)


def _decode_twist(twist: Any) -> Velocity:
    linear, angular = twist.linear, twist.angular
    for axis, value in zip("xyz", (linear.x, linear.y, linear.z), strict=True):
        validate.number(value, what=f"linear.{axis}", low=-MAX_SPEED, high=MAX_SPEED)
    for axis, value in zip("xyz", (angular.x, angular.y, angular.z), strict=True):
        validate.number(value, what=f"angular.{axis}", low=-MAX_SPEED, high=MAX_SPEED)
    return Velocity(linear.x, angular.z)


def encode_scan(scan: Scan) -> bytes:
    """Return the scan as sensor_msgs/LaserScan in the robot frame."""
    beams = len(scan.ranges_m)
    message = _make(
        _SCAN,
        header=_header(scan.stamp_ns, ROBOT_FRAME),
        angle_min=scan.angle_min_rad,
        angle_max=scan.angle_min_rad + (beams - 1) * scan.angle_increment_rad,
        angle_increment=scan.angle_increment_rad,
        time_increment=0.0,
        scan_time=0.0,
        range_min=scan.range_min_m,
        range_max=scan.range_max_m,
        ranges=np.asarray(scan.ranges_m, dtype=np.float32),
        intensities=np.empty(0, dtype=np.float32),
    )
    return _encode(message, _SCAN)


def decode_scan(payload: bytes) -> Scan:
    """Return the checked scan; its frame may have any name, its angles are taken as the robot's.

    Raises:
        MessageError: It is malformed, a range is NaN or negative, or the beams cover more than a turn.
    """
    message = _decode(payload, _SCAN)
    return scan_from(message, _decode_stamp(message))


def scan_from(message: Any, stamp_ns: int) -> Scan:
    """Return the checked scan of a message that has LaserScan's fields, wherever it came from.

    Raises:
        MessageError: As for :func:`decode_scan`.
    """
    ranges_m = validate.ranges(message.ranges, low=1, high=MAX_BEAMS)
    increment = validate.number(message.angle_increment, what="angle_increment", low=-math.tau, high=math.tau)
    turn = abs(increment) * (len(ranges_m) - 1)
    if increment == 0.0 or turn > 1.01 * math.tau:
        raise MessageError(f"{len(ranges_m)} beams {increment} rad apart: expected more than 0, at most a turn")
    range_max_m = validate.number(message.range_max, what="range_max", low=0.0, high=MAX_RANGE_M)
    range_min_m = max(validate.number(message.range_min, what="range_min", low=0.0, high=range_max_m), LEAST_RANGE_M)
    if range_min_m >= range_max_m:
        raise MessageError(f"range_min is {range_min_m} and range_max {range_max_m}: expected range_min < range_max")
    return Scan(
        stamp_ns=stamp_ns,
        angle_min_rad=validate.number(message.angle_min, what="angle_min", low=-math.tau, high=math.tau),
        angle_increment_rad=increment,
        range_min_m=range_min_m,
        range_max_m=range_max_m,
        ranges_m=ranges_m,
    )


def encode_odometry(odometry: Odometry) -> bytes:
    """Return the odometry as nav_msgs/Odometry from ``odom`` to ``base_link``, covariances 0 (unknown)."""
    unknown = np.zeros(36)
    pose = _make("geometry_msgs/msg/PoseWithCovariance", pose=_pose(odometry.odom_from_robot), covariance=unknown)
    twist = _make("geometry_msgs/msg/TwistWithCovariance", twist=_twist(odometry.velocity), covariance=unknown)
    header = _header(odometry.stamp_ns, ODOM_FRAME)
    return _encode(_make(_ODOMETRY, header=header, child_frame_id=ROBOT_FRAME, pose=pose, twist=twist), _ODOMETRY)


def decode_odometry(payload: bytes) -> Odometry:
    """Return the checked odometry; its frames may have any names.

    Raises:
        MessageError: It is malformed, not finite, the orientation is no rotation, or a speed is over 10.
    """
    message = _decode(payload, _ODOMETRY)
    stamp_ns = _decode_stamp(message)
    validate.name(message.child_frame_id, what="child_frame_id")
    return odometry_from(message, stamp_ns)


def odometry_from(message: Any, stamp_ns: int) -> Odometry:
    """Return the checked odometry of a message that has Odometry's fields, wherever it came from.

    Raises:
        MessageError: As for :func:`decode_odometry`.
    """
    position, turn = message.pose.pose.position, message.pose.pose.orientation
    pose = Pose2(
        validate.number(position.x, what="position.x", low=-MAX_POSITION_M, high=MAX_POSITION_M),
        validate.number(position.y, what="position.y", low=-MAX_POSITION_M, high=MAX_POSITION_M),
        validate.yaw_rad(turn.x, turn.y, turn.z, turn.w),
    )
    return Odometry(stamp_ns, pose, _decode_twist(message.twist.twist))


def encode_velocity(velocity: Velocity) -> bytes:
    """Return the velocity as geometry_msgs/Twist: 52 bytes."""
    return _encode(_twist(velocity), _TWIST)


def encode_stamped_velocity(velocity: Velocity, stamp_ns: int) -> bytes:
    """Return the velocity as geometry_msgs/TwistStamped in ``base_link``."""
    header = _header(stamp_ns, ROBOT_FRAME)
    return _encode(_make(_TWIST_STAMPED, header=header, twist=_twist(velocity)), _TWIST_STAMPED)


def decode_velocity(payload: bytes) -> Velocity:
    """Return the checked velocity; what a differential drive cannot do (sideways) is left out.

    Raises:
        MessageError: It is malformed, not finite, or a component is over 10 m/s or 10 rad/s.
    """
    return _decode_twist(_decode(payload, _TWIST))


def _headings(waypoints_m: FloatArray) -> list[float]:
    """Return the heading (H,) with which each waypoint is left; the last one's is that of its arrival."""
    headings, heading = [], 0.0
    for x, y in waypoints_m[:1]:
        heading = math.atan2(y, x)  # the way from the robot
    for dx, dy in np.diff(waypoints_m, axis=0, append=waypoints_m[-1:]):
        if math.hypot(dx, dy) > 1e-6:
            heading = math.atan2(dy, dx)
        headings.append(heading)
    return headings


def encode_plan(plan: Plan) -> bytes:
    """Return the waypoints as nav_msgs/Path in the robot frame; see also :func:`encode_attachment`.

    The poses look along the path, so that the path can be shown by ROS tools as it is.
    """
    header = _header(plan.stamp_ns, ROBOT_FRAME)
    poses = [
        _make("geometry_msgs/msg/PoseStamped", header=header, pose=_pose(Pose2(float(x), float(y), heading)))
        for (x, y), heading in zip(plan.waypoints_m, _headings(plan.waypoints_m), strict=True)
    ]
    return _encode(_make(_PATH, header=header, poses=poses), _PATH)


def _decode_waypoint(stamped: Any, index: int) -> tuple[float, float]:
    if stamped.header.frame_id not in ("", ROBOT_FRAME):
        raise MessageError(f"waypoint {index} is in frame {stamped.header.frame_id[:80]!r}: expected {ROBOT_FRAME!r}")
    x, y = stamped.pose.position.x, stamped.pose.position.y
    limit = MAX_WAYPOINT_M
    return (
        validate.number(x, what=f"x of waypoint {index}", low=-limit, high=limit),
        validate.number(y, what=f"y of waypoint {index}", low=-limit, high=limit),
    )


def decode_plan(payload: bytes, attachment: bytes) -> Plan:
    """Return the checked plan from the Path and its attachment {epoch, seq, goal, server}.

    Raises:
        MessageError: Either is malformed or missing, the frame is not the robot's, there are no waypoints or
            too many, or one is absurdly far.
    """
    message = _decode(payload, _PATH, max_bytes=_MAX_PLAN_BYTES)
    stamp_ns = _decode_stamp(message)
    if message.header.frame_id != ROBOT_FRAME:
        raise MessageError(f"plan is in frame {message.header.frame_id!r}: expected {ROBOT_FRAME!r}")
    if not 1 <= len(message.poses) <= MAX_WAYPOINTS:
        raise MessageError(f"plan has {len(message.poses)} waypoints: expected 1 to {MAX_WAYPOINTS}")
    waypoints = [_decode_waypoint(pose, index) for index, pose in enumerate(message.poses)]
    ticket = decode_attachment(attachment)
    return Plan(stamp_ns, np.array(waypoints), ticket.epoch, ticket.seq, ticket.goal_id, ticket.server)


def encode_image(image: CompressedImage) -> bytes:
    """Return the picture as sensor_msgs/CompressedImage."""
    data = np.frombuffer(image.data, dtype=np.uint8)
    header = _header(image.stamp_ns, "camera")
    return _encode(_make(_IMAGE, header=header, format=image.format, data=data), _IMAGE)


def decode_image(payload: bytes) -> CompressedImage:
    """Return the picture, still encoded; ROS's long formats ("rgb8; jpeg compressed bgr8") are understood.

    Raises:
        MessageError: It is malformed, empty, too big, or its first bytes are not those of its format.
    """
    message = _decode(payload, _IMAGE)
    stamp_ns = _decode_stamp(message)
    text = validate.name(message.format, what="format").lower().replace("jpg", "jpeg")
    kind = next((kind for kind in _IMAGE_MAGIC if kind in text), None)
    if kind is None:
        raise MessageError(f"image format is {message.format!r}: expected jpeg or png")
    if not 1 <= len(message.data) <= MAX_IMAGE_BYTES:
        raise MessageError(f"image of {len(message.data)} bytes: expected 1 to {MAX_IMAGE_BYTES}")
    data = message.data.tobytes()
    if not data.startswith(_IMAGE_MAGIC[kind]):
        raise MessageError(f"image starts with {data[:4].hex(' ')}: expected the first bytes of a {kind}")
    return CompressedImage(stamp_ns, kind, data)
