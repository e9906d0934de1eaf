"""A YAML file as plain data that knows on which line each part of it stands.

A file is hostile until it has been checked: aliases, keys that stand twice, deep nesting and large files are refused.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, NoReturn

import yaml

from revnm_client.errors import FileError

_MOST_BYTES = 4_000_000
_DEEPEST = 10
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast, where PyYAML was built with it

Place = tuple[str | int, ...]


class YamlDocument:
    """The data of a YAML file.

    Attributes:
        path: The file.
        data: Dictionaries, lists and scalars.
        sha256: Of the file, in hexadecimal.
    """

    def __init__(self, path: Path) -> None:
        """Read a file.

        Raises:
            FileError: It cannot be read, is no YAML, or holds what is refused.
        """
        self.path = path
        self._lines: dict[Place, int] = {(): 1}
        self._scalars = yaml.SafeLoader("")
        try:
            if path.stat().st_size > _MOST_BYTES:
                raise FileError(f"{path}: larger than {_MOST_BYTES} bytes")
            content = path.read_bytes()
            self.sha256 = hashlib.sha256(content).hexdigest()
            text = content.decode("utf-8")
            self._refuse_bombs(text)
            self.data = self._plain(yaml.compose(text, Loader=_Loader), ())
        except OSError as error:
            raise FileError(f"{path}: cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise FileError(f"{path}: is no UTF-8 text") from error
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else 1
            raise FileError(f"{path}:{line}: is no YAML: {error.problem}") from error
        except (yaml.YAMLError, ValueError) as error:
            raise FileError(f"{path}: is no YAML: {error}") from error

    def where(self, place: Place) -> str:
        """Return file, line and key of a place, as in ``site.yaml:16: placements[2].prefab``."""
        known = place
        while known not in self._lines:
            known = known[:-1]
        return f"{self.path}:{self._lines[known]}: {_dotted(place)}"

    def holds(self, place: Place) -> bool:
        """Tell whether a place stands in the file."""
        return place in self._lines

    def refuse(self, place: Place, problem: str) -> NoReturn:
        """Raise a FileError that names the file, the line and the key."""
        raise FileError(f"{self.where(place)}: {problem}")

    def _refuse_bombs(self, text: str) -> None:
        """Refuse what makes a small file huge or slow to read: aliases, and lists in lists in lists."""
        depth = 0
        for event in yaml.parse(text, Loader=_Loader):
            line = event.start_mark.line + 1 if event.start_mark else 1
            if isinstance(event, yaml.AliasEvent):
                raise FileError(f"{self.path}:{line}: *{event.anchor}: expected the value itself, not an alias")
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST:
                raise FileError(f"{self.path}:{line}: expected at most {_DEEPEST} levels of nesting")

    def _plain(self, node: yaml.Node | None, place: Place) -> Any:
        if node is None:
            return None
        self._lines[place] = node.start_mark.line + 1
        if isinstance(node, yaml.SequenceNode):
            return [self._plain(child, (*place, i)) for i, child in enumerate(node.value)]
        if not isinstance(node, yaml.MappingNode):
            return self._scalars.construct_object(node)
        mapping: dict[str, Any] = {}
        for key, value in node.value:
            inner = (*place, str(key.value))
            self._lines[inner] = key.start_mark.line + 1
            if str(key.value) in mapping:
                self.refuse(inner, "stands here a second time: expected every key once")
            mapping[str(key.value)] = self._plain(value, inner)
            self._lines[inner] = key.start_mark.line + 1
        return mapping


def _dotted(place: Place) -> str:
    """Write a place as ``placements[2].prefab``."""
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in place)
    return text.lstrip(".") or "the file"
