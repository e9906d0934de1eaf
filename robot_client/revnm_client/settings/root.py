"""All settings together, as plain checked data, and as a text that gives them again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from revnm_client.credentials import Credentials, read_password
from revnm_client.geometry import Pose2
from revnm_client.messages import Mounting


@dataclass(frozen=True, slots=True)
class DriverSettings:
    """What carries scans, odometry and velocities.

    Attributes:
        kind: ``zenoh``, ``rmw_zenoh``, ``kachaka``, or ``package.module:Class``.
        options: Of that driver.
    """

    kind: str = "zenoh"
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Limits:
    """What is asked of the base at most: speed, turning rate, and how fast they change."""

    max_v_mps: float
    max_w_radps: float
    max_a_mps2: float
    max_alpha_radps2: float


@dataclass(frozen=True, slots=True)
class FootprintSettings:
    """The robot's outline: see :class:`revnm_client.mppi.Footprint`."""

    length_m: float
    width_m: float
    center_x_m: float = 0.0


@dataclass(frozen=True, slots=True)
class LidarSettings:
    """Where the LiDAR sits, from the point that the robot turns about, and where its beam of angle 0 looks.

    ``zero_is_open``: see :class:`revnm_client.messages.Mounting`.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    zero_is_open: bool = False

    @property
    def mounting(self) -> Mounting:
        """How the LiDAR is mounted."""
        return Mounting(Pose2(self.x_m, self.y_m, self.yaw_rad), self.zero_is_open)


@dataclass(frozen=True, slots=True)
class BrakingSettings:
    """How the robot stops: see :class:`revnm_client.braking.BrakingConfig`."""

    delay_s: float
    braking_mps2: float
    braking_radps2: float
    margin_m: float


@dataclass(frozen=True, slots=True)
class SafetySettings:
    """How old what the robot drives by may be."""

    max_plan_age_s: float = 0.5
    max_scan_age_s: float = 0.3
    max_odometry_age_s: float = 0.3


@dataclass(frozen=True, slots=True)
class LogSettings:
    """The log, on standard error: lines for people, or a JSON object a line for whoever collects them."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["text", "json"] = "text"


@dataclass(frozen=True, slots=True)
class SecuritySettings:
    """By what the robot knows its server, and how it shows who it is.

    Attributes:
        authority: PEM file of the authority whose servers are trusted; for ``tls/`` endpoints.
        certificate: PEM file with the robot's name, and ``key``.
        key: PEM file, private.
        password_file: Holds the password with which the robot logs in, by its name, where it has no certificate.
    """

    authority: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    password_file: Path | None = None

    def credentials(self, robot: str) -> Credentials:
        """Return what is shown to the server.

        Raises:
            FileError: The password cannot be read.
        """
        password = None if self.password_file is None else read_password(self.password_file)
        return Credentials(self.authority, self.certificate, self.key, user=robot, password=password)


@dataclass(frozen=True, slots=True)
class RobotSettings:
    """Everything that can be set.

    Attributes:
        robot: Name, as the server knows it.
        server: Endpoints of the server's router; the first that answers is taken.
        security: By what the robot knows its server, and how it shows who it is.
        profile: The kind of robot that gave what was not set.
        driver: What carries scans, odometry and velocities.
        limits: What is asked of the base at most.
        footprint: The robot's outline.
        lidar: Where the LiDAR sits.
        braking: How the robot stops.
        safety: How old what the robot drives by may be.
        log: The log.
    """

    robot: str
    server: tuple[str, ...]
    security: SecuritySettings
    profile: str
    driver: DriverSettings
    limits: Limits
    footprint: FootprintSettings
    lidar: LidarSettings
    braking: BrakingSettings
    safety: SafetySettings
    log: LogSettings

    def as_yaml(self) -> str:
        """Return a settings file that says everything that is in effect, a section a line."""
        security = {key: str(path.absolute()) for key, path in asdict(self.security).items() if path is not None}
        driver = {"kind": self.driver.kind, **self.driver.options}
        sections = {**asdict(self), "security": security, "driver": driver}
        return "".join(f"{key}: {_flow(value)}\n" for key, value in sections.items())


def _flow(value: Any) -> str:
    """Write a value as YAML on one line, with quotation marks only where it needs them."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_flow(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_flow(each) for each in value) + "]"
    if isinstance(value, str) and value.isidentifier() and value not in ("true", "false", "null"):
        return value
    return json.dumps(value, ensure_ascii=False)
