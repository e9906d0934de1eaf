from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
import zenoh
from fastapi import FastAPI
from pydantic import SecretStr

from revnm_server.api import create_application
from revnm_server.api.health import health_router
from revnm_server.api.shared_state import SharedState
from revnm_server.camera import CameraSource, open_camera
from revnm_server.robots.mission import Mission
from revnm_server.service import NavigationService
from revnm_server.settings import HttpSettings

from .http_calls import Api
from .service_parts import CameraFeed, FakePipeline, RobotEnd
from .waiting import eventually

TOKEN = "0123456789abcdefXYZ"
VIEWER = "viewer0123456789ab"
GOAL = "/api/v1/robots/rover/goal"


@pytest.fixture
def camera(router: zenoh.Session) -> Iterator[CameraSource]:
    source = open_camera("zenoh://camera", router)
    yield source
    source.close()


@pytest.fixture
def pipeline() -> FakePipeline:
    return FakePipeline()


@pytest.fixture
def service(router: zenoh.Session, camera: CameraSource, pipeline: FakePipeline) -> Iterator[NavigationService]:
    running = NavigationService(router, camera=camera, pipeline=pipeline, mission=Mission(["rover"]), tick_hz=50)
    running.start()
    yield running
    running.close()


@pytest.fixture
def api(service: NavigationService) -> Api:
    return Api(create_application(service, HttpSettings()))


@pytest.fixture
def feed(router: zenoh.Session, camera: CameraSource) -> Iterator[None]:
    with CameraFeed(router):
        eventually(camera.latest)
        yield


def assert_problem(response: httpx.Response, status: int) -> dict[str, Any]:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    document: dict[str, Any] = response.json()
    assert document["status"] == status
    assert document["title"]
    assert document["type"] == "about:blank"
    return document


def test_a_goal_is_set_and_dropped(api: Api, service: NavigationService, feed: None, router: zenoh.Session) -> None:
    response = api.call("PUT", GOAL, json={"u": 250, "v": 200.5})
    assert response.status_code == 200
    goal = response.json()["goal"]
    assert (goal["u"], goal["v"]) == (250, 200.5)
    with RobotEnd(router) as robot:
        eventually(lambda: robot.say() or service.view().robots[0].status == "driving")
    assert api.call("GET", "/api/v1/state").json()["robots"][0]["goal"] == goal
    assert api.call("GET", "/api/v1/robots").json()[0]["goal"] == goal
    assert api.call("DELETE", GOAL).status_code == 204
    assert service.mission.of("rover").goal is None


def test_a_server_without_a_recorder_says_so(api: Api) -> None:
    assert api.call("GET", "/api/v1/state").json()["recording"] is None
    for method, path in (("GET", ""), ("POST", "/start"), ("POST", "/stop")):
        assert "without a recorder" in assert_problem(api.call(method, f"/api/v1/recording{path}"), 409)["detail"]


@pytest.mark.parametrize(
    "body",
    [
        b'{"u":320,"v":5}',
        b'{"u":-1,"v":5}',
        b'{"u":5,"v":240}',
        b'{"u":NaN,"v":5}',
        b'{"u":1e999,"v":5}',
        b'{"u":-Infinity,"v":5}',
        b'{"u":"5","v":5}',
        b'{"u":true,"v":5}',
        b'{"u":5}',
        b'{"u":5,"v":5,"w":5}',
        b"[5,5]",
        b"{",
        b"",
        b"\xff\xfe",
        b"null",
    ],
)
def test_a_bad_goal_is_a_problem_and_changes_nothing(
    api: Api, service: NavigationService, feed: None, body: bytes
) -> None:
    before = service.mission.set_goal("rover", 7, 8, size_px=(320, 240))
    response = api.call("PUT", GOAL, content=body, headers={"content-type": "application/json"})
    assert_problem(response, 422)
    assert service.mission.of("rover").goal == before


def test_every_other_error_is_a_problem_too(api: Api, service: NavigationService) -> None:
    good = {"u": 5, "v": 5}
    assert "not given a picture" in assert_problem(api.call("PUT", GOAL, json=good), 409)["detail"]
    assert "rover" in assert_problem(api.call("PUT", "/api/v1/robots/nobody/goal", json=good), 404)["detail"]
    assert_problem(api.call("DELETE", "/api/v1/robots/nobody/goal"), 404)
    assert_problem(api.call("POST", "/api/v1/robots/nobody/stop"), 404)
    assert_problem(api.call("POST", "/api/v1/robots/nobody/resume"), 404)
    assert_problem(api.call("GET", "/nothing"), 404)
    assert_problem(api.call("GET", "/page/../../secret"), 404)
    assert "GET" not in assert_problem(api.call("POST", GOAL), 405).get("detail", "")
    assert api.call("POST", GOAL).headers["allow"] == "DELETE, PUT"
    assert_problem(api.call("PUT", GOAL, content=b"\xff\xfe\x00", headers={"content-type": "application/json"}), 400)
    assert_problem(api.call("GET", "/api/v1/frame.jpg"), 409)
    assert_problem(api.call("GET", "/api/v1/stream.mjpg?layer=x"), 422)
    depth = assert_problem(api.call("GET", "/api/v1/stream.mjpg?layer=depth"), 409)
    assert "no depth picture" in depth["detail"]
    ego = "/api/v1/stream.mjpg?layer=ego"
    assert "robot=NAME" in assert_problem(api.call("GET", ego), 422)["detail"]
    assert "nobody" in assert_problem(api.call("GET", f"{ego}&robot=nobody"), 404)["detail"]
    assert "no imagined view" in assert_problem(api.call("GET", f"{ego}&robot=rover"), 409)["detail"]
    assert "no map" in assert_problem(api.call("GET", "/api/v1/stream.mjpg?layer=map"), 409)["detail"]
    assert_problem(api.call("PUT", GOAL, content=b"x" * 20_000), 413)
    assert_problem(api.call("PUT", GOAL, content=iter_async([b"{}"])), 411)
    assert service.mission.of("rover").goal is None


async def iter_async(parts: list[bytes]) -> AsyncIterator[bytes]:
    for part in parts:
        yield part


def test_a_failure_inside_is_a_problem_without_details(service: NavigationService) -> None:
    app = create_application(service, HttpSettings())

    @app.get("/broken")
    def broken() -> None:
        raise RuntimeError("secret details")

    document = assert_problem(Api(app).call("GET", "/broken"), 500)
    assert "secret" not in json.dumps(document)


def test_a_stopped_robot_takes_no_goal(api: Api, service: NavigationService, router: zenoh.Session, feed: None) -> None:
    with RobotEnd(router) as robot:
        answer = api.call("POST", "/api/v1/robots/rover/stop").json()
        assert (answer["stopped"], answer["acknowledged"], answer["epoch"]) == (True, True, robot.epoch)
        assert robot.stopped
        assert_problem(api.call("PUT", GOAL, json={"u": 5, "v": 5}), 409)
        assert service.mission.of("rover").goal is None
        answer = api.call("POST", "/api/v1/robots/rover/resume").json()
        assert (answer["stopped"], answer["acknowledged"]) == (False, True)
        assert api.call("PUT", GOAL, json={"u": 5, "v": 5}).status_code == 200


def test_a_stop_without_the_robot_says_that_nobody_confirmed(api: Api) -> None:
    answer = api.call("POST", "/api/v1/robots/rover/stop").json()
    assert (answer["stopped"], answer["acknowledged"]) == (True, False)


def test_health_and_readiness(api: Api, service: NavigationService, router: zenoh.Session) -> None:
    assert api.call("GET", "/healthz").json() == {"status": "ok"}
    reasons = assert_problem(api.call("GET", "/readyz"), 503)["reasons"]
    assert reasons[0] == "camera init: no picture yet"
    with CameraFeed(router), RobotEnd(router) as robot:
        eventually(lambda: robot.say() or service.view().ready)
        assert api.call("GET", "/readyz").json() == {"status": "ready"}


def test_a_tick_that_hangs_is_told_and_makes_the_process_unhealthy(
    service: NavigationService, pipeline: FakePipeline, feed: None
) -> None:
    app = FastAPI()
    app.include_router(health_router(service, lost_s=2.2))
    api = Api(app)
    assert api.call("GET", "/healthz").status_code == 200
    pipeline.going_on.clear()
    try:
        answer = eventually(lambda: (a := api.call("GET", "/healthz")).status_code == 503 and a)
        assert "at one picture for 2 s" in assert_problem(answer, 503)["detail"]
        assert any("hangs" in reason for reason in api.call("GET", "/readyz").json()["reasons"])
    finally:
        pipeline.going_on.set()
    eventually(lambda: api.call("GET", "/healthz").status_code == 200)


def test_metrics_are_served(api: Api) -> None:
    response = api.call("GET", "/metrics")
    assert response.headers["content-type"].startswith("text/plain; version=")
    assert "revnm_ready 0.0" in response.text


def test_the_picture_is_served(api: Api, feed: None) -> None:
    response = api.call("GET", "/api/v1/frame.jpg")
    assert response.headers["content-type"] == "image/jpeg"
    image = cv2.imdecode(np.frombuffer(response.content, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (240, 320, 3)


def test_the_page_and_its_parts_are_served(api: Api) -> None:
    page = api.call("GET", "/")
    assert "text/html" in page.headers["content-type"]
    assert "script-src 'self'" in page.headers["content-security-policy"]
    for name in ("app.js", "stream.js", "style.css"):
        assert f"page/{name}" in page.text or name == "stream.js"
        part = api.call("GET", f"/page/{name}")
        assert part.status_code == 200
        assert "http://" not in part.text + page.text
        assert "https://" not in part.text + page.text
    schema = api.call("GET", "/api/v1/openapi.json").json()
    assert GOAL.replace("rover", "{robot}") in schema["paths"]


def test_with_a_token_only_health_is_open(service: NavigationService) -> None:
    api = Api(create_application(service, HttpSettings(token=SecretStr(TOKEN))))
    assert api.call("GET", "/healthz").status_code == 200
    for path in ("/", "/api/v1/state", "/page/app.js", "/readyz", "/api/v1/openapi.json", "/nothing"):
        assert_problem(api.call("GET", path), 401)
        assert_problem(api.call("GET", path, headers={"authorization": f"Bearer {TOKEN}x"}), 401)
    assert_problem(api.call("POST", "/api/v1/robots/rover/stop"), 401)
    assert not service.mission.of("rover").stopped
    assert api.call("GET", "/api/v1/state", headers={"authorization": f"Bearer {TOKEN}"}).status_code == 200
    page = api.call("GET", f"/?token={TOKEN}")
    assert page.status_code == 200
    cookie = page.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert api.call("GET", "/api/v1/state", headers={"cookie": cookie.split(";")[0]}).status_code == 200
    crowded = 'other={"a": [1, "b"]}; ' + cookie.split(";")[0]  # of another server on the same machine
    assert api.call("GET", "/api/v1/state", headers={"cookie": crowded}).status_code == 200
    assert_problem(api.call("GET", "/api/v1/state", headers={"cookie": "revnm_token=é".encode("latin-1")}), 401)


def test_a_viewer_looks_and_stops_but_does_not_drive(service: NavigationService, feed: None) -> None:
    settings = HttpSettings(token=SecretStr(TOKEN), viewer_token=SecretStr(VIEWER))
    api = Api(create_application(service, settings))
    viewer, operator = ({"authorization": f"Bearer {token}"} for token in (VIEWER, TOKEN))
    assert api.call("GET", "/api/v1/session", headers=viewer).json() == {"role": "viewer"}
    assert api.call("GET", "/api/v1/session", headers=operator).json() == {"role": "operator"}
    assert api.call("GET", "/api/v1/state", headers=viewer).status_code == 200
    assert "operator" in assert_problem(api.call("PUT", GOAL, json={"u": 5, "v": 5}, headers=viewer), 403)["detail"]
    assert service.mission.of("rover").goal is None
    assert api.call("POST", "/api/v1/robots/rover/stop", headers=viewer).status_code == 200
    assert service.mission.of("rover").stopped
    assert_problem(api.call("POST", "/api/v1/robots/rover/resume", headers=viewer), 403)
    assert_problem(api.call("DELETE", GOAL, headers=viewer), 403)
    for path in ("/api/v1/robots/rover/stop/x", "/api/v1/robots/a/b/stop", "/x/api/v1/robots/rover/stop"):
        assert_problem(api.call("POST", path, headers=viewer), 403)
    assert service.mission.of("rover").stopped
    assert api.call("POST", "/api/v1/robots/rover/resume", headers=operator).status_code == 200
    cookie = api.call("GET", f"/?token={VIEWER}", headers={"cookie": f"revnm_token={TOKEN}"}).headers["set-cookie"]
    assert VIEWER in cookie  # who opens the page by a viewer's address becomes one
    assert_problem(api.call("GET", "/api/v1/state", headers={"authorization": f"Bearer {TOKEN}{VIEWER}"}), 401)


def test_without_a_token_everyone_is_an_operator(api: Api) -> None:
    assert api.call("GET", "/api/v1/session").json() == {"role": "operator"}


def test_pages_of_other_sites_can_do_nothing(api: Api, service: NavigationService) -> None:
    stop = "/api/v1/robots/rover/stop"
    assert_problem(api.call("POST", stop, headers={"origin": "http://evil.example"}), 403)
    assert_problem(api.call("POST", stop, headers={"origin": "http://["}), 403)
    for host in ("evil.example", "192.168.1.5", "127.0.0.1.evil.example", "[", "a]b", ""):
        assert_problem(api.call("POST", stop, headers={"host": host}), 421)
    assert not service.mission.of("rover").stopped
    assert api.call("POST", stop, headers={"origin": "http://127.0.0.1:8000"}).status_code == 200
    for host in ("localhost:8000", "127.0.0.2", "[::1]:8000"):
        assert api.call("GET", "/healthz", headers={"host": host}).status_code == 200
        assert api.call("GET", "/api/v1/state", headers={"host": host}).status_code == 200


@asynccontextmanager
async def websocket(app: FastAPI, **headers: str) -> AsyncIterator[asyncio.Queue[Any]]:
    """Connect to the events by the application's own interface; yields what it sends."""
    sent: asyncio.Queue[Any] = asyncio.Queue()
    to_app: asyncio.Queue[Any] = asyncio.Queue()
    to_app.put_nowait({"type": "websocket.connect"})
    scope = {
        "type": "websocket",
        "path": "/api/v1/events",
        "raw_path": b"/api/v1/events",
        "query_string": b"",
        "root_path": "",
        "scheme": "ws",
        "headers": [(key.encode(), value.encode()) for key, value in ({"host": "127.0.0.1"} | headers).items()],
        "subprotocols": [],
    }
    running = asyncio.create_task(app(scope, to_app.get, sent.put))
    yield sent
    to_app.put_nowait({"type": "websocket.disconnect", "code": 1000})
    await asyncio.wait_for(running, 5)


def test_events_tell_the_state_again_and_again(api: Api, service: NavigationService, feed: None) -> None:
    async def listen() -> list[Any]:
        async with websocket(api.app) as sent:
            return [await asyncio.wait_for(sent.get(), 5) for _ in range(4)]

    messages = asyncio.run(listen())
    assert messages[0]["type"] == "websocket.accept"
    for message in messages[1:]:
        assert json.loads(message["text"])["robots"][0]["name"] == "rover"


def test_the_state_is_made_once_for_all_who_ask_and_anew_when_something_is_wanted(service: NavigationService) -> None:
    now_s = 100.0
    shared = SharedState(service, now_s=lambda: now_s)
    first = shared.document()
    assert shared.document() is first
    service.mission.stop("rover")
    stopped = shared.document()
    assert json.loads(stopped)["robots"][0]["status"] == "stopped"
    now_s += 0.09
    assert shared.document() is stopped
    now_s += 0.02
    assert shared.document() is not stopped


def test_events_are_refused_to_other_sites(api: Api) -> None:
    async def listen() -> Any:
        async with websocket(api.app, origin="http://evil.example") as sent:
            return await asyncio.wait_for(sent.get(), 5)

    assert asyncio.run(listen())["type"] == "websocket.close"


def test_events_need_a_token_and_a_viewers_will_do(service: NavigationService, feed: None) -> None:
    app = create_application(service, HttpSettings(token=SecretStr(TOKEN), viewer_token=SecretStr(VIEWER)))

    async def listen(**headers: str) -> Any:
        async with websocket(app, **headers) as sent:
            return await asyncio.wait_for(sent.get(), 5)

    assert asyncio.run(listen())["type"] == "websocket.close"
    assert asyncio.run(listen(authorization=f"Bearer {VIEWER}"))["type"] == "websocket.accept"


def test_the_page_is_in_the_package() -> None:
    import revnm_server

    assert (Path(revnm_server.__file__).parent / "page" / "index.html").is_file()
