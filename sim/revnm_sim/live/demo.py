"""``revnm-sim demo``: simulator, server and robot client as three processes on this machine."""

from __future__ import annotations

import math
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from revnm_client.errors import LinkError
from revnm_client.link import LatestSubscriber, open_client
from revnm_sim.live.children import Children
from revnm_sim.live.server_api import ServerApi
from revnm_sim.live.summary import DriveSummary, format_summary
from revnm_sim.live.truth import Truth, decode_truth, truth_key
from revnm_sim.scenario import demo_scenario
from revnm_sim.simulation import TAG_ID

ROBOT, CAMERA = "rover", "cam0"
_DEFAULT_HTTP = "127.0.0.1:8000"
_READY_WITHIN_S = 60.0
_POLL_S = 0.1
# Three processes share the machine's cores: a pool of threads each would only make them wait for each other.
CHILD_ENV = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True, slots=True)
class DemoSettings:
    """What to run.

    Attributes:
        seed: Of the world, and of the robot's sensors.
        headless: Set the goal by HTTP and end on arrival; else a person clicks.
        timeout_s: Headless, how long the drive may take.
        http: HOST:PORT of the page; None for the usual one, or headless a free one.
        planner: The server's; None for its default.
    """

    seed: int
    headless: bool
    timeout_s: float
    http: str | None
    planner: str | None


class Stopped(Exception):  # noqa: N818 - no error: somebody pressed Ctrl-C
    """The demo was asked to end."""


def run_demo(settings: DemoSettings, stop: threading.Event, say: Callable[[str], None]) -> int:
    """Run the demo until it is over or ``stop`` is set; return the exit status.

    Args:
        settings: What to run.
        stop: Set it to end the demo.
        say: Takes the lines for the person who watches.

    Raises:
        ChildError: One of the three processes ended by itself.
        LinkError: The server did not become ready or refused the goal.
    """
    folder = Path(tempfile.mkdtemp(prefix="revnm-demo-"))
    endpoint = f"tcp/{free_address()}"
    http = settings.http or (free_address() if settings.headless else _DEFAULT_HTTP)
    say(f"logs: {folder}")
    with Children(folder) as children:
        _start(children, settings, folder=folder, endpoint=endpoint, http=http)
        demo = _Demo(children, ServerApi(f"http://{http}"), stop)
        try:
            demo.wait_until_ready()
            say(f"page: http://{http}")
            if settings.headless:
                summary = demo.drive(settings, endpoint)
                say(format_summary(summary))
                return 0 if summary.arrived and not summary.contact else 1
            say("click into the picture to set a goal; Ctrl-C ends the demo")
            demo.watch()
        except Stopped:
            say("stopped")
    return 1 if settings.headless else 0


def _start(children: Children, settings: DemoSettings, *, folder: Path, endpoint: str, http: str) -> None:
    server = ["serve", "--camera", f"zenoh://{CAMERA}", "--listen", endpoint, "--http", http]
    server += ["--robot", f"{ROBOT}={TAG_ID}", "--state-file", str(folder / "state.json")]
    server += ["--planner", settings.planner] if settings.planner else []
    simulator = ["run", "--seed", str(settings.seed), "--robot", ROBOT, "--camera", CAMERA, "--connect", endpoint]
    robot = ["run", "--robot", ROBOT, "--connect", endpoint]
    children.start("server", "revnm_server.cli", server, env=CHILD_ENV)
    children.start("robot", "revnm_client.cli", robot, env=CHILD_ENV)
    children.start("simulator", "revnm_sim.cli", simulator, env=CHILD_ENV)


class _Demo:
    """The three running processes, as seen from outside."""

    def __init__(self, children: Children, api: ServerApi, stop: threading.Event) -> None:
        self._children = children
        self._api = api
        self._stop = stop

    def wait_until_ready(self) -> None:
        reason: str | None = None
        for _ in self._polls(_READY_WITHIN_S):
            reason = self._api.not_ready()
            if reason is None:
                return
        raise LinkError(f"the server was not ready within {_READY_WITHIN_S:.0f} s: {reason}")

    def watch(self) -> None:
        """Wait until somebody stops the demo."""
        for _ in self._polls(math.inf):
            pass

    def drive(self, settings: DemoSettings, endpoint: str) -> DriveSummary:
        """Send the robot to the goal of the scenario and wait until it is there, or the time is up."""
        scenario = demo_scenario(settings.seed)
        pixel, _ = scenario.camera.project(np.array([*scenario.goal_m, 0.0]))
        with (
            open_client([endpoint], stop=self._stop) as session,
            LatestSubscriber(session, truth_key(ROBOT)) as truths,
        ):
            before = self._next_truth(truths)
            self._api.set_goal(ROBOT, u=float(pixel[0]), v=float(pixel[1]))
            began_s = time.monotonic()
            arrived = self._arrives(settings.timeout_s)
            duration_s = time.monotonic() - began_s
            state = self._api.state()
            after = self._next_truth(truths)
        robot_state = _robot_view(state)["robot_state"] or {}
        return DriveSummary(
            arrived=arrived,
            duration_s=duration_s,
            path_m=after.path_m - before.path_m,
            goal_error_m=math.dist((after.x_m, after.y_m), scenario.goal_m),
            closest_m=after.closest_m,
            contact=after.contact,
            stages_ms={stage: (each["p50"], each["p95"]) for stage, each in state["timings_ms"].items()},
            robot_tick_ms=(robot_state.get("tick_p50_ms"), robot_state.get("tick_p95_ms")),
        )

    def _arrives(self, within_s: float) -> bool:
        for _ in self._polls(within_s):
            try:
                status = _robot_view(self._api.state())["status"]
            except LinkError:
                continue  # the server is busy; if it is dead, the next poll says so
            if status == "arrived":
                return True
        return False

    def _next_truth(self, truths: LatestSubscriber) -> Truth:
        truths.take()
        for _ in self._polls(5.0):
            sample = truths.take()
            if sample is not None:
                return decode_truth(sample.payload.to_bytes())
        raise LinkError(f"nothing came on {truths.key} for 5 s")

    def _polls(self, within_s: float) -> Iterator[None]:
        """Yield at intervals until the time is up; end early when a child dies or somebody stops the demo."""
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            self._children.check()
            yield
            if self._stop.wait(_POLL_S):
                raise Stopped


def _robot_view(state: dict[str, Any]) -> dict[str, Any]:
    view: dict[str, Any] = next(robot for robot in state["robots"] if robot["name"] == ROBOT)
    return view


def free_address() -> str:
    """Return HOST:PORT of this machine at which nothing listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"
