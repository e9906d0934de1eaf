"""Real containers of the images that ``make images`` has built."""

from __future__ import annotations

import json
import os
import subprocess
from typing import Any

import pytest

IMAGES = ("revnm-server", "revnm-simulator", "revnm-robot")
_ENDS = ("--timeout", "100")  # by itself, before whoever waits for it gives up
GUARDED = ("--read-only", "--cap-drop", "ALL", "--security-opt", "no-new-privileges", "--tmpfs", "/tmp")


def run(*command: object, within_s: float = 120.0) -> subprocess.CompletedProcess[str]:
    """Run a command; what it prints is kept."""
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=within_s)


def podman(*words: object) -> str:
    """Return what podman prints; a failure fails the test."""
    done = run("podman", *words)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.strip()


def inside(image: str, *command: object) -> subprocess.CompletedProcess[str]:
    """Run a command in a container of an image, with the rights that the compose files leave it."""
    entry, *arguments = command
    return run("podman", "run", "--rm", "--network", "none", *_ENDS, *GUARDED, "--entrypoint", entry, image, *arguments)


def inspected(image: str) -> dict[str, Any]:
    """Return the configuration of an image."""
    document: dict[str, Any] = json.loads(podman("image", "inspect", image))[0]
    return document


def need_images() -> None:
    """Skip the test where nobody has built images, and given it a network of its own."""
    if os.environ.get("APART") != "1":
        pytest.skip("make images-test builds the images, and runs this")
    for image in IMAGES:
        podman("image", "exists", image)
