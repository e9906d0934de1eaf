"""What a value in the settings may be: each kind checks one, and describes itself as JSON Schema.

A check never raises: it notes every problem with its place, so that one run shows them all.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from revnm_client.settings.document import Place

Note = Callable[[Place, str], None]
Schema = dict[str, Any]


class Kind(Protocol):
    """A kind of value."""

    def read(self, value: Any, place: Place, note: Note) -> Any:
        """Return the value as the program uses it; note what is wrong with it."""

    def schema(self) -> Schema:
        """Return the JSON Schema of the value."""


@dataclass(frozen=True, slots=True)
class Number:
    """A number from ``low`` to ``high``."""

    low: float
    high: float

    def read(self, value: Any, place: Place, note: Note) -> Any:
        """Return it as a float."""
        if isinstance(value, bool) or not isinstance(value, int | float) or not self.low <= value <= self.high:
            return note(place, f"{_shown(value)}: expected {self.low} to {self.high}")
        return float(value)

    def schema(self) -> Schema:
        """Return the JSON Schema."""
        return {"type": "number", "minimum": self.low, "maximum": self.high}


@dataclass(frozen=True, slots=True)
class Whole:
    """An integer from ``low`` to ``high``."""

    low: int
    high: int

    def read(self, value: Any, place: Place, note: Note) -> Any:
        """Return it."""
        if isinstance(value, bool) or not isinstance(value, int) or not self.low <= value <= self.high:
            return note(place, f"{_shown(value)}: expected a whole number from {self.low} to {self.high}")
        return value

    def schema(self) -> Schema:
        """Return the JSON Schema."""
        return {"type": "integer", "minimum": self.low, "maximum": self.high}


@dataclass(frozen=True, slots=True)
class Flag:
    """True or false."""

    def read(self, value: Any, place: Place, note: Note) -> Any:
        """Return it."""
        return value if isinstance(value, bool) else note(place, f"{_shown(value)}: expected true or false")

    def schema(self) -> Schema:
        """Return the JSON Schema."""
        return {"type": "boolean"}


@dataclass(frozen=True, slots=True)
class Choice:
    """One of some words."""

    words: tuple[str, ...]

    def read(self, value: Any, place: Place, note: Note) -> Any:
        """Return it."""
        if value not in self.words:
            return note(place, f"{_shown(value)}: expected one of {', '.join(self.words)}{_meant(value, self.words)}")
        return value

    def schema(self) -> Schema:
        """Return the JSON Schema."""
        return {"enum": list(self.words)}


@dataclass(frozen=True, slots=True)
class Text:
    """A text that matches ``pattern``; ``expected`` says so in words."""

    pattern: str
    expected: str

    def read(self, value: Any, place: Place, note: Note) -> Any:
        """Return it."""
        if not isinstance(value, str) or not re.fullmatch(self.pattern, value):
            return note(place, f"{_shown(value)}: expected {self.expected}")
        return value

    def schema(self) -> Schema:
        """Return the JSON Schema."""
        return {"type": "string", "pattern": f"^(?:{self.pattern})$", "description": self.expected}


@dataclass(frozen=True, slots=True)
class OneOrMore:
    """A value of a kind, or a list of some."""

    of: Kind

    def read(self, value: Any, place: Place, note: Note) -> Any:
        """Return them as a tuple."""
        if not isinstance(value, list):
            return (self.of.read(value, place, note),)
        if not value:
            return note(place, "[]: expected one at least")
        return tuple(self.of.read(each, (*place, index), note) for index, each in enumerate(value))

    def schema(self) -> Schema:
        """Return the JSON Schema."""
        return {"anyOf": [self.of.schema(), {"type": "array", "items": self.of.schema(), "minItems": 1}]}


@dataclass(frozen=True, slots=True)
class Anything:
    """A value that whoever gets it checks."""

    def read(self, value: Any, place: Place, note: Note) -> Any:  # noqa: ARG002
        """Return it as it is."""
        return value

    def schema(self) -> Schema:
        """Return the JSON Schema."""
        return {}


@dataclass(frozen=True, slots=True)
class Section:
    """A mapping with known keys.

    Attributes:
        fields: What each key may be.
        required: The keys that must be there.
    """

    fields: Mapping[str, Kind]
    required: tuple[str, ...] = ()

    def read(self, value: Any, place: Place, note: Note) -> Any:
        """Return the keys that are there; an empty section is as good as none."""
        given = as_mapping(value, place, note)
        known = sorted(self.fields)
        for key in given:
            if key not in self.fields:
                note((*place, key), f"unknown key: expected one of {', '.join(known)}{_meant(key, known)}")
        for key in self.required:
            if key not in given:
                note((*place, key), "is missing")
        return {key: self.fields[key].read(given[key], (*place, key), note) for key in given if key in self.fields}

    def schema(self) -> Schema:
        """Return the JSON Schema."""
        return {
            "type": "object",
            "properties": {key: kind.schema() for key, kind in self.fields.items()},
            "required": list(self.required),
            "additionalProperties": False,
        }


def as_mapping(value: Any, place: Place, note: Note) -> dict[str, Any]:
    """Return a mapping; note where a value is none, and return an empty one."""
    if value is not None and not isinstance(value, dict):
        note(place, f"{_shown(value)}: expected a mapping of names to values")
    return value if isinstance(value, dict) else {}


def _shown(value: Any) -> str:
    return f"{value!r:.80}"


def _meant(value: Any, words: tuple[str, ...] | list[str]) -> str:
    close = difflib.get_close_matches(str(value), words, n=1)
    return f"; did you mean {close[0]}?" if close else ""
