"""``revnm-sim endurance``: a server at work for long, whose camera fails again and again; its memory and its threads.

Simulator and camera run here, server and robot client as processes of their own, as on their machines. Linux only: what
a process takes is read from ``/proc``.
"""

from __future__ import annotations

import argparse
import math
import shlex
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from revnm_client.errors import ConfigError
from revnm_client.link import open_client
from revnm_sim.bench.report import make_folder, table, write_report
from revnm_sim.camera_trial import BREAKAGES, wait_until
from revnm_sim.children import Children
from revnm_sim.demo import CHILD_ENV, ROBOT, free_address
from revnm_sim.live import LiveSettings, LiveSimulator
from revnm_sim.rtsp_server import Fault, RtspServer, filming
from revnm_sim.scenario import Scenario, demo_scenario
from revnm_sim.server_api import ServerApi
from revnm_sim.simulation import TAG_ID, Simulation

_FPS = 10.0
_HOLD_S = 5.0  # a fault
_POLL_S = 0.2
_WARM_UP = 0.1  # of the time, whose rows do not count: caches fill


@dataclass(slots=True)
class _Minute:
    """What happened since the last row."""

    recoveries_s: list[float] = field(default_factory=list)
    arrivals: int = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument("--minutes", type=float, default=30.0, help="how long (default: 30)")
    parser.add_argument("--every", type=float, default=20.0, help="seconds from fault to fault (default: 20)")
    parser.add_argument("--seed", type=int, default=0, help="of the world and of the faults (default: 0)")
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json and logs")


def run(args: argparse.Namespace) -> int:
    """Measure, write the report and print the tables."""
    if not args.minutes > 0.0 or args.every < _HOLD_S or args.seed < 0:
        raise ConfigError(f"expected --minutes over 0, --every of {_HOLD_S:g} s at least, and --seed of at least 0")
    make_folder(args.out)
    scenario = demo_scenario(args.seed)
    with RtspServer(fps=_FPS) as camera, Children(args.out) as children, Simulation(scenario, args.seed) as simulation:
        endpoint, http = f"tcp/{free_address()}", free_address()
        with filming(camera, lambda _: simulation.picture(), fps=_FPS):
            ready_s = _start(children, camera, endpoint, http)
        with _driving(simulation, endpoint, camera):
            work = _Work(children, ServerApi(f"http://{http}"), camera, scenario, args)
            rows = list(work.rows())
    verdict = verdict_of(rows, ready_s, contact=simulation.had_contact)
    options = ["--minutes", f"{args.minutes:g}", "--every", f"{args.every:g}", "--seed", str(args.seed)]
    write_report(args.out / "report.json", [*rows, verdict], shlex.join(["revnm-sim", "endurance", *options]))
    print(table(rows), table([verdict]), sep="\n\n")
    return 0


def _start(children: Children, camera: RtspServer, endpoint: str, http: str) -> float:
    """Start robot client and server; return after how long the server was ready, seconds."""
    server = ["serve", "--camera", camera.url, "--listen", endpoint, "--http", http, "--robot", f"{ROBOT}={TAG_ID}"]
    children.start("robot", "revnm_client.cli", ["run", "--robot", ROBOT, "--connect", endpoint], env=CHILD_ENV)
    api, began_s = ServerApi(f"http://{http}"), time.monotonic()
    children.start("server", "revnm_server.cli", server, env=CHILD_ENV)

    def ready() -> bool:
        children.check()
        return api.not_ready() is None

    wait_until(ready, what="ready server")
    return time.monotonic() - began_s


@contextmanager
def _driving(simulation: Simulation, endpoint: str, camera: RtspServer) -> Iterator[None]:
    """Let the robot drive and the camera film it, in a thread of their own."""
    stop, settings = threading.Event(), LiveSettings(ROBOT, "unused", fps=_FPS)
    with (
        open_client([endpoint]) as session,
        LiveSimulator(simulation, session, settings, show=camera.show) as live,
    ):
        thread = threading.Thread(target=live.run, args=(stop,), name="simulator")
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


class _Work:
    """Sends the robot to and fro, and breaks the camera."""

    def __init__(
        self, children: Children, api: ServerApi, camera: RtspServer, scenario: Scenario, args: argparse.Namespace
    ) -> None:
        self._children, self._api, self._camera = children, api, camera
        self._ends_m = [scenario.goal_m, tuple(scenario.start[:2])]
        self._project = scenario.camera.project
        self._minutes, self._every_s = args.minutes, args.every
        self._rng = np.random.default_rng(args.seed)
        self._minute = _Minute()

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield a row after each minute, or each tenth of less than ten."""
        count = max(10, round(self._minutes))
        for number in tqdm(range(1, count + 1), desc="endurance", unit=" rows"):
            ends_s = time.monotonic() + 60.0 * self._minutes / count
            self._minute = _Minute()
            while time.monotonic() < ends_s:
                self._break(min(ends_s, time.monotonic() + self._every_s))
            yield self._row(number * self._minutes / count)

    def _break(self, until_s: float) -> None:
        """Break the camera, mend it, and let the robot drive until a time."""
        fault = str(self._rng.choice(list(BREAKAGES)))
        BREAKAGES[fault](self._camera)
        if fault != "dropped":
            self._drive(time.monotonic() + _HOLD_S)
        self._camera.set_fault(Fault.NONE)
        self._minute.recoveries_s.append(wait_until(self._runs, what=f"recovery from {fault}"))
        self._drive(until_s)

    def _drive(self, until_s: float) -> None:
        """Give the robot the other goal whenever it has arrived, and at first."""
        while time.monotonic() < until_s:
            self._children.check()
            view = self._api.state()["robots"][0]
            if view["status"] in ("no_goal", "arrived"):
                self._minute.arrivals += view["status"] == "arrived"
                pixel, _ = self._project(np.array([*self._ends_m[0], 0.0]))
                self._ends_m.reverse()
                self._api.set_goal(ROBOT, u=float(pixel[0]), v=float(pixel[1]))
            threading.Event().wait(_POLL_S)

    def _runs(self) -> bool:
        self._children.check()
        return bool(self._api.state()["camera"]["state"] == "running")

    def _row(self, minute: float) -> dict[str, Any]:
        status = _proc_status(self._children.pid("server"))
        tick = self._api.state()["timings_ms"].get("tick", {"p50": math.nan, "p95": math.nan})
        return {
            "minute": round(minute, 1),
            "rss_mb": round(status["VmRSS"] / 1024.0, 1),
            "threads": status["Threads"],
            "faults": len(self._minute.recoveries_s),
            "slowest_recovery_s": round(max(self._minute.recoveries_s), 2),
            "arrivals": self._minute.arrivals,
            "tick_p50_ms": tick["p50"],
            "tick_p95_ms": tick["p95"],
        }


def _proc_status(pid: int) -> dict[str, int]:
    """Return the numbers of a process's ``/proc`` status; memory in KiB."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    pairs = (line.split(":", 1) for line in lines)
    return {name: int(value.split()[0]) for name, value in pairs if value.split() and value.split()[0].isdecimal()}


def verdict_of(rows: list[dict[str, Any]], ready_s: float, *, contact: bool) -> dict[str, Any]:
    """Compare the last third with the first third of the rows after warm-up."""
    warm = rows[math.ceil(_WARM_UP * len(rows)) :]
    third = max(1, len(warm) // 3)
    first, last = (np.median([row["rss_mb"] for row in part]) for part in (warm[:third], warm[-third:]))
    return {
        "ready_s": round(ready_s, 2),
        "rss_growth_percent": round(100.0 * float(last / first - 1.0), 2),
        "threads_first": warm[0]["threads"],
        "threads_most": max(row["threads"] for row in warm),
        "threads_last": warm[-1]["threads"],
        "faults": sum(row["faults"] for row in rows),
        "slowest_recovery_s": max(row["slowest_recovery_s"] for row in rows),
        "arrivals": sum(row["arrivals"] for row in rows),
        "contact": contact,
    }
