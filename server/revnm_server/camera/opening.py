"""Opens a camera by its address."""

from __future__ import annotations

import zenoh

from revnm_server.camera.pyav_reader import PyavReader
from revnm_server.camera.source import CameraSource
from revnm_server.camera.url import ZenohCamera, parse_camera_url
from revnm_server.camera.zenoh_reader import ZenohReader


def open_camera(url: str, session: zenoh.Session) -> CameraSource:
    """Start to read the camera at ``url``; whether it answers is told by its status.

    Args:
        url: ``rtsp://…``, ``v4l2:///dev/video0``, ``file:///…?loop=1&realtime=1`` or ``zenoh://<camera>``;
            see :mod:`revnm_server.camera.url`.
        session: For cameras that publish over Zenoh.

    Raises:
        ConfigError: The address is malformed.
    """
    camera = parse_camera_url(url)
    if isinstance(camera, ZenohCamera):
        return ZenohReader(session, camera.name)
    return PyavReader(camera)
