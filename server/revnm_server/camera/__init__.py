"""Cameras: whatever is on the wall becomes the newest frame and a state that says whether to trust it."""

from revnm_server.camera.opening import open_camera
from revnm_server.camera.source import CameraSource, CameraState, CameraStatus

__all__ = ["CameraSource", "CameraState", "CameraStatus", "open_camera"]
