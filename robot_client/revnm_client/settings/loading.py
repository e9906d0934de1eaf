"""Reads settings from options, environment and file, and says where what is wrong stands."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from revnm_client.errors import ConfigError, FileError
from revnm_client.settings.coherence import contradictions
from revnm_client.settings.document import Place, YamlDocument, dotted
from revnm_client.settings.layout import CUSTOM, NEEDED_BY_CUSTOM, ROOT
from revnm_client.settings.profiles import CAUTIOUS, PROFILES
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

_PREFIX = "REVNM_ROBOT__"
_NESTED = "__"
_WITHOUT_FILE = {"profile": "megarover", "server": "tcp/127.0.0.1:7447"}
_OPTIONS = {"robot": "--robot", "server": "--connect"}


class BadSettingsError(ConfigError):
    """Settings are wrong.

    Attributes:
        problems: What is wrong, a line each: where it stands, the key, the value, what was expected.
    """

    def __init__(self, problems: list[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class _Layers:
    """What file, environment and options say, merged; knows who said what."""

    def __init__(self, document: YamlDocument | None) -> None:
        self.data: dict[str, Any] = dict(_WITHOUT_FILE) if document is None else _mapping(document)
        self._document = document
        self._sources: dict[Place, str] = {}

    def lay(self, source: str, place: tuple[str, ...], value: Any) -> None:
        """Let a source say the value of a place, over what was said before; mappings are merged key by key."""
        if isinstance(value, dict) and value:
            for key, inner in value.items():
                self.lay(source, (*place, key), inner)
            return
        inside = self.data
        for key in place[:-1]:
            if not isinstance(inside.get(key), dict):
                inside[key] = {}
            inside = inside[key]
        inside[place[-1]] = value
        self._sources[place] = source

    def where(self, place: Place) -> str:
        """Return who said the value of a place, with a colon; nothing where nobody did."""
        for end in range(len(place), 0, -1):
            if place[:end] in self._sources:
                return f"{self._sources[place[:end]]}: "
        return "" if self._document is None else f"{self._document.where(place)}: "


def load_settings(config: Path | None, *, options: Mapping[str, Any] | None = None) -> RobotSettings:
    """Return the settings.

    Args:
        config: A YAML file; None is as good as one that says: a Megarover, its server on this machine. Relative paths
            in the settings count from its folder.
        options: What the command line says of ``robot`` and ``server``; it wins over the environment, and that
            over the file.

    Raises:
        FileError: The file cannot be read or is no YAML mapping.
        BadSettingsError: Values are wrong; the text says where they stand.
    """
    layers = _Layers(None if config is None else YamlDocument.of_file(config))
    for name in sorted(os.environ):
        if name.startswith(_PREFIX):
            place = tuple(name.removeprefix(_PREFIX).lower().split(_NESTED))
            layers.lay(name, place, YamlDocument(os.environ[name], name).data)
    for key, value in (options or {}).items():
        layers.lay(_OPTIONS[key], (key,), value)
    settings = _settings(_checked(layers), Path() if config is None else config.parent)
    if problems := list(contradictions(settings)):
        raise BadSettingsError(_told(problems, layers))
    return settings


def _mapping(document: YamlDocument) -> dict[str, Any]:
    if not isinstance(document.data, dict | None):
        raise FileError(f"{document.where(())}: expected a mapping of names to values")
    return document.data or {}


def _checked(layers: _Layers) -> dict[str, Any]:
    """Return what was set, as the program uses it.

    Raises:
        BadSettingsError: Something is wrong.
    """
    problems: list[tuple[Place, str]] = []

    def note(place: Place, problem: str) -> None:
        problems.append((place, problem))

    given: dict[str, Any] = ROOT.read(layers.data, (), note)
    if given.get("profile") == CUSTOM:
        for section, key in NEEDED_BY_CUSTOM:
            if key not in layers.data.get(section, {}):
                note((section, key), "is missing: profile custom knows no robot's")
    if problems:
        raise BadSettingsError(_told(problems, layers))
    return given


def _told(problems: list[tuple[Place, str]], layers: _Layers) -> list[str]:
    """Return problems as lines that say where each stands."""
    return [f"{layers.where(place)}{dotted(place)}: {text}" for place, text in problems]


def _settings(given: dict[str, Any], folder: Path) -> RobotSettings:
    """Fill in from the profile what was not set; relative paths count from a folder."""
    known: Mapping[str, Any] = PROFILES[given["profile"]].values if given["profile"] in PROFILES else CAUTIOUS
    driver = dict(given.get("driver", {}))

    def section(name: str) -> dict[str, Any]:
        return {**known.get(name, {}), **given.get(name, {})}

    return RobotSettings(
        robot=given["robot"],
        server=given["server"],
        security=SecuritySettings(**{key: folder / path for key, path in section("security").items()}),
        profile=given["profile"],
        driver=DriverSettings(kind=driver.pop("kind", "zenoh"), options=driver),
        limits=Limits(**section("limits")),
        footprint=FootprintSettings(**section("footprint")),
        lidar=LidarSettings(**section("lidar")),
        braking=BrakingSettings(**section("braking")),
        safety=SafetySettings(**section("safety")),
        log=LogSettings(**section("log")),
    )
