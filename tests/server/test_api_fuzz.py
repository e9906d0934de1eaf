"""The whole API against requests that no client would send; 10,000 of them take some minutes."""

from __future__ import annotations

import re
import subprocess
import sysconfig
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from revnm_client.link import open_client
from revnm_server.app import running_server
from revnm_server.settings import load_settings

from .free_port import free_port
from .service_parts import CameraFeed, RobotEnd
from .waiting import eventually

pytestmark = pytest.mark.slow

TOKEN = "0123456789abcdefXYZ"
REQUESTS = 10_000
ENDLESS = "/api/v1/stream.mjpg"
# What a robot's name may be: half of the requests shall get past it.
CONFIG = '[[operations]]\ninclude-path-regex = "robot}/"\nparameters = { robot = "rover" }\n'


@contextmanager
def serving(bundle: Path) -> Iterator[str]:
    """Run a server with a camera and a robot; yields its address."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    overrides = {
        "zenoh": {"listen": [endpoint]},
        "http": {"port": 0, "token": TOKEN},
        "perception": {"bundle": bundle},
    }
    ended = threading.Event()
    with (
        running_server(load_settings(overrides=overrides)) as server,
        open_client([endpoint]) as client,
        CameraFeed(client),
        RobotEnd(client) as robot,
    ):

        def talk() -> None:
            while not ended.wait(0.5):
                robot.say()

        talking = threading.Thread(target=talk)
        talking.start()
        try:
            eventually(lambda: server.service.view().ready, within_s=60.0)
            yield server.url
        finally:
            ended.set()
            talking.join()


def fuzz(url: str, folder: Path, *, examples: int, config: str) -> int:
    """Send requests of every kind; returns how many there were, and fails on the first that was answered wrongly."""
    (folder / "schemathesis.toml").write_text(config)
    program = Path(sysconfig.get_path("scripts")) / "st"
    command = [program, "run", f"{url}api/v1/openapi.json", "--checks", "all", "--exclude-path", ENDLESS]
    command += ["--header", f"Authorization: Bearer {TOKEN}", "--max-examples", str(examples), "--seed", "1"]
    # A goal outside the picture is refused, whose size no schema knows.
    command += ["--exclude-checks", "positive_data_acceptance"]
    command += ["--phases", "coverage,fuzzing,stateful", "--generation-database", "none", "--continue-on-failure"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr
    count = re.search(r"(\d+) generated", done.stdout)
    assert count is not None, done.stdout
    return int(count[1])


def test_no_request_makes_it_fail_or_answer_what_is_not_documented(tiny_bundle: Path, tmp_path: Path) -> None:
    pytest.importorskip("schemathesis", reason="needs `pip install --group slow`")
    sent = 0
    with serving(tiny_bundle) as url:
        while sent < REQUESTS:
            examples = 100 + sent // 20
            sent += fuzz(url, tmp_path, examples=examples, config="")
            sent += fuzz(url, tmp_path, examples=examples, config=CONFIG)
    print(f"{sent} requests")
