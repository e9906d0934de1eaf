"""Every command of the guides is executed as printed, or checked as far as this machine can."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from .guide import ROOT, Block, blocks, guides
from .reader import Reader, clone, same_but_for_numbers
from .rehearsal import calls, fault

_BLOCK_S = 120.0  # it takes seconds; a machine that does much else needs longer
_LONG_BLOCK_S = 240.0
# What a benchmark writes about itself: the command that it was started with.
_RECORDS = ROOT / "docs" / "results"
_COMMAND = re.compile(r"^(\.venv/bin/)?(revnm-[a-z]+ [a-z]|make )", re.MULTILINE)
_DEMO = """
REVNM_RECORDING__FOLDER=$PWD/records revnm-sim demo > demo.log 2>&1 & demo=$!
until grep -qs 'click into the picture' demo.log; do kill -0 $demo; sleep 0.2; done
trap 'kill $demo; wait $demo' EXIT
"""


def _name(guide: Path) -> str:
    return str(guide.relative_to(ROOT))


def _commands(guide: Path) -> list[Block]:
    return [block for block in blocks(guide) if block.language == "sh"]


def _for_now(guide: Path) -> bool:
    return _RECORDS not in guide.parents and any(not block.needs and not block.runs for block in _commands(guide))


def _for_later(guide: Path) -> bool:
    return any(block.runs for block in _commands(guide))


def test_the_guides_name_programs_options_targets_and_files_that_there_are(tmp_path: Path) -> None:
    said = calls([block for guide in guides() for block in _commands(guide)], tmp_path / "rehearsal")
    assert len(said) > 50
    assert [each for each in map(fault, said) if each] == []


@pytest.mark.parametrize(
    "wrong",
    [
        "revnm-robot run --robt rover",
        "for seed in 1 2; do .venv/bin/revnm-sim demo --sead $seed; done",
        "sudo revnm-server serv",
        "revnm-robt run",
        "make demoo",
        "sudo cp robot_client/no-such.service /etc",
    ],
)
def test_a_command_that_is_wrong_is_found_out(wrong: str, tmp_path: Path) -> None:
    said = calls([Block("guide.md:1", "sh", wrong)], tmp_path / "rehearsal")
    assert said
    assert all(fault(call) for call in said)


def test_a_command_that_fails_ends_the_reading(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="unrecognized arguments"), Reader(clone(tmp_path / "clone")) as reader:
        reader.type("revnm-robot config schema --all | head\necho done", within_s=_BLOCK_S)


def test_commands_stand_in_blocks_of_commands() -> None:
    others = [block for guide in guides() for block in blocks(guide) if block.language != "sh"]
    hidden = [block.place for block in others if _COMMAND.search(block.text)]
    assert hidden == []


@pytest.mark.parametrize("guide", list(filter(_for_now, guides())), ids=_name)
def test_the_commands_of_a_guide_run(guide: Path, tmp_path: Path) -> None:
    with Reader(clone(tmp_path / "clone")) as reader:
        _follow(reader, guide, long=False)


@pytest.mark.slow
@pytest.mark.parametrize("guide", list(filter(_for_later, guides())), ids=_name)
def test_the_long_commands_of_a_guide_run(guide: Path, tmp_path: Path) -> None:
    with Reader(clone(tmp_path / "clone")) as reader:
        if any(block.runs == "beside the demo" for block in _commands(guide)):
            reader.type(_DEMO, within_s=_BLOCK_S)
        _follow(reader, guide, long=True)


def _follow(reader: Reader, guide: Path, *, long: bool) -> None:
    printed: str | None = None
    for block in blocks(guide):
        if block.file is not None:
            (reader.folder / block.file).write_text(block.text)
        elif block.is_output and printed is not None:
            assert same_but_for_numbers(block.text, printed), f"{block.place}: expected\n{block.text}\ngot\n{printed}"
        elif block.language == "sh":
            printed = _run(reader, block) if not block.needs and (long or not block.runs) else None


def _run(reader: Reader, block: Block) -> str:
    if block.until is not None:
        return reader.start(block.text, until=block.until, within_s=_BLOCK_S)
    return reader.type(block.text, within_s=_LONG_BLOCK_S if block.runs else _BLOCK_S)
