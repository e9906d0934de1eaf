"""Addresses of cameras: which kinds there are, and how they are shown without their credentials."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import SplitResult, parse_qsl, unquote, urlsplit

from revnm_client.errors import ConfigError, RevnmError
from revnm_client.keys import check_name

_EXPECTED = (
    "expected rtsp://HOST/PATH, rtsps://HOST/PATH, v4l2:///dev/video0[?size=1280x720&fps=30&format=mjpeg], "
    "file:///PATH[?loop=1&realtime=0] or zenoh://CAMERA"
)
_HIDDEN = "***"
_FORMATS = ("mjpeg", "h264", "yuyv422")
_LARGEST_PX = 16_384
_FASTEST_FPS = 240


@dataclass(frozen=True, slots=True)
class NetworkCamera:
    """A camera on the network.

    Attributes:
        url: Its address, credentials included: not for logs.
        redacted: Its address for people.
    """

    url: str
    redacted: str

    def __repr__(self) -> str:
        return f"NetworkCamera({self.redacted})"


@dataclass(frozen=True, slots=True)
class FileCamera:
    """A video file that stands in for a camera.

    Attributes:
        path: The file.
        loop: Begin again at the end.
        realtime: Play at the speed of the recording; else as fast as it decodes.
    """

    path: Path
    loop: bool
    realtime: bool


@dataclass(frozen=True, slots=True)
class DeviceCamera:
    """A camera at this computer, USB or other, of Video4Linux.

    Attributes:
        path: Its device.
        size_px: Width and height to ask for; None takes what it gives by itself.
        fps: Pictures a second to ask for.
        format: ``mjpeg``, ``h264`` or ``yuyv422``.
    """

    path: Path
    size_px: tuple[int, int] | None
    fps: int | None
    format: str | None


@dataclass(frozen=True, slots=True)
class ZenohCamera:
    """A camera that publishes JPEG pictures over Zenoh, such as the simulator's.

    Attributes:
        name: Its name in the key.
    """

    name: str


def redact(url: str) -> str:
    """Return the address without user, password and the values of its query, or of a path that looks like one.

    Some cameras want ``rtsp://HOST/user=admin&password=…``, some recorders ``rtsps://HOST/KEY``.
    """
    scheme, mark, rest = url.partition("://")
    try:
        parts = urlsplit(url)
        if "@" in rest and "@" not in parts.netloc and scheme != "file":
            # A password with / ? or # in it that is not percent-encoded.
            parts = urlsplit(f"{scheme}{mark}{_HIDDEN}@{rest.rpartition('@')[2]}")
    except ValueError:
        return _HIDDEN
    netloc = parts.netloc
    if "@" in netloc:
        netloc = f"{_HIDDEN}@{netloc.rpartition('@')[2]}"
    path, query = parts.path, parts.query
    if parts.scheme not in ("file", "v4l2"):
        path = re.sub(r"=[^&;/]*", f"={_HIDDEN}", path)
        path = re.sub(r"(?<=/)[A-Za-z0-9]{16,}(?=/|$)", _HIDDEN, path)
        query = "&".join(f"{item.partition('=')[0]}={_HIDDEN}" for item in query.split("&")) if query else ""
    return parts._replace(netloc=netloc, path=path, query=query).geturl()


def parse_camera_url(url: str) -> NetworkCamera | DeviceCamera | FileCamera | ZenohCamera:
    """Return what the address means.

    Raises:
        ConfigError: It is no address of a camera; the text hides credentials.
    """
    try:
        parts = urlsplit(url)
        if parts.scheme in ("rtsp", "rtsps") and parts.hostname and parts.port != 0:
            return NetworkCamera(url, redact(url))
        if parts.scheme == "file" and not parts.netloc and parts.path.startswith("/"):
            return _file(parts)
        if parts.scheme == "v4l2" and not parts.netloc and parts.path.startswith("/dev/"):
            return _device(parts)
        if parts.scheme == "zenoh" and "@" not in parts.netloc and not (parts.path or parts.query):
            return ZenohCamera(check_name(parts.netloc))
    except RevnmError as error:
        raise ConfigError(f"camera address {redact(url)}: {error}; {_EXPECTED}") from None
    except ValueError:  # its text would show parts of a password
        raise ConfigError(
            f"camera address {redact(url)!r} is malformed: percent-encode what is special in a password; {_EXPECTED}"
        ) from None
    raise ConfigError(f"camera address {redact(url)!r} is not understood: {_EXPECTED}")


def _file(parts: SplitResult) -> FileCamera:
    options = {"loop": "0", "realtime": "1"}
    for key, value in _options(parts):
        if key not in options or value not in ("0", "1"):
            raise ConfigError(f"option {key}={value}: expected loop or realtime, 0 or 1")
        options[key] = value
    return FileCamera(Path(unquote(parts.path)), loop=options["loop"] == "1", realtime=options["realtime"] == "1")


def _device(parts: SplitResult) -> DeviceCamera:
    size_px, fps, pixels = None, None, None
    for key, value in _options(parts):
        sides = re.fullmatch(r"([1-9]\d{1,4})x([1-9]\d{1,4})", value, re.ASCII)
        if key == "size" and sides is not None and max(int(sides[1]), int(sides[2])) <= _LARGEST_PX:
            size_px = int(sides[1]), int(sides[2])
        elif key == "fps" and re.fullmatch(r"[1-9]\d{0,2}", value, re.ASCII) and int(value) <= _FASTEST_FPS:
            fps = int(value)
        elif key == "format" and value in _FORMATS:
            pixels = value
        else:
            raise ConfigError(
                f"option {key}={value}: expected size=WIDTHxHEIGHT, fps=1 to {_FASTEST_FPS}, "
                f"or format={'|'.join(_FORMATS)}"
            )
    return DeviceCamera(Path(unquote(parts.path)), size_px, fps, pixels)


def _options(parts: SplitResult) -> list[tuple[str, str]]:
    return parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
