"""Strict JSON for the small messages of our own.

Decoding is total: one object of at most 4096 bytes with unique keys and finite numbers, or
:class:`MessageError`, nothing else.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, NoReturn

from revnm_client import validate
from revnm_client.errors import MessageError

MAX_JSON_BYTES = 4096
_MAX_INT = 2**63 - 1

Scalar = str | int | float | bool | None


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is no JSON number")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is too big")
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) != len(pairs):
        raise ValueError("a key stands there twice")
    return fields


def decode_object(payload: bytes, *, what: str) -> dict[str, Any]:
    """Return the JSON object in ``payload``.

    Raises:
        MessageError: It is none, or too long; the text names ``what``.
    """
    if len(payload) > MAX_JSON_BYTES:
        raise MessageError(f"{what} of {len(payload)} bytes: expected at most {MAX_JSON_BYTES}")
    try:
        fields = json.loads(
            payload.decode(),
            parse_constant=_refuse_constant,
            parse_float=_finite,
            object_pairs_hook=_unique,
        )
    except (ValueError, RecursionError) as error:
        raise MessageError(f"{what} is no JSON: {error}") from error
    if not isinstance(fields, dict):
        raise MessageError(f"{what} is {type(fields).__name__}: expected a JSON object")
    return fields


def encode_object(fields: Mapping[str, Scalar]) -> bytes:
    """Return the fields as compact JSON."""
    return json.dumps(fields, allow_nan=False, separators=(",", ":")).encode()


def only(fields: dict[str, Any], keys: set[str], *, what: str) -> None:
    """Check that the object has these keys and no others.

    Raises:
        MessageError: It has others, or lacks one.
    """
    if fields.keys() != keys:
        raise MessageError(f"{what} has keys {sorted(fields)!s:.200}: expected {sorted(keys)}")


def count(value: object, *, what: str) -> int:
    """Return ``value`` if it is an integer from 0 to 2⁶³ − 1.

    Raises:
        MessageError: It is not; a bool or 1.0 is no integer.
    """
    if type(value) is not int or not 0 <= value <= _MAX_INT:  # a bool would pass isinstance
        raise MessageError(f"{what} is {value!r:.80}: expected an integer from 0 to 2^63-1")
    return value


def text(value: object, *, what: str, max_length: int = validate.MAX_NAME_LENGTH) -> str:
    """Return ``value`` if it is printable text of at most ``max_length`` characters.

    Raises:
        MessageError: It is not.
    """
    if not isinstance(value, str):
        raise MessageError(f"{what} is {value!r:.80}: expected text")
    return validate.name(value, what=what, max_length=max_length)


def flag(value: object, *, what: str) -> bool:
    """Return ``value`` if it is true or false.

    Raises:
        MessageError: It is not.
    """
    if not isinstance(value, bool):
        raise MessageError(f"{what} is {value!r:.80}: expected true or false")
    return value
