"""Opens what FFmpeg can read, and says what went wrong in words that help, without credentials.

Measured: ``fflags=nobuffer`` throws away what was read to find out about the stream, the first key frame included, and
so costs a key-frame interval; without it and without probing the first picture of an RTSP stream is there after 0.1 s.
"""

from __future__ import annotations

import errno
import time

import av
from av.container import InputContainer
from av.video.stream import VideoStream

from revnm_client.errors import RevnmError
from revnm_server.camera.jpeg import MAX_PIXELS
from revnm_server.camera.url import DeviceCamera, FileCamera, NetworkCamera

StreamSource = NetworkCamera | DeviceCamera | FileCamera

_HANDSHAKE_S = 3.0
_NO_PROBING = {"analyzeduration": "0", "probesize": "32", "fpsprobesize": "0"}
_NETWORK_OPTIONS = {
    **_NO_PROBING,
    "rtsp_transport": "tcp",
    "allowed_media_types": "video",
    "protocol_whitelist": "rtsp,rtp,tcp,udp,tls,crypto",
}
_FILE_OPTIONS = {"protocol_whitelist": "file"}
_DEVICE_TROUBLES = {
    errno.ENOENT: "no such device: is the camera plugged in?",
    errno.ENODEV: "no such device: was the camera unplugged?",
    errno.EACCES: "permission denied: is the user in the group video?",
    errno.EPERM: "permission denied: is the user in the group video?",
    errno.EBUSY: "another program uses it",
    errno.ENOTTY: "it is no camera",
}


class StreamError(RevnmError):
    """A stream that can be read and is no use: no pictures in it, or their time stamps stand."""


def open_stream(source: StreamSource, *, timeout_s: float) -> InputContainer:
    """Open a stream, a device or a file; it must be closed.

    Args:
        source: Which.
        timeout_s: Longest wait for an answer from the network, at each step.

    Raises:
        StreamError: What comes is no picture, or a device gives another size than was asked for.
        OSError: FFmpeg could not open it; :func:`explain` puts that into words.
    """
    if isinstance(source, FileCamera):
        return av.open(str(source.path), options=_FILE_OPTIONS)
    if isinstance(source, DeviceCamera):
        return _open_device(source)
    return _open_network(source, timeout_s)


def video_stream(container: InputContainer) -> VideoStream:
    """Return the stream with the pictures, set up to decode at once what comes.

    Raises:
        StreamError: There is none, or it cannot be decoded here.
    """
    if not container.streams.video:
        raise StreamError("there are no pictures in it, only sound or data")
    stream = container.streams.video[0]
    if stream.codec_context is None:
        raise StreamError("its pictures are of a codec that is not known here: set the camera to H.264")
    stream.thread_type = "SLICE"  # threads for whole pictures would each hold one back
    stream.codec_context.options = {"max_pixels": str(MAX_PIXELS), "flags": "low_delay"}
    return stream


def explain(error: Exception, source: StreamSource) -> str:
    """Return what went wrong, for a person, without the address: FFmpeg repeats it with its password."""
    if isinstance(error, av.error.HTTPUnauthorizedError | av.error.HTTPForbiddenError):
        return "the camera refuses the login: check user and password"
    if isinstance(error, av.error.HTTPNotFoundError):
        return "the camera has no such stream: check the path in its address"
    if isinstance(error, RevnmError):
        return str(error)
    if not isinstance(error, OSError | av.FFmpegError) or not error.strerror:
        return type(error).__name__
    if isinstance(source, DeviceCamera):
        return f"{source.path}: {_DEVICE_TROUBLES.get(error.errno or 0, error.strerror)}"
    return error.strerror


def unreadable(source: StreamSource) -> str:
    """Return what to tell where data comes and nothing can be decoded from it."""
    if isinstance(source, DeviceCamera):
        return f"{source.path}: what it gives is no picture with {_asked(source)}; {_list(source)}"
    return "no picture can be decoded from it: is it of the codec that the camera says?"


def _open_network(source: NetworkCamera, timeout_s: float) -> InputContainer:
    began_s, limit_s = time.monotonic(), max(_HANDSHAKE_S, timeout_s)
    options = _NETWORK_OPTIONS | {"timeout": str(round(timeout_s * 1e6))}
    container = av.open(source.url, options=options, timeout=(limit_s, timeout_s))
    if time.monotonic() - began_s >= limit_s:  # cut short; where nothing came at all, the time-out was earlier
        codecs = ", ".join(stream.codec_context.name for stream in container.streams.video if stream.codec_context)
        container.close()
        raise StreamError(f"data comes and no picture: is it of the codec that the camera says ({codecs or 'none'})?")
    return container


def _open_device(source: DeviceCamera) -> InputContainer:
    """Open a camera of Video4Linux; what it cannot give it replaces silently, so that is checked."""
    options = dict(_NO_PROBING)
    if source.size_px is not None:
        options["video_size"] = f"{source.size_px[0]}x{source.size_px[1]}"
    if source.fps is not None:
        options["framerate"] = str(source.fps)
    if source.format is not None:
        options["input_format"] = source.format
    try:
        container = av.open(str(source.path), format="video4linux2", options=options)
    except av.FFmpegError as error:
        if error.errno != errno.EINVAL:
            raise
        raise StreamError(f"{source.path}: it refuses {_asked(source)}; {_list(source)}") from None
    context = container.streams.video[0].codec_context
    if source.size_px is not None and (context.width, context.height) != source.size_px:
        given = f"{context.width}x{context.height}"
        container.close()
        raise StreamError(f"{source.path}: it gives {given} for {_asked(source)}; {_list(source)}")
    return container


def _asked(source: DeviceCamera) -> str:
    size = f"{source.size_px[0]}x{source.size_px[1]}" if source.size_px is not None else None
    named = {"size": size, "fps": source.fps, "format": source.format}
    return ", ".join(f"{key}={value}" for key, value in named.items() if value is not None) or "what it gives by itself"


def _list(source: DeviceCamera) -> str:
    return f"v4l2-ctl -d {source.path} --list-formats-ext shows what it can"
