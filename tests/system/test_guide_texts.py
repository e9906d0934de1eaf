"""What the guides quote, the product says; where they point to, something stands."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from markdown_it.token import Token

from .guide import ROOT, guides, tokens
from .quotes import is_said

_QUOTES = "<!-- quotes -->"


def _quotes(guide: Path) -> Iterator[str]:
    """Yield the code spans in the first column of every table that is marked."""
    marked, column = False, -1
    for token in tokens(guide):
        if token.type == "html_block":
            marked = token.content.strip() == _QUOTES
        elif token.type == "table_close":
            marked = False
        elif token.type == "tr_open":
            column = -1
        elif token.type == "td_open":
            column += 1
        elif token.type == "inline" and marked and column == 0:
            yield from (child.content for child in token.children or [] if child.type == "code_inline")


def test_every_text_that_a_guide_quotes_is_in_the_sources() -> None:
    quotes = [(guide.name, quote) for guide in guides() for quote in _quotes(guide)]
    assert len(quotes) > 30
    assert [each for each in quotes if not is_said(each[1])] == []


@pytest.mark.parametrize(
    "quote", ["plan is 0.6 years old", "the goal is above the horison", "stopped until it is resumes"]
)
def test_a_text_that_nothing_says_is_found_out(quote: str) -> None:
    assert not is_said(quote)


def _anchors(guide: Path) -> set[str]:
    """Return the anchors that GitHub gives a guide's headings."""
    found: set[str] = set()
    every = tokens(guide)
    for before, token in itertools.pairwise(every):
        if before.type == "heading_open":
            shown = "".join(child.content for child in token.children or [])
            slug = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
            number = sum(slug == re.sub(r"-\d+$", "", each) for each in found)
            found.add(f"{slug}-{number}" if slug in found else slug)
    return found


def _links(every: list[Token]) -> Iterator[str]:
    for token in every:
        for child in token.children or []:
            target = child.attrGet("href") or child.attrGet("src")
            if isinstance(target, str) and not re.match(r"[a-z]+:", target):
                yield target


def _is_there(guide: Path, link: str) -> bool:
    path, _, anchor = link.partition("#")
    target = guide if not path else (guide.parent / path).resolve()
    if not target.exists() or not target.is_relative_to(ROOT):
        return False
    return not anchor or anchor in _anchors(target)


@pytest.mark.parametrize("guide", guides(), ids=lambda guide: str(guide.relative_to(ROOT)))
def test_every_link_leads_somewhere(guide: Path) -> None:
    assert [link for link in _links(tokens(guide)) if not _is_there(guide, link)] == []
