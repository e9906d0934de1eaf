"""The part of Kachaka's gRPC interface that the driver uses.

The interface is pf-robotics/kachaka-api, ``protos/kachaka-api.proto``; names, types and numbers here are its own. The
package kachaka-api is not used on the robot: it demands one old version of grpcio, which has no wheels for Python 3.13
and newer. The tests hold this against its published stubs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

try:
    import grpc
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
except ImportError as error:
    raise ImportError(f"{error}: pip install './robot_client[kachaka]'") from error

NOT_IN_MANUAL_MODE = 13151
PORT = 26400

_PACKAGE = "kachaka_api"
_MESSAGES = {  # name: fields, each with type, name and number; * repeats
    "Metadata": "sfixed64 cursor 1",
    "Result": "bool success 1, int32 error_code 3",
    "RosHeader": "int64 stamp_nsec 1, string frame_id 2",
    "Vector3": "double x 1, double y 2, double z 3",
    "Quaternion": "double x 1, double y 2, double z 3, double w 4",
    "Pose3d": "Vector3 position 1, Quaternion orientation 2",
    "Pose3dWithCovariance": "Pose3d pose 1",
    "Twist": "Vector3 linear 1, Vector3 angular 2",
    "TwistWithCovariance": "Twist twist 1",
    "RosOdometry": "RosHeader header 1, Pose3dWithCovariance pose 3, TwistWithCovariance twist 4",
    "RosLaserScan": "RosHeader header 1, double angle_min 2, double angle_increment 4, double range_min 7, "
    "double range_max 8, *double ranges 9",
    "GetRequest": "Metadata metadata 1",
    "GetRosLaserScanResponse": "Metadata metadata 1, RosLaserScan scan 2",
    "GetRosOdometryResponse": "Metadata metadata 1, RosOdometry odometry 2",
    "GetErrorResponse": "Metadata metadata 1, *int32 error_codes 2",
    "SetManualControlEnabledRequest": "bool enable 1",
    "SetRobotVelocityRequest": "double linear 1, double angular 2",
    "ActivateLaserScanRequest": "double duration_sec 1",
    "ResultResponse": "Result result 1",
}
_CALLS = {  # name: request, response
    "GetRosLaserScan": ("GetRequest", "GetRosLaserScanResponse"),
    "GetRosOdometry": ("GetRequest", "GetRosOdometryResponse"),
    "GetError": ("GetRequest", "GetErrorResponse"),
    "SetManualControlEnabled": ("SetManualControlEnabledRequest", "ResultResponse"),
    "SetRobotVelocity": ("SetRobotVelocityRequest", "ResultResponse"),
    "ActivateLaserScan": ("ActivateLaserScanRequest", "ResultResponse"),
}
_RECONNECT = [
    (f"grpc.{which}_reconnect_backoff_ms", ms) for which, ms in (("initial", 200), ("min", 200), ("max", 2000))
]


class KachakaApi:
    """The calls, each with a deadline; they raise grpc.RpcError and nothing else. Thread-safe."""

    def __init__(self, address: str) -> None:
        """Connect in the background, and again whenever the robot is gone.

        Args:
            address: ``host:port``.
        """
        self._channel = grpc.insecure_channel(address, options=_RECONNECT)
        self._classes = message_classes()
        self._calls = {name: self._call(name) for name in _CALLS}

    def get(self, name: str, cursor: int, *, timeout_s: float) -> Any:
        """Return what is newer than ``cursor``, as soon as there is something; 0: what there is now."""
        request = self._classes["GetRequest"](metadata={"cursor": cursor})
        return self._calls[name](request, timeout=timeout_s)

    def set(self, name: str, *, timeout_s: float, **fields: float) -> Any:
        """Return the robot's ``Result`` for an order."""
        request = self._classes[_CALLS[name][0]](**fields)
        return self._calls[name](request, timeout=timeout_s).result

    def close(self) -> None:
        """Disconnect; calls under way fail."""
        self._channel.close()

    def _call(self, name: str) -> Callable[..., Any]:
        request, response = (self._classes[message] for message in _CALLS[name])
        call: Callable[..., Any] = self._channel.unary_unary(
            f"/{_PACKAGE}.KachakaApi/{name}",
            request_serializer=request.SerializeToString,
            response_deserializer=response.FromString,
        )
        return call


def message_classes() -> dict[str, Any]:
    """Return the classes of the messages, in a pool of their own: the published stubs may be loaded, too."""
    file = descriptor_pb2.FileDescriptorProto(name="revnm/kachaka.proto", package=_PACKAGE, syntax="proto3")
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for words in fields.split(", "):
            _add_field(message, *words.split())
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.{name}")) for name in _MESSAGES
    }


def _add_field(message: Any, kind: str, name: str, number: str) -> None:
    field = message.field.add(name=name, number=int(number))
    field.label = field.LABEL_REPEATED if kind.startswith("*") else field.LABEL_OPTIONAL
    kind = kind.removeprefix("*")
    if kind in _MESSAGES:
        field.type, field.type_name = field.TYPE_MESSAGE, f".{_PACKAGE}.{kind}"
    else:
        field.type = field.Type.Value(f"TYPE_{kind.upper()}")
