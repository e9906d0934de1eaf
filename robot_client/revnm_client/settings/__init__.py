"""The robot's settings: options of the command over environment (``REVNM_ROBOT__…``) over a YAML file over a profile.

Each component is given its own section, never the whole. Unknown keys are errors; an error names file, line and
key. Imports ruamel.yaml and the standard library, and what the settings are for.
"""

from revnm_client.settings.loading import BadSettingsError, load_settings
from revnm_client.settings.root import (
    BrakingSettings,
    DriverSettings,
    FootprintSettings,
    LidarSettings,
    Limits,
    LogSettings,
    RobotSettings,
    SafetySettings,
    SecuritySettings,
)

__all__ = [
    "BadSettingsError",
    "BrakingSettings",
    "DriverSettings",
    "FootprintSettings",
    "LidarSettings",
    "Limits",
    "LogSettings",
    "RobotSettings",
    "SafetySettings",
    "SecuritySettings",
    "load_settings",
]
