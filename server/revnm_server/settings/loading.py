"""Reads settings from command line, environment and file, and says where what is wrong stands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pydantic
import yaml
from pydantic_settings import BaseSettings, InitSettingsSource, PydanticBaseSettingsSource, SettingsError

from revnm_client.errors import ConfigError, FileError
from revnm_server.settings.root import Settings


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
    except yaml.YAMLError as error:
        raise FileError(f"settings {path}{_place(error)}: it is no YAML; expected names and values") from None
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"settings {path}: {error}") from error
    if content is None:
        return {}, {}
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise FileError(f"settings {path}: expected a mapping of names to values")
    return content, dict(_lines(root, ()))


def _place(error: yaml.YAMLError) -> str:
    """Return the line where reading ended; the error's own text shows it, with what secrets stand there."""
    mark = error.problem_mark if isinstance(error, yaml.MarkedYAMLError) else None
    what = f" ({error.problem})" if isinstance(error, yaml.MarkedYAMLError) and error.problem else ""
    return f":{mark.line + 1}{what}" if mark is not None else what


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
