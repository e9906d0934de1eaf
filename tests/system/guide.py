"""A guide as the tests read it: its blocks of commands, files and output, each with the mark that stands before it.

A mark is an HTML comment directly before a block, which no reader sees; CONTRIBUTING.md lists them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).parents[2]
NEEDS = frozenset({"hardware", "network", "time", "root", "docker", "your files"})
RUNS = frozenset({"in minutes", "beside the demo"})
_PARSER = MarkdownIt("commonmark").enable("table")
_MARK = re.compile(r"<!-- (needs|runs|file|prints)(?:: (.+?))? -->")
_UNTIL = re.compile(r'until "(.+)"')


class MarkError(ValueError):
    """A mark that is not in the list."""


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block.

    Attributes:
        place: FILE:LINE of its first line.
        language: What stands behind the fence; "" without.
        text: What is in it.
        needs: Why it cannot be run here; None if it can.
        runs: "in minutes" or "beside the demo" if it is not for the fast test; None else.
        until: What it prints once it is at work, if it runs until somebody stops it; None else.
        file: The name under which the reader saves it; None for commands and output.
        is_output: Whether it is what the commands before it print.
    """

    place: str
    language: str
    text: str
    needs: str | None = None
    runs: str | None = None
    until: str | None = None
    file: str | None = None
    is_output: bool = False


def guides() -> list[Path]:
    """Return every guide: the README files, and all of docs/."""
    return sorted([*ROOT.glob("*.md"), *ROOT.glob("*/README.md"), *ROOT.glob("docs/**/*.md")])


def tokens(guide: Path) -> list[Token]:
    """Return a guide's Markdown, parsed."""
    return _PARSER.parse(guide.read_text())


def blocks(guide: Path) -> Iterator[Block]:
    """Yield a guide's fenced blocks in their order.

    Raises:
        MarkError: A mark is not in the list, or stands before something that it does not fit.
    """
    name = str(guide.relative_to(ROOT))
    mark: re.Match[str] | None = None
    for token in tokens(guide):
        if token.type == "html_block":
            mark = _MARK.fullmatch(token.content.strip())
        elif token.type == "fence":
            assert token.map is not None
            yield _block(f"{name}:{token.map[0] + 2}", token, mark)
            mark = None
        elif mark is not None:
            raise MarkError(f"{name}: the mark {mark.group()} stands before no block")


def _block(place: str, token: Token, mark: re.Match[str] | None) -> Block:
    language = token.info.strip()
    kind, value = mark.groups() if mark is not None else (None, None)
    plain = Block(place, language, token.content)
    match kind, value:
        case None, _:
            return plain
        case "needs", value if value in NEEDS and language == "sh":
            return Block(place, language, token.content, needs=value)
        case "runs", value if value in RUNS and language == "sh":
            return Block(place, language, token.content, runs=value)
        case "runs", value if value and (until := _UNTIL.fullmatch(value)) and language == "sh":
            return Block(place, language, token.content, until=until.group(1))
        case "file", value if value and language != "sh":
            return Block(place, language, token.content, file=value)
        case "prints", None if language != "sh":
            return Block(place, language, token.content, is_output=True)
    raise MarkError(f"{place}: {mark.group() if mark else ''}: no such mark for a block of {language or 'output'}")
