"""Recording as people use it: switched over HTTP and by command, replayed without the camera or the robot."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray

from revnm_client import keys
from revnm_client.cdr import encode_image, encode_odometry
from revnm_client.link import open_client
from revnm_client.messages import CompressedImage
from revnm_server.app import RunningServer, running_server
from revnm_server.camera.jpeg import encode_jpeg
from revnm_server.cli import main
from revnm_server.recording.cost import measure
from revnm_server.settings import load_settings

from .free_port import free_port
from .recording_parts import odometry, read, records
from .service_parts import RobotEnd
from .tag_scene import draw_tag, picture_from_tag
from .tiny_bundle import write_tiny_bundle
from .waiting import eventually

TOKEN = "0123456789abcdefXYZ"


@dataclass
class Site:
    server: RunningServer
    http: httpx.Client
    robot: RobotEnd
    folder: Path
    url: str


def seen_tag(centre: tuple[float, float]) -> NDArray[np.uint8]:
    noise = np.random.default_rng(5).normal(110, 6, (240, 320)).clip(0, 255).astype(np.uint8)
    gray = draw_tag(noise, 3, picture_from_tag(centre=centre, side_px=40.0, turn_rad=0.6))
    return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2RGB), dtype=np.uint8)


class Surroundings(threading.Thread):
    """Camera and odometry over Zenoh: the tag moves to the right."""

    def __init__(self, session: zenoh.Session) -> None:
        super().__init__(daemon=True)
        self._session, self._over = session, threading.Event()
        self._pictures = [encode_jpeg(seen_tag((100.0 + 4.0 * step, 120.0))) for step in range(12)]

    def run(self) -> None:
        step = 0
        while not self._over.wait(0.05):
            stamp_ns = time.time_ns()
            self._session.put(keys.odom("rover"), encode_odometry(odometry(stamp_ns, 0.02 * step)))
            picture = CompressedImage(stamp_ns, "jpeg", self._pictures[step % len(self._pictures)])
            self._session.put(keys.image("camera"), encode_image(picture))
            step += 1

    def end(self) -> None:
        self._over.set()
        self.join()


@pytest.fixture(params=["picture", "bev"])
def site(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    monkeypatch.setenv("REVNM_HTTP__TOKEN", TOKEN)
    endpoint, folder = f"tcp/127.0.0.1:{free_port()}", tmp_path / "records"
    bundle = write_tiny_bundle(tmp_path / "tiny")
    overrides = {
        "zenoh": {"listen": [endpoint]},
        "http": {"port": 0},
        "robots": {"rover": 3},
        "perception": {"bundle": bundle, "planner": "bev" if request.param == "bev" else "revnm"},
        "recording": {"folder": folder, "least_free_gb": 0.0},
    }
    with (
        running_server(load_settings(overrides=overrides)) as server,
        open_client([endpoint]) as client,
        RobotEnd(client) as robot,
        httpx.Client(
            base_url=server.url, timeout=10.0, trust_env=False, headers={"Authorization": f"Bearer {TOKEN}"}
        ) as http,
    ):
        surroundings = Surroundings(client)
        surroundings.start()
        eventually(lambda: http.get("/api/v1/state").json()["robots"][0]["pixel"], within_s=30.0)
        yield Site(server, http, robot, folder, server.url)
        surroundings.end()


def test_a_drive_is_recorded_and_replays_to_the_same_plans(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def said(*words: str) -> str:
        assert main(["record", *words, "--server", site.url]) == 0
        return capsys.readouterr().out

    assert said("status") == "nothing is recorded\n"
    assert said("start").startswith("recording revnm-")
    assert site.http.put("/api/v1/robots/rover/goal", json={"u": 260.0, "v": 120.0}).status_code == 200
    eventually(lambda: len(site.robot.plans) >= 12)
    state = site.http.get("/api/v1/state").json()["recording"]
    assert state["active"] is True
    assert state["dropped"] == 0
    assert said("stop").startswith("recorded revnm-")
    assert site.http.get("/api/v1/recording").json()["active"] is False
    [path] = records(site.folder)
    assert TOKEN.encode() not in path.read_bytes()

    # On another machine, where the server's bundle lies elsewhere.
    bundle = tmp_path / "elsewhere"
    (tmp_path / "tiny").rename(bundle)
    out = tmp_path / "out"
    assert main(["replay", str(path), "--bundle", str(bundle), "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    whole, rover = report["rows"]
    assert whole["ticks"] == whole["original_pictures"] == len(read(path)["/revnm/tick"]) - whole["early_ticks"]
    assert (whole["broken_ticks"], whole["missing_messages"], whole["failed_replayed"]) == (0, 0, 0)
    assert whole["early_ticks"] <= 2
    assert rover["plans_recorded"] >= 9
    assert (rover["plans_in_both"], rover["agreement"]) == (rover["plans_recorded"], 1.0)
    assert rover["max_m"] <= 0.002  # the tag detector had followed the tag before the record began
    assert capsys.readouterr().err == ""

    # The check can fail: with models that steer straight ahead, plans lie elsewhere.
    if site.http.get("/api/v1/state").json()["camera"]["calibration"] is None:
        other = write_tiny_bundle(tmp_path / "other", steer="ahead")
        assert main(["replay", str(path), "--bundle", str(other), "--out", str(out)]) == 1
        printed = capsys.readouterr()
        assert "made with other models" in printed.err
        assert "not within 0.05 m" in printed.out


def test_what_cannot_be_replayed_or_recovered_is_said_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    for words, text in (
        (["replay", str(cut), "--out", str(tmp_path / "out")], "see revnm-server record recover"),
        (["replay", str(tmp_path / "none"), "--out", str(tmp_path / "out")], "No such file"),
        (["replay", str(cut), "--tolerance-m", "nan", "--out", str(tmp_path / "out")], "expected 0 or more"),
        (["record", "recover", str(cut)], "no message can be read"),
        (["record", "status", "--server", "127.0.0.1:1"], "expected http://HOST:PORT"),
        (["record", "stop", "--server", "http://127.0.0.1:1"], "refused"),
        (["record", "stop", "--token-file", str(tmp_path / "none")], "No such file"),
    ):
        assert main(words) == 2
        assert text in capsys.readouterr().err


def test_a_server_without_a_folder_says_what_to_set(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    token_file = tmp_path / "token"
    token_file.write_text(TOKEN + "\n")
    overrides = {
        "zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"]},
        "http": {"port": 0, "token": TOKEN},
        "perception": {"bundle": tiny_bundle},
    }
    with running_server(load_settings(overrides=overrides)) as server:
        words = ["record", "start", "--server", server.url]
        assert main(words) == 2
        assert "401" in capsys.readouterr().err
        assert main([*words, "--token-file", str(token_file)]) == 2
        assert "409: nothing can be recorded: set recording.folder" in capsys.readouterr().err


@pytest.mark.parametrize("original", [True, False])
def test_the_cost_is_measured_on_a_record(original: bool) -> None:
    row = measure((64, 48), original=original, seconds=0.3)
    assert (row["ticks"], row["dropped"], row["width_px"]) == (3, 0, 64)
    assert row["pictures"] == ("original" if original else "encoded")
    assert 0.0 < row["tick_p50_us"] <= row["tick_p95_us"]
    assert row["mb_per_min"] > 1.0
    assert row["writer_cpu_share"] > 0.0
