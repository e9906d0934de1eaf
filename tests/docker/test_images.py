from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from .podman import GUARDED, IMAGES, inside, inspected, need_images, run

pytestmark = pytest.mark.slow

QUICKLY = ("--network", "none", "--env", "NUMBA_DISABLE_JIT=1")  # what is looked for needs no compiled loops
TOOLS = ("gcc", "cc", "make", "pip", "pip3", "git", "curl", "wget")
RUBBISH = ("/root/.cache", "/src", "/packages")


@pytest.fixture(autouse=True, scope="module")
def _images() -> None:
    need_images()


@pytest.mark.parametrize("image", IMAGES)
def test_it_runs_as_a_user_without_rights_and_may_write_nowhere(image: str) -> None:
    assert inspected(image)["Config"]["User"] == "10001:10001"
    look = "id -u; grep -E '^(CapEff|CapBnd|NoNewPrivs)' /proc/self/status; touch /opt/revnm/x /etc/x /x"
    looked = inside(image, "sh", "-c", look)
    assert looked.stdout.split() == ["10001", "CapEff:", 16 * "0", "CapBnd:", 16 * "0", "NoNewPrivs:", "1"]
    assert looked.stderr.count("Read-only file system") == 3


@pytest.mark.parametrize("image", IMAGES)
def test_nothing_of_the_build_is_left(image: str) -> None:
    look = "; ".join(
        [
            f"for tool in {' '.join(TOOLS)}; do command -v $tool; done",
            f"for path in {' '.join(RUBBISH)}; do test -e $path && echo $path; done",
            "ls -A /var/lib/apt/lists /var/cache/apt",
            "ls /opt/revnm/lib/python3.11/site-packages | grep -i -E '^(pip|setuptools|hatchling|torch)'",
        ]
    )
    found = inside(image, "sh", "-c", f"{look}; echo looked").stdout.split()
    assert [each for each in found if not each.startswith("/var/")] == ["looked"]


@pytest.mark.parametrize(
    ("image", "program", "commands"),
    [
        ("revnm-server", "revnm-server", ("serve", "health", "doctor", "config")),
        ("revnm-simulator", "revnm-sim", ("run", "demo", "bench")),
        ("revnm-robot", "revnm-robot", ("run", "doctor", "watch", "config")),
    ],
)
def test_the_entry_point_knows_its_commands(image: str, program: str, commands: tuple[str, ...]) -> None:
    assert inspected(image)["Config"]["Entrypoint"] == [program]
    for command in commands:
        asked = run("podman", "run", "--rm", *QUICKLY, *GUARDED, image, command, "--help")
        assert asked.returncode == 0, asked.stderr


@pytest.mark.parametrize("image", IMAGES)
def test_every_package_has_what_it_needs(image: str) -> None:
    """Imports all of our modules, so that a library of Debian that a wheel expects is missed here."""
    code = """
import importlib, pkgutil, sys
for name in sys.argv[1:]:
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(package.__path__, name + "."):
        if ".drivers.kachaka" not in module.name and not module.name.endswith("cuda_raycast"):
            importlib.import_module(module.name)
"""
    ours = {"revnm-robot": ["revnm_client"], "revnm-server": ["revnm_client", "revnm_server"]}
    imported = run(
        "podman", "run", "--rm", *QUICKLY, *GUARDED, "--entrypoint", "python3", image,
        "-c", code, *ours.get(image, ["revnm_client", "revnm_server", "revnm_sim"]),
    )  # fmt: skip
    assert imported.returncode == 0, imported.stderr


def test_labels_say_what_it_is() -> None:
    labels = inspected("revnm-server")["Config"]["Labels"]
    assert labels["org.opencontainers.image.title"] == "ReVNM server"
    assert labels["org.opencontainers.image.licenses"] == "Apache-2.0"
    assert inspected("revnm-server")["Healthcheck"]["Test"][:3] == ["CMD", "revnm-server", "health"]


def test_the_robots_image_is_small() -> None:
    base, robot = (inspected(image)["Size"] for image in ("revnm-base:bookworm", "revnm-robot"))
    assert robot - base < 200e6


def test_a_secret_that_the_user_may_not_read_is_told_in_one_line(tmp_path: Path) -> None:
    secret = tmp_path / "REVNM_HTTP__TOKEN"
    secret.write_text("0123456789abcdefXYZ")
    secret.chmod(0o600)
    mount = f"{secret}:/run/secrets/REVNM_HTTP__TOKEN:ro"
    said = run("podman", "run", "--rm", "--network", "none", *GUARDED, "--volume", mount, "revnm-server", "health")
    assert said.returncode == 2
    assert "expected secrets in UTF-8 that this user may read" in said.stderr
    shutil.chown(secret, 10001)
    served = run("podman", "run", "--rm", "--network", "none", *GUARDED, "--volume", mount, "revnm-server", "health")
    assert served.returncode == 1
    assert "Connection refused" in served.stderr
