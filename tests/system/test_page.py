"""The operator's page in a real browser: the server, a robot client and the simulator are behind it."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Route
from tests.server.waiting import eventually

from revnm_client import keys
from revnm_client.link import open_client
from revnm_server.floor_camera import FloorCamera
from revnm_server.views.view import FloorCameraView

from .hall import CAMERA, SCENARIO
from .screen import DESKTOP, PHONE, PHONE_ON_ITS_SIDE, Screen, chromium, screen
from .speed_gauge import SpeedGauge
from .stage import Stage, stage

LENS = "lens"  # the name under which the simulator publishes its pictures
STANDS_WITHIN_S = 1.0
BADGE_WITHIN_S = 3.0
AUDIT = Path(__file__).with_name("page_audit.js").read_text()


class Cable:
    """Carries pictures from the simulator to the server's camera, until it is pulled."""

    def __init__(self, endpoint: str) -> None:
        self._plugged = threading.Event()
        self._plugged.set()
        self._opened = open_client([endpoint])
        session = self._opened.__enter__()
        out = keys.image(CAMERA)
        self._subscriber = session.declare_subscriber(  # kept: it ends with its last reference
            keys.image(LENS), lambda sample: session.put(out, sample.payload) if self._plugged.is_set() else None
        )

    def pull(self) -> None:
        self._plugged.clear()

    def plug(self) -> None:
        self._plugged.set()

    def close(self) -> None:
        self._plugged.clear()
        self._opened.__exit__(None, None, None)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def running(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Stage, Cable]]:
    """Everything at work; the browser is asked for first, so that nothing is started in vain without one."""
    with stage(tmp_path_factory.mktemp("page"), camera=LENS) as system:
        cable = Cable(system.server.listen)
        eventually(system.server.ready, within_s=30.0)
        yield system, cable
        cable.close()


@pytest.fixture
def system(running: tuple[Stage, Cable]) -> Stage:
    """The stage, its robot standing, free and without a goal."""
    system, cable = running
    cable.plug()
    system.server.call("POST", "/api/v1/robots/rover/stop")
    system.server.call("POST", "/api/v1/robots/rover/resume")
    eventually(lambda: system.server.rover()["status"] == "no_goal", within_s=10.0)
    SpeedGauge(system.simulation).wait_standing(within_s=10.0)
    return system


def pixel_near(system: Stage, distance_m: float) -> tuple[float, float]:
    """The pixel of a place so far from the robot, as nearly ahead as the hall has room."""
    pose = system.simulation.true_pose
    for turn in sorted(np.arange(-3.1, 3.2, 0.2), key=abs):
        x, y = pose.apply(distance_m * np.array([[math.cos(turn), math.sin(turn)]]))[0]
        if abs(x) < 2.3 and -1.5 < y < 0.9:
            (u, v), _ = SCENARIO.camera.project(np.array([x, y, 0.0]))
            return float(u), float(v)
    raise AssertionError(f"no place {distance_m} m from {pose}")


def goal_m(system: Stage) -> tuple[float, float]:
    """Where on the floor the goal is that the server has."""
    goal = system.server.rover()["goal"]
    ray = SCENARIO.camera.project(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))[0]
    # The camera looks straight down: pixels are linear in the floor's places.
    columns = np.stack([ray[1] - ray[0], ray[2] - ray[0]], axis=1)
    x, y = np.linalg.solve(columns, np.array([goal["u"], goal["v"]]) - ray[0])
    return float(x), float(y)


def start_driving(shown: Screen, system: Stage) -> None:
    shown.page.mouse.click(*shown.place(pixel_near(system, 2.0)))
    SpeedGauge(system.simulation).wait_faster(0.2, within_s=10.0)


def test_a_click_is_previewed_and_the_robot_arrives(browser: Browser, system: Stage) -> None:
    with screen(browser, system.server.url) as shown:
        shown.wait_live()
        target = pixel_near(system, 1.0)
        shown.page.mouse.move(*shown.place(target))
        shown.page.mouse.down()
        shown.says("hint", "Release")
        assert shown.count("overlay", "r === 255 && g === 204 && b === 51 && a === 255") > 20
        assert system.server.rover()["goal"] is None
        shown.page.mouse.up()
        goal = eventually(lambda: system.server.rover()["goal"])
        assert math.dist((goal["u"], goal["v"]), target) < 2.0
        shown.says("status", "Driving")
        shown.hides("hint")
        shown.says("status", "Arrived", within_s=30.0)
        pose = system.simulation.true_pose
        assert math.dist((pose.x_m, pose.y_m), goal_m(system)) < 0.3
        shown.says("spoken", "Arrived")
        assert not system.simulation.had_contact


@pytest.mark.parametrize("way", ["button", "space"])
def test_stop_makes_the_robot_stand_within_a_second(browser: Browser, system: Stage, way: str) -> None:
    gauge = SpeedGauge(system.simulation)
    with screen(browser, system.server.url) as shown:
        shown.wait_live()
        start_driving(shown, system)
        pressed_s = time.monotonic()
        if way == "space":
            shown.page.locator("input[value=depth]").focus()  # a control that would take the bar for itself
            shown.page.keyboard.press("Space")
        else:
            shown.page.locator("#stop").click()
        assert gauge.wait_standing(within_s=5.0) - pressed_s < STANDS_WITHIN_S
        shown.says("status", "Stopped")
        assert shown.page.locator("input[value=exo]").is_checked()
        assert system.server.rover()["goal"] is None
        # A goal is refused in words.
        shown.page.mouse.click(*shown.place((320, 240)))
        shown.says("message", "resume it")
        shown.page.locator("#resume").click()
        shown.says("status", "No goal")


def test_drags_and_escape_set_no_goal(browser: Browser, system: Stage) -> None:
    with screen(browser, system.server.url) as shown:
        shown.wait_live()
        x, y = shown.place(pixel_near(system, 1.0))
        mouse = shown.page.mouse
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + 30, y)
        shown.hides("hint")
        mouse.move(x, y)  # coming back is no click
        mouse.up()
        mouse.down()
        shown.page.keyboard.press("Escape")
        mouse.up()
        mouse.click(x, y, button="right")
        assert system.server.rover()["goal"] is None
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + 3, y)  # a hand that shakes
        mouse.up()
        eventually(lambda: system.server.rover()["goal"])


def test_the_keyboard_alone_is_enough(browser: Browser, system: Stage) -> None:
    with screen(browser, system.server.url) as shown:
        shown.wait_live()
        press = shown.page.keyboard.press
        for _ in range(10):
            press("Tab")
            if shown.page.evaluate("document.activeElement.id") == "overlay":
                break
        press("ArrowRight")  # the crosshair begins at the robot
        u, v = system.server.rover()["pixel"]
        for key in ("ArrowUp", "ArrowRight", "Shift+ArrowRight", "Shift+ArrowRight"):
            press(key)
        shown.says("hint", "Enter")
        press("Enter")
        goal = eventually(lambda: system.server.rover()["goal"])
        assert math.dist((goal["u"], goal["v"]), (u + 84, v - 4)) < 2.0  # steps of 4 px, and of 40
        SpeedGauge(system.simulation).wait_faster(0.1, within_s=10.0)
        press("Space")
        shown.says("status", "Stopped")
        shown.page.locator("#resume").focus()
        press("Enter")
        shown.says("status", "No goal")
        shown.page.locator("#overlay").focus()
        press("ArrowUp")
        press("Escape")
        press("Enter")
        assert system.server.rover()["goal"] is None


def test_a_dead_camera_is_told_at_once_and_so_is_its_return(
    browser: Browser, running: tuple[Stage, Cable], system: Stage
) -> None:
    _, cable = running
    with screen(browser, system.server.url) as shown:
        shown.wait_live()
        cable.pull()
        pulled_s = time.monotonic()
        shown.wait("document.getElementById('badge').classList.contains('bad')", within_s=BADGE_WITHIN_S)
        assert time.monotonic() - pulled_s < BADGE_WITHIN_S
        shown.wait("getComputedStyle(document.getElementById('picture')).filter.includes('grayscale(1)')")
        shown.says("notice", "no new picture")
        cable.plug()
        shown.wait_live()
        shown.wait("getComputedStyle(document.getElementById('picture')).filter === 'none'")
        shown.hides("notice")


def test_layers_are_shown_and_goals_are_set_in_the_cameras_pixels_only(browser: Browser, system: Stage) -> None:
    with screen(browser, system.server.url) as shown:
        shown.wait_live()
        shown.page.get_by_label("Depth").check()
        shown.wait("document.getElementById('picture').width === 640")
        eventually(lambda: shown.count("picture", "r > g + 60") > 1000)  # the tiny model takes bright things for near
        shown.page.get_by_label("Robot’s view").check()
        shown.says("notice", "imagined while it drives")
        assert shown.text("badge") == "live"  # that is no fault
        shown.hides("overlay")
        start = shown.page.locator("#view").bounding_box()
        assert start is not None
        shown.page.mouse.click(start["x"] + start["width"] / 2, start["y"] + start["height"] / 2)
        shown.says("hint", "camera")
        assert system.server.rover()["goal"] is None


def test_a_phone_has_stop_in_view_and_taps_but_does_not_mistake_a_swipe(browser: Browser, system: Stage) -> None:
    with screen(browser, system.server.url, size=PHONE, touch=True) as shown:
        shown.wait_live()
        x, y = shown.place(pixel_near(system, 1.0))
        shown.swipe(x, y, down_px=60.0)
        assert system.server.rover()["goal"] is None
        shown.page.touchscreen.tap(x, y)
        eventually(lambda: system.server.rover()["goal"])
        shown.page.locator("#stop").tap()
        shown.says("status", "Stopped")


@pytest.mark.parametrize("size", [DESKTOP, PHONE, PHONE_ON_ITS_SIDE])
def test_everything_has_a_name_contrast_and_room(browser: Browser, system: Stage, size: tuple[int, int]) -> None:
    with screen(browser, system.server.url, size=size) as shown:
        shown.wait_live()
        assert shown.page.evaluate(AUDIT) == []
        system.server.call("POST", "/api/v1/robots/rover/stop")
        shown.says("status", "Stopped")
        assert shown.page.evaluate(AUDIT) == []


def made_up(shown: Screen, state: dict[str, Any]) -> None:
    """Show a state that the server is not in."""
    page = shown.page
    page.route("**/api/v1/state", lambda route: route.fulfill(json=state))
    page.route_web_socket("**/api/v1/events", lambda socket: socket.send(json.dumps(state)))
    page.reload(wait_until="domcontentloaded")
    shown.wait("document.getElementById('status').textContent !== '–'")


def test_several_robots_are_chosen_and_stopped_one_or_all(browser: Browser, system: Stage) -> None:
    state = system.server.state()
    first = state["robots"][0]
    second = first | {"name": "cart", "status": "driving", "reason": "robot: plan is 0.9 s old"}
    state["robots"] = [first, second, first | {"name": "lift", "status": "stopped"}]
    with screen(browser, system.server.url) as shown:
        made_up(shown, state)
        asked: list[str] = []
        shown.page.route("**/robots/**", lambda route: (asked.append(route.request.url), route.fulfill(json={})))
        shown.page.get_by_label("cart").check()
        shown.says("status", "Standing")
        assert shown.text("reason") == "plan is 0.9 s old"
        assert shown.text("stop-text") == "Stop cart"
        shown.hides("resume")
        shown.page.keyboard.press("Space")
        eventually(lambda: shown.page.wait_for_timeout(10) or asked)
        assert [url.rpartition("/robots/")[2] for url in asked] == ["cart/stop"]
        assert shown.page.get_by_label("cart").is_checked()
        asked.clear()
        shown.page.keyboard.press("Shift+Space")
        eventually(lambda: shown.page.wait_for_timeout(10) or len(asked) == 3)
        assert {url.rpartition("/robots/")[2] for url in asked} == {"rover/stop", "cart/stop", "lift/stop"}
        assert shown.page.evaluate(AUDIT) == []


def test_who_may_only_watch_may_stop(browser: Browser, system: Stage) -> None:
    state = system.server.state()
    state["robots"][0] |= {"status": "stopped", "goal": {"u": 100.0, "v": 100.0, "id": "a"}}
    with screen(browser, system.server.url, size=PHONE) as shown:
        shown.page.route("**/api/v1/session", lambda route: route.fulfill(json={"role": "viewer"}))
        made_up(shown, state)
        asked: list[str] = []

        def note(route: Route) -> None:
            asked.append(f"{route.request.method} {route.request.url.rpartition('/')[2]}")
            route.fulfill(json={})

        shown.page.route("**/robots/**", note)
        shown.says("watching", "stop robots")
        for name in ("resume", "drop"):
            shown.hides(name)
        shown.page.mouse.click(*shown.place((320, 240)))
        assert asked == []
        shown.page.locator("#stop").click()
        eventually(lambda: shown.page.wait_for_timeout(10) or asked)
        assert asked == ["POST stop"]
        assert shown.page.evaluate(AUDIT) == []


def test_the_preview_is_as_large_as_the_robot_by_the_learnt_camera(browser: Browser, system: Stage) -> None:
    camera = FloorCamera((640, 480), 420.0, 0.35, 0.03, 2.6, -0.12)
    numbers = asdict(FloorCameraView.of(camera))
    state = system.server.state()
    state["camera"]["calibration"] = {
        "status": "good", "progress": 1.0, "spread_1_m_cm": 1.0, "spread_2_m_cm": 2.0, "event": None, "camera": numbers,
    }  # fmt: skip
    pixels = np.random.default_rng(0).uniform((5, 5), (635, 475), (40, 2))
    expected, valid = camera.on_plane(pixels - 0.5)
    with screen(browser, system.server.url) as shown:
        found = shown.page.evaluate(
            """async ([camera, pixels]) => {
                const {onFloor, inPicture} = await import("/page/floor.js");
                return pixels.map(([u, v]) => {
                    const place = onFloor(camera, [640, 480], {u, v});
                    return place && [...place, ...Object.values(inPicture(camera, [640, 480], place))];
                });
            }""",
            [numbers, pixels.tolist()],
        )
        assert [each is not None for each in found] == valid.tolist()
        seen = np.array([each for each in found if each is not None])
        assert len(seen) > 20
        assert np.allclose(seen[:, :2], expected[valid], rtol=1e-3)
        assert np.allclose(seen[:, 2:], pixels[valid], atol=0.01)
        made_up(shown, state)
        shown.page.mouse.move(*shown.place((320, 300)))
        shown.page.mouse.down()
        shown.says("hint", "Release")
        # The ring's filling: the robot's circle of 0.28 m, seen at some 4 m.
        filled = "r > 200 && g > 150 && b < 120 && a > 40 && a < 90"
        assert 300 < shown.count("overlay", filled) < 20_000
        shown.page.keyboard.press("Escape")
        shown.hides("hint")
        assert shown.count("overlay", filled) < 30
        shown.page.mouse.up()
        shown.page.mouse.click(*shown.place((320, 5)))
        shown.says("message", "not on the floor")
    assert system.server.rover()["goal"] is None
