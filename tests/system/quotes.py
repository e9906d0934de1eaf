"""What the product can say: the texts in its sources, with gaps where values are filled in."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from .guide import ROOT

_GAP = "\0"
_CONVERSION = re.compile(r"%[-+ #0-9.]*[sdrfgx]")
_IN_PAGE = re.compile(r'"((?:[^"\\\n]|\\.)*)"|`([^`]*)`')
# A text that is mostly gaps would fit everything.
_LEAST_SHARE = 0.4


@cache
def _templates() -> frozenset[str]:
    return frozenset(text for text in _sources() if len(text.replace(_GAP, "")) > 3)


def _sources() -> Iterator[str]:
    for file in ROOT.glob("*/revnm_*/**/*"):
        if file.suffix == ".py":
            yield from _in_python(file)
        elif file.suffix in {".js", ".html"}:
            text = file.read_text()
            yield from (re.sub(r"\$\{[^}]*\}", _GAP, a or b) for a, b in _IN_PAGE.findall(text))


def _in_python(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield _CONVERSION.sub(_GAP, node.value)
        elif isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else _GAP for part in node.values)


def is_said(quote: str) -> bool:
    """Return whether some source says this; "…" stands for a value, and so may numbers and names."""
    return quote in _templates() or any(_fits(template, quote) for template in _templates() if _GAP in template)


def _fits(template: str, quote: str) -> bool:
    parts = template.split(_GAP)
    if not all(part in quote for part in parts) or sum(map(len, parts)) < _LEAST_SHARE * len(quote):
        return False
    return re.fullmatch(".+?".join(map(re.escape, parts)), quote) is not None
