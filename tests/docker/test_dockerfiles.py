from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from revnm_server.settings import load_settings

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"
COMPOSE = sorted(DOCKER.glob("compose*.yaml"))
BUILDS = [("robot_client",), ("robot_client[kachaka]",), ("robot_client", "server"), ("sim",)]


def program(name: str) -> str:
    found = shutil.which(name, path=str(Path(sys.executable).parent))
    if found is None:
        pytest.skip(f"{name} is not installed: it has no wheel for this machine")
    return found


def run(*command: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=120, cwd=ROOT)


def services(file: Path) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(file.read_text())["services"]
    return found


def normal(requirement: str) -> str:
    return re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", requirement)[0]).lower()


def pinned() -> set[str]:
    lines = [
        *(ROOT / "constraints.txt").read_text().splitlines(),
        *(DOCKER / "accelerators.txt").read_text().splitlines(),
    ]
    return {normal(line) for line in lines if "==" in line}


def test_the_linter_finds_nothing() -> None:
    linted = run(program("hadolint"), *DOCKER.glob("*.Dockerfile"))
    assert (linted.returncode, linted.stdout) == (0, "")


def test_the_linter_would_find_something(tmp_path: Path) -> None:
    (tmp_path / "Dockerfile").write_text("FROM debian:latest\nRUN cd /tmp\n")
    assert "DL3007" in run(program("hadolint"), tmp_path / "Dockerfile").stdout


def test_the_compose_files_follow_their_schema() -> None:
    checked = run(program("check-jsonschema"), "--builtin-schema", "vendor.compose-spec", *COMPOSE)
    assert checked.returncode == 0, checked.stdout


@pytest.mark.parametrize("file", COMPOSE, ids=lambda file: file.name)
def test_no_service_may_do_more_than_it_must(file: Path) -> None:
    for name, service in services(file).items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert service["mem_limit"], name
        assert service["pids_limit"] <= 256, name
        assert "privileged" not in service, name


def test_the_demo_is_reached_from_its_machine_only() -> None:
    ports = {name: service.get("ports") for name, service in services(DOCKER / "compose.yaml").items()}
    assert ports == {"server": ["127.0.0.1:8000:8000"], "simulator": None, "robot": None}


@pytest.mark.parametrize("file", ["compose.edge.yaml", "compose.robot.yaml"])
def test_what_shall_run_for_months_starts_again_and_bounds_its_log(file: str) -> None:
    for service in services(DOCKER / file).values():
        assert service["restart"] == "unless-stopped"
        assert service["logging"]["options"].keys() == {"max-size", "max-file"}


def test_the_settings_of_the_demo_are_good() -> None:
    settings = load_settings(DOCKER / "demo.yaml")
    assert settings.zenoh.listen == ("tcp/127.0.0.1:7447",)
    assert settings.http.host == "0.0.0.0"


def test_the_settings_of_the_example_are_good(tmp_path: Path) -> None:
    (tmp_path / "REVNM_HTTP__TOKEN").write_text("0123456789abcdefXYZ")
    settings = load_settings(DOCKER / "server.example.yaml", secrets=tmp_path)
    mounts = {each.split(":")[1] for each in services(DOCKER / "compose.edge.yaml")["server"]["volumes"]}
    assert {str(each) for each in (*settings.certificates, settings.zenoh.key, settings.http.key)} <= mounts
    assert str(settings.state_file).startswith("/var/lib/revnm/")


@pytest.mark.parametrize("accelerator", ["cpu", "cuda", "openvino"])
@pytest.mark.parametrize("projects", BUILDS, ids=" ".join)
def test_whatever_a_build_installs_is_pinned(projects: tuple[str, ...], accelerator: str) -> None:
    printed = run(sys.executable, DOCKER / "requirements.py", "--accelerator", accelerator, *projects)
    needed = printed.stdout.split()
    assert needed, printed.stderr
    assert {normal(each) for each in needed} <= pinned()
    assert not [each for each in needed if each.startswith("revnm-")]
    if "server" in projects:
        runtimes = {"cpu": "onnxruntime", "cuda": "onnxruntime-gpu[cuda,cudnn]", "openvino": "onnxruntime-openvino"}
        assert [each for each in needed if each.startswith("onnxruntime")] == [runtimes[accelerator]]


@pytest.mark.parametrize("folder", ["robot_client", "server", "sim"])
def test_what_builds_our_packages_is_pinned(folder: str) -> None:
    table = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["build-system"]
    assert {normal(each) for each in table["requires"]} <= pinned()


def test_the_base_image_is_pinned_by_its_digest_and_the_same_in_all() -> None:
    bases = {
        line.removeprefix("ARG BASE=")
        for file in DOCKER.glob("*.Dockerfile")
        for line in file.read_text().splitlines()
        if line.startswith("ARG BASE=")
    }
    assert len(bases) == 1
    assert re.fullmatch(r"docker\.io/library/debian:bookworm-\d{8}-slim@sha256:[0-9a-f]{64}", bases.pop())
