"""The server's settings: command line over environment (``REVNM_…``) over a YAML file over defaults.

Each component is given its own section, never the whole. Unknown keys are errors; an error names file, line and
key.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
import yaml
from pydantic_settings import (
    BaseSettings,
    InitSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    SettingsError,
)

from revnm_client.errors import ConfigError, FileError, RevnmError
from revnm_client.keys import check_name
from revnm_server.camera.url import parse_camera_url, redact

_TAGS_OF_36H11 = 587


class Section(pydantic.BaseModel):
    """A part of the settings; unknown keys are errors."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CameraSettings(Section):
    """The camera on the wall; ``name`` is that of the file in which its calibration is kept."""

    url: str = "zenoh://camera"
    name: str = "camera"

    def __repr__(self) -> str:
        return f"CameraSettings(url={redact(self.url)!r}, name={self.name!r})"

    @pydantic.field_validator("url")
    @classmethod
    def _understood(cls, url: str) -> str:
        _reraised(parse_camera_url, url)
        return url

    @pydantic.field_validator("name")
    @classmethod
    def _named(cls, name: str) -> str:
        _reraised(check_name, name)
        return name


class ZenohSettings(Section):
    """The router's endpoints."""

    listen: Annotated[tuple[str, ...], pydantic.Field(min_length=1)] = ("tcp/127.0.0.1:7447",)


def is_loopback(host: str) -> bool:
    """Return whether a host's name or address means this machine and nothing else; rubbish does not."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class HttpSettings(Section):
    """Where the page and the API are, and who may see them.

    ``token`` is asked of everyone when it is set; an address that others can reach needs it, or ``insecure``.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, pydantic.Field(ge=0, le=65535)] = 8000
    token: Annotated[pydantic.SecretStr, pydantic.Field(min_length=16, max_length=256)] | None = None
    insecure: bool = False

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return is_loopback(self.host)

    @pydantic.field_validator("token")
    @classmethod
    def _printable(cls, token: pydantic.SecretStr | None) -> pydantic.SecretStr | None:
        if token is not None and not (token.get_secret_value().isascii() and token.get_secret_value().isalnum()):
            raise ValueError("expected ASCII letters and digits only")
        return token

    @pydantic.model_validator(mode="after")
    def _guarded(self) -> HttpSettings:
        if not self.loopback and self.token is None and not self.insecure:
            raise ValueError(
                f"{self.host} can be reached by others: set a token (REVNM_HTTP__TOKEN), "
                "or say --insecure-http if anyone there may drive the robots"
            )
        return self


class PerceptionSettings(Section):
    """What makes plans, the models and how they are run, and what robots look like.

    ``planner`` is ``revnm``, the bundle's policy, or ``bev``, a search on the map that the camera's own calibration
    makes; that one needs ``tag_height_m``, the height of the tags over the floor, and the body of a robot, the
    tag in its middle. ``calibration_dir`` keeps what it learnt over a restart.
    """

    planner: Literal["revnm", "bev"] = "revnm"
    bundle: Path | None = None
    threads: Annotated[int, pydantic.Field(ge=1, le=64)] = 2
    tick_hz: Annotated[float, pydantic.Field(gt=0.0, le=60.0)] = 10.0
    max_sighting_age_s: Annotated[float, pydantic.Field(gt=0.0, le=1.0)] = 1.0
    tag_size_m: Annotated[float, pydantic.Field(gt=0.0, le=2.0)] = 0.30
    tag_height_m: Annotated[float, pydantic.Field(ge=0.0, le=3.0)] = 0.14
    robot_length_m: Annotated[float, pydantic.Field(gt=0.0, le=5.0)] = 0.43
    robot_width_m: Annotated[float, pydantic.Field(gt=0.0, le=5.0)] = 0.36
    calibration_dir: Path | None = None


class Settings(BaseSettings):
    """Everything that can be set.

    ``robots`` maps names to the ids of their AprilTags (36h11); ``state_file`` keeps goals over a restart.
    """

    model_config = SettingsConfigDict(
        env_prefix="REVNM_", env_nested_delimiter="__", extra="forbid", frozen=True, allow_inf_nan=False
    )

    camera: CameraSettings = CameraSettings()
    zenoh: ZenohSettings = ZenohSettings()
    http: HttpSettings = HttpSettings()
    perception: PerceptionSettings = PerceptionSettings()
    robots: dict[str, Annotated[int, pydantic.Field(ge=0, lt=_TAGS_OF_36H11)]] = {"rover": 0}
    state_file: Path | None = None

    @pydantic.field_validator("robots")
    @classmethod
    def _distinct(cls, robots: dict[str, int]) -> dict[str, int]:
        for name in robots:
            _reraised(check_name, name)
        if not robots or len(set(robots.values())) != len(robots):
            raise ValueError("expected at least one robot, each with a tag of its own")
        return robots


def load_settings(config: Path | None = None, *, overrides: Mapping[str, Any] | None = None) -> Settings:
    """Return the settings.

    Args:
        config: A YAML file, or None.
        overrides: What the command line says, nested as in the file; it wins.

    Raises:
        FileError: The file cannot be read or is no YAML mapping.
        ConfigError: A value is wrong; the text says where it stands.
    """
    in_file, lines = _read(config) if config is not None else ({}, {})

    class Layered(Settings):
        @classmethod
        def settings_customise_sources(
            cls,
            settings_cls: type[BaseSettings],
            init_settings: PydanticBaseSettingsSource,
            env_settings: PydanticBaseSettingsSource,
            dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003
            file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            return init_settings, env_settings, InitSettingsSource(settings_cls, in_file)

    try:
        return Layered(**(overrides or {}))
    except pydantic.ValidationError as error:
        problems = error.errors(include_url=False, include_input=False, include_context=False)
        texts = [_where(problem["loc"], config, lines) + problem["msg"] for problem in problems]
        raise ConfigError("; ".join(texts)) from None  # pydantic's own text would show the values
    except SettingsError as error:
        raise ConfigError(f"settings: {error}") from None  # an environment variable that is no JSON


def _read(path: Path) -> tuple[dict[str, Any], dict[tuple[str, ...], int]]:
    """Return the file's content, and the line of each key by its path."""
    try:
        text = path.read_text()
        content = yaml.safe_load(text)
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise FileError(f"settings {path}: {error}") from error
    if content is None:
        return {}, {}
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise FileError(f"settings {path}: expected a mapping of names to values")
    return content, dict(_lines(root, ()))


def _lines(node: yaml.Node | None, path: tuple[str, ...]) -> list[tuple[tuple[str, ...], int]]:
    if not isinstance(node, yaml.MappingNode):
        return []
    found = []
    for key, value in node.value:
        place = (*path, str(key.value))
        found += [(place, key.start_mark.line + 1), *_lines(value, place)]
    return found


def _where(loc: Sequence[str | int], config: Path | None, lines: Mapping[tuple[str, ...], int]) -> str:
    path = tuple(str(part) for part in loc)
    place = next((lines[path[:end]] for end in range(len(path), 0, -1) if path[:end] in lines), None)
    key = ".".join(path)
    return f"{config}:{place}: {key}: " if place is not None else f"{key}: "


def _reraised(check: Any, value: str) -> None:
    """Run one of our checks inside pydantic, which understands ValueError only."""
    try:
        check(value)
    except RevnmError as error:
        raise ValueError(str(error)) from None
