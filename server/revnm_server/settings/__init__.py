"""The server's settings: command line over environment (``REVNM_…``) over secrets over a YAML file over defaults.

Each component is given its own section, never the whole. Unknown keys are errors; an error names file, line and
key.
"""

from revnm_server.settings.address import is_loopback
from revnm_server.settings.camera import CameraSettings
from revnm_server.settings.depth import DepthSettings
from revnm_server.settings.http import HttpSettings
from revnm_server.settings.loading import BadSettingsError, load_settings
from revnm_server.settings.logs import LogSettings
from revnm_server.settings.perception import PerceptionSettings
from revnm_server.settings.recording import RecordingSettings
from revnm_server.settings.root import Settings
from revnm_server.settings.zenoh import ZenohSettings

__all__ = [
    "BadSettingsError",
    "CameraSettings",
    "DepthSettings",
    "HttpSettings",
    "LogSettings",
    "PerceptionSettings",
    "RecordingSettings",
    "Settings",
    "ZenohSettings",
    "is_loopback",
    "load_settings",
]
