"""The whole server on real input: H.264 over RTSP in, plans over Zenoh out, a goal over HTTP."""

from __future__ import annotations

from pathlib import Path

import cv2
import httpx
import numpy as np
from numpy.typing import NDArray

from revnm_client.link import open_client
from revnm_server.app import running_server
from revnm_server.settings import load_settings
from revnm_sim.live.rtsp_server import Fault, RtspServer, filming

from .free_port import free_port
from .service_parts import RobotEnd
from .tag_scene import draw_tag, picture_from_tag, project
from .waiting import eventually

TAG_ID = 3
GOAL = {"u": 560.0, "v": 300.0}


def floor(height: int, width: int) -> NDArray[np.uint8]:
    """A tiled floor, darker towards the horizon, with sensor noise."""
    rows, columns = np.mgrid[0:height, 0:width]
    tiles = (((rows // 40) + (columns // 40)) % 2) * 18
    gray = 90 + 60 * rows / height + tiles + np.random.default_rng(5).normal(0, 3, (height, width))
    return cv2.GaussianBlur(gray.clip(0, 255).astype(np.uint8), (3, 3), 0)


def test_a_click_becomes_plans(tiny_bundle: Path, tmp_path: Path) -> None:
    homography = picture_from_tag(centre=(220.0, 260.0), side_px=60.0, turn_rad=0.6, tilt=0.3)
    gray = draw_tag(floor(480, 640), TAG_ID, homography)
    image = np.repeat(gray[:, :, None], 3, axis=2)

    def picture(index: int) -> NDArray[np.uint8]:
        return np.roll(image, index % 2, axis=0)  # a camera that trembles by a pixel

    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with RtspServer(login=("viewer", "s3cret")) as stream, filming(stream, picture, fps=15):
        settings = load_settings(
            overrides={
                "camera": {"url": stream.url},
                "zenoh": {"listen": [endpoint]},
                "http": {"port": 0},
                "robots": {"rover": TAG_ID},
                "perception": {"bundle": tiny_bundle},
                "state_file": tmp_path / "state.json",
            }
        )
        with (
            running_server(settings) as server,
            open_client([endpoint]) as client,
            RobotEnd(client) as robot,
            httpx.Client(base_url=server.url, timeout=5.0, trust_env=False) as http,
        ):

            def state() -> dict[str, object]:
                return dict(http.get("/api/v1/state").json())

            shown = eventually(lambda: state()["robots"][0]["pixel"] and state(), within_s=20.0)  # type: ignore[index]
            assert "s3cret" not in str(shown)
            rover = shown["robots"][0]  # type: ignore[index]
            centre = project(homography, np.zeros((1, 2)))[0]
            assert np.hypot(*(np.array(rover["pixel"]) - centre)) < 2.5
            assert rover["status"] == "no_goal"
            assert robot.plans == []

            goal = http.put("/api/v1/robots/rover/goal", json=GOAL)
            assert goal.status_code == 200
            eventually(lambda: len(robot.plans) >= 3)
            plan = robot.plans[-1]
            assert plan.goal_id == goal.json()["goal"]["id"]
            assert plan.waypoints_m.shape == (5, 2)
            assert np.allclose(np.hypot(*plan.waypoints_m.T), 0.3 * np.arange(1, 6), atol=1e-3)
            eventually(lambda: robot.say() or state()["robots"][0]["path_px"])  # type: ignore[index]
            assert state()["robots"][0]["status"] == "driving"  # type: ignore[index]
            assert set(state()["timings_ms"]) == {"depth", "tag", "exo2ego", "policy", "tick"}  # type: ignore[call-overload]

            eventually(lambda: robot.say() or http.get("/readyz").status_code == 200)
            stream.set_fault(Fault.FROZEN)
            eventually(lambda: http.get("/readyz").status_code == 503, within_s=5.0)
            frozen = eventually(lambda: state()["robots"][0]["status"] == "waiting" and state())  # type: ignore[index]
            assert "camera" in frozen["robots"][0]["reason"]  # type: ignore[index]
            count = len(robot.plans)

            stopped = http.post("/api/v1/robots/rover/stop").json()
            assert stopped["acknowledged"] is True
            assert len(robot.plans) == count
        assert robot.stopped
