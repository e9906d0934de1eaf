"""The live view: the picture exactly, and the command in a real pseudo-terminal."""

from __future__ import annotations

import fcntl
import math
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from revnm_client import cdr, keys
from revnm_client.cli import main
from revnm_client.control_messages import encode_state
from revnm_client.geometry import Pose2
from revnm_client.messages import STANDSTILL, Odometry, Plan, Scan
from revnm_client.watch import Size, View, ViewKeeper, draw

ROBOT = "rover"
STATE = {
    "robot": ROBOT,
    "moving": True,
    "stopped": False,
    "epoch": 1,
    "reason": None,
    "plan_seq": 812,
    "goal_id": "g",
    "v_mps": 0.31,
    "w_radps": 0.12,
    "plan_age_ms": 112.4,
    "scan_age_ms": 43.0,
    "odometry_age_ms": 21.0,
    "clock_offset_ms": 3.1,
    "round_trip_ms": 2.4,
    "tick_p95_ms": 6.12,
    "stopping_m": 0.114,
    "rejected": 2,
    "malformed": 0,
}


def test_the_picture_is_drawn_to_the_character():
    # 5 rows for the map: the robot in row 2, 3 m / 2 = 1.5 m a row, 0.75 m a column; of 21 columns it is in the 10th.
    points = np.array([[3.0, 0.0], [0.0, 3.0], [0.0, -7.5], [-3.0, -1.5], [99.0, 0.0]])
    path = np.array([[0.0, 0.0], [1.5, -2.25]])
    view = View(ROBOT, points, path, STATE | {"last_refusal": "plan 8 is not newer"}, 0.1)
    assert draw(view, Size(21, 9))[3:] == [
        "          #",
        "            oo",
        "      #   ^o        #",
        "",
        "            #",
        "# LiDAR   o plan   ^ ",
    ]
    assert draw(view, Size(120, 9))[:3] == [
        "rover  DRIVES  0.31 m/s +0.12 rad/s  plan 812 to g",
        "ms: plan 112 scan 43 odometry 21  clock +3.1 round trip 2.4  tick p95 6.1",
        "nearest 3.00 m at +0 deg  stops in 0.11 m  refused 2  malformed 0, last: plan 8 is not newer",
    ]
    assert draw(view, Size(120, 9))[-1] == "# LiDAR   o plan   ^ robot, its front up   row 1.50 m   Ctrl-C ends"


@pytest.mark.parametrize(
    ("view", "line"),
    [
        (View(ROBOT), "rover  its client is not heard yet"),
        (View(ROBOT, state=STATE, state_age_s=7.2), "rover  ITS CLIENT IS SILENT for 7 s"),
        (View(ROBOT, state=STATE | {"reason": "no scan yet", "moving": False}, state_age_s=0.1),
         "rover  STANDS: no scan yet"),
        (View(ROBOT, state=STATE | {"reason": "stuck: backing off", "v_mps": -0.15, "w_radps": 0.0}, state_age_s=0.1),
         "rover  stuck: backing off  -0.15 m/s +0.00 rad/s"),
        (View(ROBOT, state=STATE | {"v_mps": None, "plan_seq": "x", "goal_id": None}, state_age_s=0.1),
         "rover  DRIVES  - m/s +0.12 rad/s  plan - to -"),
        (View(ROBOT, state=STATE | {"reason": "Ärger\u4e2d", "moving": False}, state_age_s=0.1),
         "rover  STANDS: ?rger?"),
    ],
)  # fmt: skip
def test_the_first_line_says_whether_it_drives(view, line):
    assert draw(view, Size(80, 24))[0] == line


def test_without_a_scan_and_without_hits_it_says_so():
    assert draw(View(ROBOT), Size(80, 24))[2].startswith("no scan  stops in - m")
    assert draw(View(ROBOT, points_m=np.empty((0, 2))), Size(80, 24))[2].startswith("nothing in reach")


@pytest.mark.parametrize("columns", [1, 20, 80, 300])
@pytest.mark.parametrize("lines", [1, 2, 3, 4, 5, 6, 24, 90])
def test_it_fits_every_terminal(columns, lines):
    chance = np.random.default_rng(3)
    view = View(ROBOT, chance.normal(0.0, 3.0, (400, 2)), chance.normal(0.0, 2.0, (6, 2)), STATE, 0.0)
    drawn = draw(view, Size(columns, lines))
    assert len(drawn) == min(lines, 3) if lines < 5 else len(drawn) == lines
    assert max(map(len, drawn)) <= columns


def test_a_plan_of_one_place_is_drawn():
    assert "o" not in "".join(draw(View(ROBOT, path_m=np.zeros((2, 2))), Size(80, 24))[3:-1])  # under the robot


class Inbox:
    def __init__(self) -> None:
        self.waiting: list = []

    def take(self):
        return self.waiting.pop(0) if self.waiting else None


def test_the_plan_lies_where_the_odometry_says_whatever_the_clocks_say():
    # The robot's clock is 5 s behind the server's, this machine's is another one. The plan, 1 m ahead, is from when the
    # robot was at the origin; at the scan it has driven 0.4 m and looks left, so that the plan's end lies 0.6 m right.
    second, now = 10**9, SimpleNamespace(s=50.0)
    keeper = ViewKeeper(ROBOT, lambda: now.s)
    odometry, scans, plans, states = Inbox(), Inbox(), Inbox(), Inbox()
    senses = SimpleNamespace(take_odometry=odometry.take, take_scan=scans.take)
    ears = SimpleNamespace(plans=plans, states=states)
    odometry.waiting = [
        Odometry(100 * second, Pose2(0.0, 0.0, 0.0), STANDSTILL),
        Odometry(101 * second, Pose2(0.4, 0.0, math.pi / 2), STANDSTILL),
    ]
    keeper.listen(senses, ears)
    states.waiting = [STATE | {"clock_offset_ms": 5000.0, "lidar_x_m": 0.1, "lidar_yaw_rad": math.pi}]
    plans.waiting = [Plan(105 * second, np.array([[1.0, 0.0]]), epoch=1, seq=1, goal_id="g")]
    scans.waiting = [Scan(101 * second, 0.0, 0.1, 0.1, 10.0, np.array([2.0, 0.0], dtype=np.float32))]
    keeper.listen(senses, ears)
    view = keeper.view()
    np.testing.assert_allclose(view.path_m, [[0.0, 0.4], [0.0, -0.6]], atol=1e-9)
    np.testing.assert_allclose(view.points_m, [[-1.9, 0.0]], atol=1e-9)  # 2 m behind a LiDAR that looks back
    assert view.state_age_s == 0.0
    now.s += 1.5
    assert (keeper.view().points_m, keeper.view().path_m, keeper.view().state_age_s) == (None, None, 1.5)


class Terminal:
    """A pseudo-terminal in which a command runs."""

    def __init__(self, *words: str) -> None:
        self.master, slave = pty.openpty()
        self.text = ""
        self.resize(80, 24)
        self.before = termios.tcgetattr(slave)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "revnm_client.cli", *words], stdin=slave, stdout=slave, stderr=slave
        )
        self.slave = slave

    def resize(self, columns: int, lines: int) -> None:
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    def reads(self, pattern: str) -> bool:
        """Read what has been written; tell whether the pattern is in it."""
        while select.select([self.master], [], [], 0.0)[0]:
            self.text += os.read(self.master, 65536).decode()
        return re.search(pattern, self.text) is not None

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.master)
        os.close(self.slave)


@contextmanager
def terminal(*words: str):
    shown = Terminal(*words)
    try:
        yield shown
    finally:
        shown.close()


@pytest.fixture
def drive(router):
    """A robot that publishes scan, odometry and state."""
    stop = threading.Event()

    def publish() -> None:
        while not stop.wait(0.05):
            now_ns = time.time_ns()
            ranges = np.full(4, 2.0, dtype=np.float32)
            router.put(keys.odom(ROBOT), cdr.encode_odometry(Odometry(now_ns, Pose2(0.0, 0.0, 0.0), STANDSTILL)))
            router.put(keys.scan(ROBOT), cdr.encode_scan(Scan(now_ns, 0.0, math.pi / 2, 0.1, 10.0, ranges)))
            router.put(keys.state(ROBOT), encode_state(STATE))

    thread = threading.Thread(target=publish)
    thread.start()
    yield
    stop.set()
    thread.join()


LEFT = re.escape("\x1b[?25h\x1b[?1049l")


def test_the_command_draws_resizes_and_leaves_the_terminal_as_it_was(endpoint, drive, eventually):
    with terminal("watch", "--robot", ROBOT, "--connect", endpoint) as shown:
        eventually(lambda: shown.reads(r"rover  DRIVES  0\.31 m/s .*\x1b\[0m"), within_s=20.0)
        eventually(lambda: shown.reads(r"nearest 2\.00 m.*\n(.*\n)+.* {38}#"))
        shown.resize(40, 10)
        eventually(lambda: shown.reads(r"\x1b\[2J\x1b\[H\x1b\[2K\x1b\[7mrover  DRIVES.{27}\x1b\[0m"))
        assert shown.process.poll() is None
        shown.process.send_signal(signal.SIGINT)
        eventually(lambda: shown.reads(LEFT))
        assert shown.process.wait(10.0) == 0
        assert termios.tcgetattr(shown.slave) == shown.before
        assert "Traceback" not in shown.text


def test_run_shows_the_drive_and_writes_its_log_afterwards(endpoint, router, eventually):
    with terminal("run", "--watch", "--robot", ROBOT, "--connect", endpoint) as shown:
        eventually(lambda: shown.reads(r"rover  STANDS: no odometry yet"), within_s=20.0)
        assert "INFO" not in shown.text
        shown.process.send_signal(signal.SIGTERM)
        assert shown.process.wait(10.0) == 0
        eventually(lambda: shown.reads(LEFT + r"(.|\n)*INFO .*stopped: no odometry yet"))


def test_without_a_terminal_it_is_refused(capsys):
    for words in (["watch"], ["run", "--watch"]):
        assert main([*words, "--robot", ROBOT]) == 2
        assert "standard output is no terminal" in capsys.readouterr().err
