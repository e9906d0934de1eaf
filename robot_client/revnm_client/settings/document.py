"""YAML as plain data that knows on which line each part of it stands.

A file is hostile until it has been checked: aliases, keys that stand twice, deep nesting and large files are refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from revnm_client.errors import FileError

Place = tuple[str | int, ...]

_MOST_BYTES = 100_000
_DEEPEST = 10
_LONGEST_KEY = 64


class YamlDocument:
    """The data of a YAML text.

    Attributes:
        name: Of the file, or of where else the text stood.
        data: Dictionaries, lists and scalars; None where the text is empty.
    """

    def __init__(self, text: str, name: str) -> None:
        """Read a text.

        Raises:
            FileError: It is no YAML, or holds what is refused.
        """
        self.name = name
        self._lines: dict[Place, int] = {(): 1}
        self._yaml = YAML(typ="safe", pure=True)
        try:
            self._refuse_bombs(text)
            self.data = self._plain(self._yaml.compose(text), ())
        except MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else 1
            raise FileError(f"{name}:{line}: is no YAML: {error.problem}") from error
        except (YAMLError, ValueError) as error:
            raise FileError(f"{name}: is no YAML: {error!s:.200}") from error

    @classmethod
    def of_file(cls, path: Path) -> YamlDocument:
        """Read a file.

        Raises:
            FileError: It cannot be read, is too large, is no YAML, or holds what is refused.
        """
        try:
            with path.open("rb") as file:
                content = file.read(_MOST_BYTES + 1)
        except OSError as error:
            raise FileError(f"{path}: cannot be read: {error.strerror}") from error
        if len(content) > _MOST_BYTES:
            raise FileError(f"{path}: is larger than {_MOST_BYTES} bytes")
        try:
            return cls(content.decode("utf-8"), str(path))
        except UnicodeDecodeError as error:
            raise FileError(f"{path}: is no UTF-8 text") from error

    def where(self, place: Place) -> str:
        """Return file and line of a place, as in ``robot.yaml:7``; of what is missing, of where it is missed."""
        known = place
        while known not in self._lines:
            known = known[:-1]
        return f"{self.name}:{self._lines[known]}"

    def _refuse_bombs(self, text: str) -> None:
        """Refuse what makes a small text huge or slow to read: aliases, and lists in lists in lists."""
        depth = 0
        for event in self._yaml.parse(text):
            line = event.start_mark.line + 1 if event.start_mark else 1
            if isinstance(event, AliasEvent):
                raise FileError(f"{self.name}:{line}: *{event.anchor}: expected the value itself, not an alias")
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if depth > _DEEPEST:
                raise FileError(f"{self.name}:{line}: expected at most {_DEEPEST} levels of nesting")

    def _plain(self, node: Node | None, place: Place) -> Any:
        if node is None:
            return None
        self._lines.setdefault(place, node.start_mark.line + 1)
        if isinstance(node, SequenceNode):
            return [self._plain(child, (*place, index)) for index, child in enumerate(node.value)]
        if not isinstance(node, MappingNode):
            return self._yaml.constructor.construct_object(node)
        mapping: dict[str, Any] = {}
        for key, value in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, ScalarNode) or len(key.value) > _LONGEST_KEY:
                raise FileError(f"{self.name}:{line}: expected keys of at most {_LONGEST_KEY} characters")
            inner = (*place, key.value)
            if inner in self._lines:
                raise FileError(f"{self.name}:{line}: {dotted(inner)}: stands here a second time: expected it once")
            self._lines[inner] = line
            mapping[key.value] = self._plain(value, inner)
        return mapping


def dotted(place: Place) -> str:
    """Write a place as ``server[1]`` or ``limits.max_v_mps``."""
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in place)
    return text.removeprefix(".") or "the settings"
