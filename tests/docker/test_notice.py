from __future__ import annotations

import re
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
LINE = re.compile(r"([\w.-]+)==(\S+)  (\S.*)")


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def needed(name: str, extras: frozenset[str] = frozenset()) -> set[str]:
    """Whatever a package needs, and what that needs."""
    found: set[str] = set()
    waiting = [(name, extras)]
    seen = set()
    while waiting:
        each, wanted = waiting.pop()
        if (each, wanted) in seen:
            continue
        seen.add((each, wanted))
        found.add(normal(each))
        for line in distribution(each).requires or []:
            need = Requirement(line)
            if need.marker is None or any(need.marker.evaluate({"extra": extra}) for extra in ("", *wanted)):
                waiting.append((need.name, frozenset(need.extras)))
    return {each for each in found if not each.startswith("revnm-")}


def noticed(image: str) -> dict[str, str]:
    section = (ROOT / "NOTICE").read_text().split(f"Python packages of {image}\n")[1].split("\n\n")[0]
    return {normal(match[1]): match[2] for match in map(LINE.fullmatch, section.splitlines()) if match}


@pytest.mark.parametrize(
    ("image", "package"),
    [("revnm-robot", "revnm-client"), ("revnm-server", "revnm-server"), ("revnm-simulator", "revnm-sim")],
)
def test_it_names_what_the_image_contains_in_the_pinned_versions(image: str, package: str) -> None:
    pins = dict(
        line.split(";")[0].strip().split("==") for line in (ROOT / "constraints.txt").read_text().splitlines()[1:]
    )
    versions = {normal(name): version for name, version in pins.items()}
    listed = noticed(image)
    assert listed.keys() == needed(package), "make notice writes it anew"
    assert listed == {name: versions[name] for name in listed}, "make notice writes it anew"


def test_no_licence_came_that_nobody_has_looked_at() -> None:
    """GPL and the like among the Python packages: NOTICE must say what that means."""
    head, packages = (ROOT / "NOTICE").read_text().split("Python packages of", 1)
    lines = [match for match in map(LINE.fullmatch, packages.split("Debian packages")[0].splitlines()) if match]
    strict = {match[1] for match in lines if re.search(r"GPL|MPL|EPL|Mozilla|see the text", match[3])}
    assert {name for name in strict if name not in head} == set()
