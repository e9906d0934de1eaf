"""Pictures to H.264, and H.264 to RTP packets (RFC 6184), as an IP camera does it."""

from __future__ import annotations

import secrets
import struct
import time
from collections.abc import Iterator
from fractions import Fraction

import av
import numpy as np
from numpy.typing import NDArray

CLOCK_HZ = 90_000
PAYLOAD_TYPE = 96
_MTU = 1400
_FU_A = 28

Picture = NDArray[np.uint8]


def size_px(picture: Picture) -> tuple[int, int]:
    """Return width and height of a picture, (H, W, 3) RGB or (H·3/2, W) YUV 4:2:0 planar."""
    height, width = picture.shape[:2]
    return width, height if picture.ndim == 3 else height * 2 // 3


class H264Encoder:
    """Encodes one viewer's pictures, without delay; the first is a key frame, and one a second after it.

    Args:
        size_px: Width and height of the pictures; both even.
        fps: About how many come a second.
    """

    def __init__(self, size_px: tuple[int, int], *, fps: float) -> None:
        encoder = av.CodecContext.create("libx264", "w")
        assert isinstance(encoder, av.VideoCodecContext)
        encoder.width, encoder.height = size_px
        encoder.pix_fmt = "yuv420p"
        encoder.framerate = Fraction(fps).limit_denominator(1000)
        encoder.time_base = 1 / encoder.framerate
        encoder.thread_count = 1
        parameters = f"repeat-headers=1:keyint={max(1, round(fps))}:annexb=1"
        encoder.options = {"preset": "ultrafast", "tune": "zerolatency", "qp": "20", "x264-params": parameters}
        self._encoder = encoder
        self._count = 0

    def encode(self, picture: Picture) -> list[bytes]:
        """Return the NAL units of a picture, (H, W, 3) RGB or (H·3/2, W) YUV 4:2:0 planar, contiguous."""
        if picture.ndim == 3:
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="yuv420p")
        else:
            frame = av.VideoFrame.from_numpy_buffer(picture, "yuv420p")  # without a copy: 20 ms at 4K
        frame.pts = self._count
        self._count += 1
        return [unit for packet in self._encoder.encode(frame) for unit in _units(bytes(packet))]


class RtpStream:
    """Numbers and stamps the packets of one viewer, and frames them for the RTSP connection (RFC 2326, 10.12)."""

    def __init__(self) -> None:
        self._source = secrets.randbits(32)
        self._sequence = secrets.randbits(16)
        self._base = secrets.randbits(31) - time.monotonic_ns() * CLOCK_HZ // 1_000_000_000

    def packets(self, units: list[bytes], *, taken_ns: int) -> bytes:
        """Return the packets of a picture's NAL units, ready to send; ``taken_ns`` is on the monotonic clock."""
        stamp = (self._base + taken_ns * CLOCK_HZ // 1_000_000_000) & 0xFFFFFFFF
        out = []
        for number, unit in enumerate(units):
            for payload, ends_unit in _payloads(unit):
                marker = 0x80 if ends_unit and number == len(units) - 1 else 0
                header = struct.pack("!BBHII", 0x80, PAYLOAD_TYPE | marker, self._sequence, stamp, self._source)
                self._sequence = (self._sequence + 1) & 0xFFFF
                out += [b"$\x00" + struct.pack("!H", len(header) + len(payload)), header, payload]
        return b"".join(out)


def _units(packet: bytes) -> list[bytes]:
    """Split a byte stream (H.264, annex B) into NAL units."""
    units = packet.replace(b"\x00\x00\x00\x01", b"\x00\x00\x01").split(b"\x00\x00\x01")
    return [unit.rstrip(b"\x00") for unit in units if unit.rstrip(b"\x00")]


def _payloads(unit: bytes) -> Iterator[tuple[bytes, bool]]:
    """Yield RTP payloads of a NAL unit, and whether each is its last; a big one goes in fragments (FU-A)."""
    if len(unit) <= _MTU:
        yield unit, True
        return
    indicator, kind = (unit[0] & 0xE0) | _FU_A, unit[0] & 0x1F
    for start in range(1, len(unit), _MTU):
        last = start + _MTU >= len(unit)
        flags = (0x80 if start == 1 else 0) | (0x40 if last else 0)
        yield bytes([indicator, flags | kind]) + unit[start : start + _MTU], last
