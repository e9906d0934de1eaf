"""Runs ``revnm-robot run`` as a process of its own, against a base and a server played here; looks on.

All of it goes through real Zenoh sessions on this machine: scans at 10 Hz, odometry at 50 Hz, plans at 5 Hz, and the
robot drives the course as it commands.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import zenoh

from revnm_client import cdr, keys
from revnm_client.control_messages import (
    TimeReply,
    decode_state,
    decode_time_request,
    encode_time_reply,
)
from revnm_client.errors import LinkError
from revnm_client.geometry import FloatArray
from revnm_client.json_payload import Scalar
from revnm_client.link import Inbox, LatestSubscriber, control_publisher, open_router
from revnm_client.messages import STANDSTILL, Odometry, Plan
from revnm_client.plan_tracking import travelled
from revnm_client.speed import course
from revnm_client.speed.one_core import one_core

_ROBOT, _SERVER = "bench", "bench"
_STEP_S = 0.02
_SCAN_EVERY, _PLAN_EVERY = 5, 10
_PERIOD_S = 0.05
_WARM_UP_S = 3.0
_START_S = 20.0


@dataclass(frozen=True, slots=True)
class LoopCost:
    """What the client's process took.

    Attributes:
        tick_ms: (S, 2), p50 and p95 of its ticks, as its state told twice a second, each over its last ten seconds.
        commands: How many velocities came.
        elapsed_s: Between the first and the last of them.
        cpu_s: Time of a core in between.
        rss_mb: The most memory that it ever held.
    """

    tick_ms: FloatArray
    commands: int
    elapsed_s: float
    cpu_s: float
    rss_mb: float

    def row(self) -> dict[str, float]:
        """Return the report's row without its name.

        A deadline is missed where a control period passes in which no velocity comes.
        """
        due = max(round(self.elapsed_s / _PERIOD_S), 1)
        p50, p95 = np.median(self.tick_ms, axis=0)
        return {
            "p50_ms": round(float(p50), 2),
            "p95_ms": round(float(p95), 2),
            "cpu_percent": round(100.0 * self.cpu_s / self.elapsed_s, 1),
            "rss_mb": round(self.rss_mb, 1),
            "missed_deadlines_percent": round(100.0 * max(due + 1 - self.commands, 0) / due, 3),
        }


def measure_loop(seconds: float) -> dict[str, float]:
    """Let the client drive for so long, after some seconds of warm-up; return the row without its name.

    Raises:
        LinkError: The client sent nothing, or ended.
    """
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    with open_router([endpoint]) as session, _World(session) as world, _client(endpoint) as process:
        world.play(_START_S, process, until_commanded=True)
        world.play(_WARM_UP_S, process)
        return world.watch(seconds, process).row()


class _World:
    """The base, the LiDAR and the server of one robot on the course; a context manager."""

    def __init__(self, session: zenoh.Session) -> None:
        self._pose, self._velocity = course.start(), STANDSTILL
        self._step = self._seq = 0
        self._due_s = time.monotonic()
        with ExitStack() as stack:
            commands = stack.enter_context(LatestSubscriber(session, keys.cmd_vel(_ROBOT)))
            states = stack.enter_context(LatestSubscriber(session, keys.state(_ROBOT)))
            self._commands, self._states = Inbox(commands, cdr.decode_velocity), Inbox(states, decode_state)
            self._scan, self._odometry, self._plan = (
                stack.enter_context(control_publisher(session, key(_ROBOT)))
                for key in (keys.scan, keys.odom, keys.waypoints)
            )
            stack.enter_context(session.declare_queryable(keys.time(_ROBOT), _tell_time))
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def play(self, seconds: float, process: subprocess.Popen[bytes], *, until_commanded: bool = False) -> None:
        """Play, until the robot moves if told to."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self._play_step(process)
            if until_commanded and self._velocity != STANDSTILL:
                return
        if until_commanded:
            raise LinkError(f"the client did not drive within {seconds:.0f} s")

    def watch(self, seconds: float, process: subprocess.Popen[bytes]) -> LoopCost:
        """Play, and count what comes and what it costs."""
        began_s, cpu_s, commands, ticks = time.monotonic(), _cpu_s(process.pid), 0, []
        first_s = last_s = now_s = began_s
        while now_s < began_s + seconds:
            came, state = self._play_step(process)
            now_s = time.monotonic()
            if came and not commands:
                first_s = now_s
            commands, last_s = commands + came, now_s if came else last_s
            if state is not None:
                ticks.append((state["tick_p50_ms"], state["tick_p95_ms"]))
        cpu_s = _cpu_s(process.pid) - cpu_s
        return LoopCost(np.array(ticks, dtype=float), commands, last_s - first_s, cpu_s, _rss_mb(process.pid))

    def _play_step(self, process: subprocess.Popen[bytes]) -> tuple[int, dict[str, Scalar] | None]:
        """Move on by a step when it is due; return how many commands came, and the state if one did."""
        if process.poll() is not None:
            raise LinkError(f"the client ended with status {process.returncode}")
        self._due_s += _STEP_S
        time.sleep(max(self._due_s - time.monotonic(), 0.0))
        came = self._commands.take_all()
        self._velocity = came[-1] if came else self._velocity
        self._pose @= travelled(self._velocity, _STEP_S)
        self._publish(time.time_ns())
        self._step += 1
        return len(came), self._states.take()

    def _publish(self, now_ns: int) -> None:
        self._odometry.put(cdr.encode_odometry(Odometry(now_ns, self._pose, self._velocity)))
        if self._step % _SCAN_EVERY == 0:
            self._scan.put(cdr.encode_scan(course.scan(self._pose, now_ns)))
        if self._step % _PLAN_EVERY == 0:
            self._seq += 1
            plan = Plan(now_ns, course.waypoints(self._pose), epoch=0, seq=self._seq, goal_id="course", server=_SERVER)
            self._plan.put(cdr.encode_plan(plan), attachment=cdr.encode_attachment(plan))


@contextmanager
def _client(endpoint: str) -> Iterator[subprocess.Popen[bytes]]:
    words = [sys.executable, "-m", "revnm_client.cli", "run", "--robot", _ROBOT, "--connect", endpoint]
    with one_core():
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # noqa: S603 (our own)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def _tell_time(query: zenoh.Query) -> None:
    arrived_ns = time.time_ns()
    with query:
        if query.payload is not None:
            asked = decode_time_request(query.payload.to_bytes())
            query.reply(query.key_expr, encode_time_reply(TimeReply(asked.t1_ns, arrived_ns, time.time_ns(), _SERVER)))


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _cpu_s(pid: int) -> float:
    """Return the time of a core that a process has taken, in user and system; from proc(5)."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _rss_mb(pid: int) -> float:
    """Return the most memory that a process ever held; from proc(5)."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) * 1024 / 1e6
