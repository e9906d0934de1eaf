"""ROS 2 messages (CDR) that only a record has; those on the wire are :mod:`revnm_client.cdr`'s.

Encoding here trusts what it is given: it comes from the server itself.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from revnm_client.errors import MessageError
from revnm_client.geometry import FloatArray, Pose2
from revnm_server.floor_camera import FloorCamera, rotation

_NS_PER_S = 1_000_000_000


class Level:
    """Levels of a diagnostic status."""

    OK, WARN, ERROR, STALE = 0, 1, 2, 3


class Transform(NamedTuple):
    """Where a frame lies in its parent.

    Attributes:
        parent: Name of the parent frame.
        child: Name of the frame.
        translation_m: (x, y, z).
        quaternion: (x, y, z, w).
    """

    parent: str
    child: str
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    @classmethod
    def planar(cls, parent: str, child: str, parent_from_child: Pose2) -> Transform:
        """Return the transform of a pose in the plane."""
        return cls(parent, child, (parent_from_child.x_m, parent_from_child.y_m, 0.0), _turn(parent_from_child.yaw_rad))

    @classmethod
    def of_camera(cls, parent: str, child: str, camera: FloorCamera) -> Transform:
        """Return where the optical frame (right, down, ahead) of a camera lies in its floor frame."""
        return cls(parent, child, (0.0, 0.0, camera.height_m), quaternion(rotation(camera.vector)))


class Status(NamedTuple):
    """A diagnostic status: ``level`` is one of :class:`Level`."""

    name: str
    level: int
    message: str
    values: Mapping[str, object]


@functools.cache
def type_store() -> Typestore:
    """Return the ROS 2 types; made at the first use, since that takes some 50 ms."""
    return get_typestore(Stores.ROS2_JAZZY)


def image_message(image: NDArray[np.float32] | NDArray[np.uint16], *, stamp_ns: int, frame: str) -> bytes:
    """Return a picture (h, w) as sensor_msgs/Image, 32FC1 or 16UC1."""
    height, width = image.shape
    message = _make(
        "sensor_msgs/msg/Image",
        header=_header(stamp_ns, frame),
        height=height,
        width=width,
        encoding="32FC1" if image.dtype == np.float32 else "16UC1",
        is_bigendian=0,
        step=width * image.itemsize,
        data=np.ascontiguousarray(image).view(np.uint8).reshape(-1),
    )
    return _encode(message)


def jpeg_message(jpeg: bytes, *, stamp_ns: int, frame: str) -> bytes:
    """Return an encoded picture as sensor_msgs/CompressedImage."""
    data = np.frombuffer(jpeg, dtype=np.uint8)
    return _encode(_make("sensor_msgs/msg/CompressedImage", header=_header(stamp_ns, frame), format="jpeg", data=data))


def camera_message(camera: FloorCamera, *, stamp_ns: int, frame: str) -> bytes:
    """Return what is known of a camera as sensor_msgs/CameraInfo, without its distortion: ROS has no such model."""
    width, height = camera.size_px
    u, v, focal = (width - 1) / 2.0, (height - 1) / 2.0, camera.focal_px
    message = _make(
        "sensor_msgs/msg/CameraInfo",
        header=_header(stamp_ns, frame),
        height=height,
        width=width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array([focal, 0.0, u, 0.0, focal, v, 0.0, 0.0, 1.0]),
        r=np.eye(3).reshape(-1),
        p=np.array([focal, 0.0, u, 0.0, 0.0, focal, v, 0.0, 0.0, 0.0, 1.0, 0.0]),
        binning_x=0,
        binning_y=0,
        roi=_make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )
    return _encode(message)


def transforms_message(transforms: Sequence[Transform], *, stamp_ns: int) -> bytes:
    """Return transforms of one moment as tf2_msgs/TFMessage."""
    stamped = [
        _make(
            "geometry_msgs/msg/TransformStamped",
            header=_header(stamp_ns, each.parent),
            child_frame_id=each.child,
            transform=_make(
                "geometry_msgs/msg/Transform",
                translation=_vector("Vector3", *each.translation_m),
                rotation=_quaternion(*each.quaternion),
            ),
        )
        for each in transforms
    ]
    return _encode(_make("tf2_msgs/msg/TFMessage", transforms=stamped))


def pose_message(point_m: FloatArray, *, stamp_ns: int, frame: str) -> bytes:
    """Return a place (2,) on the floor as geometry_msgs/PoseStamped, whose heading means nothing."""
    return _encode(_pose(point_m, _header(stamp_ns, frame)))


def path_message(points_m: FloatArray, *, stamp_ns: int, frame: str) -> bytes:
    """Return places (P, 2) on the floor as nav_msgs/Path, whose headings mean nothing."""
    header = _header(stamp_ns, frame)
    return _encode(_make("nav_msgs/msg/Path", header=header, poses=[_pose(point, header) for point in points_m]))


def point_message(point: tuple[float, float], *, stamp_ns: int, frame: str) -> bytes:
    """Return two numbers as geometry_msgs/PointStamped."""
    header = _header(stamp_ns, frame)
    return _encode(_make("geometry_msgs/msg/PointStamped", header=header, point=_vector("Point", *point, 0.0)))


def string_message(text: str) -> bytes:
    """Return text as std_msgs/String."""
    return _encode(_make("std_msgs/msg/String", data=text))


def diagnostics_message(statuses: Sequence[Status], *, stamp_ns: int) -> bytes:
    """Return statuses as diagnostic_msgs/DiagnosticArray."""
    listed = [
        _make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=each.level,
            name=each.name,
            message=each.message,
            hardware_id="",
            values=[
                _make("diagnostic_msgs/msg/KeyValue", key=key, value="" if value is None else str(value))
                for key, value in each.values.items()
            ],
        )
        for each in statuses
    ]
    return _encode(_make("diagnostic_msgs/msg/DiagnosticArray", header=_header(stamp_ns, ""), status=listed))


def log_message(text: str, *, stamp_ns: int, level: int, name: str) -> bytes:
    """Return a line of the log as rcl_interfaces/Log, whose levels are those of Python's logging."""
    stamp = _stamp(stamp_ns)
    return _encode(
        _make("rcl_interfaces/msg/Log", stamp=stamp, level=level, name=name, msg=text, file="", function="", line=0)
    )


def read_string(payload: bytes) -> str:
    """Return the text of a std_msgs/String.

    Raises:
        MessageError: It is none.
    """
    return str(_decode(payload, "std_msgs/msg/String").data)


def check_message(payload: bytes, type_name: str) -> None:
    """Check that a payload from the wire is a message of a type, whatever it says.

    Raises:
        MessageError: It is none.
    """
    _decode(payload, type_name)


def frames_of(payload: bytes, type_name: str) -> tuple[str, ...]:
    """Return the frame in a message's header, and the child frame where it has one.

    Raises:
        MessageError: It is malformed.
    """
    message = _decode(payload, type_name)
    child = getattr(message, "child_frame_id", None)
    return (message.header.frame_id,) if child is None else (message.header.frame_id, child)


def quaternion(matrix: FloatArray) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w) of a rotation (3, 3): the largest of its four forms is well conditioned.

    Shepperd's method (DOI 10.2514/3.55767b).
    """
    trace = float(np.trace(matrix))
    squares = [1.0 + 2.0 * float(matrix[i, i]) - trace for i in range(3)] + [1.0 + trace]
    largest = int(np.argmax(squares))
    twice = math.sqrt(squares[largest])
    if largest == 3:
        parts = [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1], twice * twice]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        parts = [0.0, 0.0, 0.0, float(matrix[k, j] - matrix[j, k])]
        parts[i] = twice * twice
        parts[j], parts[k] = matrix[j, i] + matrix[i, j], matrix[k, i] + matrix[i, k]
    x, y, z, w = (float(part) / (2.0 * twice) for part in parts)
    return x, y, z, w


def _turn(yaw_rad: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad)


def _make(type_name: str, **fields: Any) -> Any:
    return type_store().types[type_name](**fields)


def _stamp(stamp_ns: int) -> Any:
    sec, nanosec = divmod(stamp_ns, _NS_PER_S)
    return _make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)


def _header(stamp_ns: int, frame: str) -> Any:
    return _make("std_msgs/msg/Header", stamp=_stamp(stamp_ns), frame_id=frame)


def _vector(kind: str, x: float, y: float, z: float) -> Any:
    return _make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _quaternion(x: float, y: float, z: float, w: float) -> Any:
    return _make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _pose(point_m: FloatArray, header: Any) -> Any:
    position = _vector("Point", float(point_m[0]), float(point_m[1]), 0.0)
    pose = _make("geometry_msgs/msg/Pose", position=position, orientation=_quaternion(*_turn(0.0)))
    return _make("geometry_msgs/msg/PoseStamped", header=header, pose=pose)


def _encode(message: Any) -> bytes:
    return bytes(type_store().serialize_cdr(message, message.__msgtype__, little_endian=True))


def _decode(payload: bytes, type_name: str) -> Any:
    try:
        return type_store().deserialize_cdr(payload, type_name)
    except SerdeError as error:
        raise MessageError(f"{type_name}: {error}") from error
