"""Reads settings from command line, environment, secrets and file, and says where what is wrong stands."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pydantic
from pydantic_settings import (
    BaseSettings,
    InitSettingsSource,
    NestedSecretsSettingsSource,
    PydanticBaseSettingsSource,
    SettingsError,
)

from revnm_client.errors import ConfigError, FileError
from revnm_server.settings.root import Settings
from revnm_server.yaml_document import Place, YamlDocument

SECRETS = Path("/run/secrets")
"""Where Docker, Podman and Compose put secrets: files that are named like variables of the environment."""

_PREFIX = "REVNM_"
_NESTED = "__"


class _Secrets(NestedSecretsSettingsSource):
    """Files of our names; those of other programs in the folder are left alone."""

    @classmethod
    def load_secrets(cls, path: Path) -> dict[str, str]:
        """Return what the files say, by their names."""
        return {file.name: file.read_text(encoding="utf-8").strip() for file in path.glob(f"{_PREFIX}*")}


class BadSettingsError(ConfigError):
    """Settings are wrong.

    Attributes:
        problems: What is wrong, a line each: where it stands, the key, what was expected.
    """

    def __init__(self, problems: list[str]) -> None:
        super().__init__("; ".join(problems))
        self.problems = problems


def load_settings(
    config: Path | None = None, *, overrides: Mapping[str, Any] | None = None, secrets: Path = SECRETS
) -> Settings:
    """Return the settings.

    Args:
        config: A YAML file, or None.
        overrides: What the command line says, nested as in the file; it wins.
        secrets: A folder with a file for each secret, such as ``REVNM_HTTP__TOKEN``; there need not be one.

    Raises:
        FileError: The file cannot be read or is no YAML mapping.
        BadSettingsError: Values are wrong; the text says where they stand.
    """
    document = YamlDocument(config) if config is not None else None
    in_file = _mapping(document) if document is not None else {}

    class Layered(Settings):
        @classmethod
        def settings_customise_sources(
            cls,
            settings_cls: type[BaseSettings],
            init_settings: PydanticBaseSettingsSource,
            env_settings: PydanticBaseSettingsSource,
            dotenv_settings: PydanticBaseSettingsSource,  # noqa: ARG003
            file_secret_settings: PydanticBaseSettingsSource,
        ) -> tuple[PydanticBaseSettingsSource, ...]:
            in_secrets = _Secrets(file_secret_settings, secrets_dir=secrets, secrets_dir_missing="ok")
            return init_settings, env_settings, in_secrets, InitSettingsSource(settings_cls, in_file)

    given = overrides or {}
    try:
        return Layered(**given)
    except pydantic.ValidationError as error:
        # Without the values: secrets may be among them, and pydantic's own text would show them.
        faults = error.errors(include_url=False, include_input=False, include_context=False)
        texts = [f"{_where(fault['loc'], given, secrets, document)}{_problem(fault)}" for fault in faults]
        raise BadSettingsError(texts) from None
    except SettingsError as error:
        raise BadSettingsError([f"settings: {error}"]) from None  # an environment variable that is no JSON
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{secrets}: expected secrets in UTF-8 that this user may read: {error}") from None


def _mapping(document: YamlDocument) -> dict[str, Any]:
    if document.data is None:
        return {}
    if not isinstance(document.data, dict):
        raise FileError(f"{document.where(())}: expected a mapping of names to values")
    return document.data


def _where(place: Place, given: Mapping[str, Any], secrets: Path, document: YamlDocument | None) -> str:
    """Return where a key was set: an option of the command, a variable, a secret, or a line of the file."""
    key = ".".join(str(part) for part in place)
    if _is_given(place, given):
        return f"{key}: "
    names = [_PREFIX + _NESTED.join(str(part) for part in place[:end]).upper() for end in range(len(place), 0, -1)]
    variable = next((name for name in names if name in os.environ), None)
    if variable is not None:
        return f"{variable}: {key}: "
    secret = next((secrets / name for name in names if (secrets / name).exists()), None)
    if secret is not None:
        return f"{secret}: {key}: "
    return f"{document.where(place)}: " if document is not None and document.holds(place[:1]) else f"{key}: "


def _is_given(place: Place, given: Mapping[str, Any]) -> bool:
    """Whether an option of the command says something of a key, or of what it is in."""
    inner: Any = given
    for part in place:
        if not isinstance(inner, Mapping):
            return True
        if part not in inner:
            return False
        inner = inner[part]
    return bool(place)


def _problem(fault: Any) -> str:
    """Return what is wrong in words; for an unknown key, which are known there."""
    if fault["type"] != "extra_forbidden":
        return str(fault["msg"]).removeprefix("Value error, ")  # pydantic's word before ours
    known = _keys(fault["loc"][:-1])
    close = difflib.get_close_matches(str(fault["loc"][-1]), known, n=1)
    meant = f"; did you mean {close[0]}?" if close else ""
    return f"unknown key: expected one of {', '.join(known)}{meant}"


def _keys(place: Place) -> list[str]:
    """Return the keys that a part of the settings has."""
    section: Any = Settings
    for part in place:
        section = section.model_fields[part].annotation
    return sorted(section.model_fields)
