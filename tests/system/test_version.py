"""One version, in one place: what else states it must state the same."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from importlib.metadata import entry_points, version
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
VERSION = tomllib.loads((ROOT / "robot_client/pyproject.toml").read_text())["project"]["version"]
PROGRAMS = {
    "revnm-robot": "revnm-client",
    "revnm-server": "revnm-server",
    "revnm-sim": "revnm-sim",
    "revnm-train": "revnm-training",
}


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_prints_the_version(program: str) -> None:
    assert version(PROGRAMS[program]) == VERSION
    (entry,) = entry_points(group="console_scripts", name=program)
    printing = f"import sys; from {entry.module} import main; sys.exit(main(['--version']))"
    done = subprocess.run([sys.executable, "-c", printing], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (0, f"{program} {VERSION}\n"), done.stderr


def test_who_starts_the_client_does_not_wait_for_its_version() -> None:
    look = "import sys, revnm_client.cli; print('importlib.metadata' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, timeout=60)
    assert done.stdout == "False\n", done.stderr


@pytest.mark.parametrize("folder", ["server", "sim", "training"])
def test_the_others_have_the_version_of_the_client(folder: str) -> None:
    settings = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())
    assert "version" not in settings["project"]
    assert settings["project"]["dynamic"] == ["version"]
    assert (
        ROOT / folder / settings["tool"]["hatch"]["version"]["path"]
    ).resolve() == ROOT / "robot_client/pyproject.toml"


def test_the_citation_is_of_this_version_and_of_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == VERSION
    paper = citation["preferred-citation"]
    assert paper["title"] == "ReVNM: Learning-Based Visual Navigation from a Remote Camera"
    assert [each["family-names"] for each in paper["authors"]] == ["Eguchi", "Honda", "Endo", "Yoshimura", "Yonetani"]
