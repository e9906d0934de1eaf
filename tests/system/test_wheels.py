"""The wheels in ``dist/`` are what somebody without a clone gets: whole, of one version, and enough by themselves."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import venv
from pathlib import Path
from zipfile import ZipFile

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
VERSION = tomllib.loads((ROOT / "robot_client/pyproject.toml").read_text())["project"]["version"]
PACKAGES = {
    "robot_client": "revnm_client",
    "server": "revnm_server",
    "sim": "revnm_sim",
    "training": "revnm_training",
}
WHEELS = {folder: ROOT / f"dist/{package}-{VERSION}-py3-none-any.whl" for folder, package in PACKAGES.items()}
# Nothing of this environment: neither its packages nor the settings of whoever runs the tests.
BARE = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "REVNM_"))}
COMMANDS = [
    (program, *words)
    for program in ("revnm-robot", "revnm-server", "revnm-sim", "revnm-train")
    for words in (("--help",), ("--version",))
] + [
    ("revnm-robot", "config", "check", "robot.yaml"),
    ("revnm-robot", "config", "schema"),
    ("revnm-server", "config", "check", "server.yaml"),
    ("revnm-server", "config", "schema"),
    ("revnm-server", "models", "list"),
    ("revnm-server", "tag", "--help"),
    ("revnm-sim", "demo", "--help"),
    ("revnm-train", "synth", "--help"),
]


def run(*command: object, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    words = [str(word) for word in command]
    return subprocess.run(words, cwd=folder, env=BARE, capture_output=True, text=True, timeout=600, check=False)


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ``bin`` of an environment with the four wheels and what they need; only torch and its kin are left out."""
    folder = tmp_path_factory.mktemp("wheels") / "venv"
    venv.create(folder, with_pip=False, symlinks=True)
    pip = (sys.executable, "-m", "pip", "--python", folder / "bin/python", "install", "--quiet", "--no-compile")
    constraint = ("--constraint", ROOT / "constraints.txt")
    needed = [WHEELS["robot_client"], WHEELS["server"], WHEELS["sim"]]
    for options in ((*constraint, *needed), ("--no-deps", WHEELS["training"])):
        installed = run(*pip, *options)
        assert installed.returncode == 0, installed.stderr
    return folder / "bin"


@pytest.mark.parametrize("folder", PACKAGES)
def test_a_wheel_holds_what_git_holds_and_nothing_else(folder: str) -> None:
    package = PACKAGES[folder]
    listed = run("git", "ls-files", package, folder=ROOT / folder)
    assert listed.returncode == 0, listed.stderr
    with ZipFile(WHEELS[folder]) as wheel:
        names = wheel.namelist()
    assert {name for name in names if name.startswith(f"{package}/")} == set(listed.stdout.split())
    assert f"{package}/py.typed" in names
    assert f"{package}-{VERSION}.dist-info/licenses/LICENSE" in names


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_command_works_without_the_clone(programs: Path, tmp_path: Path, command: tuple[str, ...]) -> None:
    block = re.search(r"```yaml\n(robot: .*?)```", (ROOT / "docs/robot.md").read_text(), re.DOTALL)
    assert block is not None
    (tmp_path / "robot.yaml").write_text(block[1])
    (tmp_path / "rover").mkdir()
    for name in ("authority.pem", "robot.pem", "robot.key"):  # which its security names
        (tmp_path / "rover" / name).touch()
    (tmp_path / "server.yaml").write_text("robots: {rover: 3}\n")
    done = run(programs / command[0], *command[1:], folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout
    if command[1:] == ("--version",):
        assert done.stdout == f"{command[0]} {VERSION}\n"


def test_the_service_of_the_robot_is_where_the_guide_says(programs: Path) -> None:
    unit = programs.parent / "share/revnm/revnm-robot.service"
    assert unit.read_text() == (ROOT / "robot_client/systemd/revnm-robot.service").read_text()
