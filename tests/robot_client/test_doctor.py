"""The doctor: each fault is told apart and named, and the command looks at real routers."""

from __future__ import annotations

import math
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from revnm_client import cdr, keys
from revnm_client.cli import main
from revnm_client.clock_probe import ProbeReading
from revnm_client.control_messages import TimeReply, decode_time_request, encode_state, encode_time_reply
from revnm_client.credentials import Credentials
from revnm_client.doctor import Observation, Received, Series, Verdict, examine, unreachable
from revnm_client.doctor.blind_sectors import Sector, blind_degrees, sectors
from revnm_client.geometry import Pose2
from revnm_client.messages import STANDSTILL, Odometry, Plan, Scan
from revnm_client.settings import LidarSettings, load_settings

ROBOT = "rover"
T0_NS = 1_000_000_000_000
MS = 1_000_000
FREE = np.full(360, 3.0, dtype=np.float32)
FREE[200] = 2.5  # beam 200 of those from −180° is at 20°


def scan(stamp_ns: int, ranges_m=FREE) -> Scan:
    return Scan(stamp_ns, -math.pi, math.tau / 360, 0.1, 10.0, np.asarray(ranges_m, dtype=np.float32))


def series(make, *, period_ms: int, lag_ms: int, seconds: float = 5.0) -> Series:
    times = range(T0_NS, T0_NS + int(seconds * 1e9), period_ms * MS)
    return Series([Received(make(time_ns - lag_ms * MS), time_ns) for time_ns in times])


def healthy(**changes) -> Observation:
    seen = Observation(
        5.0,
        scans=series(scan, period_ms=100, lag_ms=20),
        odometry=series(lambda t: Odometry(t, Pose2(1.0, 2.0, 0.0), STANDSTILL), period_ms=20, lag_ms=5),
        clock=ProbeReading(3 * MS, 2 * MS, "edge", 0, "", 0),
    )
    for name, value in changes.items():
        setattr(seen, name, value)
    return seen


@pytest.fixture
def settings():
    return load_settings(None, options={"robot": ROBOT})


def verdicts(findings) -> dict[str, Verdict]:
    return {each.subject: each.verdict for each in findings}


def the(findings, subject: str):
    (finding,) = [each for each in findings if each.subject == subject]
    return finding


def test_of_a_healthy_robot_everything_is_good(settings):
    findings = examine(healthy(), settings)
    assert set(verdicts(findings).values()) == {Verdict.OK}
    assert the(findings, "scan").text == "10.0 Hz, 360 beams over 359°, nearest 2.50 m at 20°"
    assert the(findings, "scan stamps").text == "20 ms old when they come"
    assert the(findings, "view").text == "all around"
    assert the(findings, "odometry").text == "50.0 Hz, 0.00 m/s, +0.00 rad/s"
    assert the(findings, "clock").text == "server's clock +3.0 ms from this one's, round trip 2.0 ms"
    assert "no goal is set" in the(findings, "plans").text


def masked(*degrees: range) -> np.ndarray:
    ranges_m = FREE.copy()
    for each in degrees:
        ranges_m[[degree + 180 for degree in each]] = 0.0
    return ranges_m


def own_post() -> np.ndarray:
    ranges_m = FREE.copy()
    ranges_m[350:356] = 0.18  # 0.18 m behind the middle lies within the 0.43 m long Megarover
    return ranges_m


def odd_scans(ranges_m) -> Series:
    return series(lambda t: scan(t, ranges_m), period_ms=100, lag_ms=20)


def standing_odometry(t: int) -> Odometry:
    return Odometry(t, Pose2(0.0, 0.0, 0.0), STANDSTILL)


@pytest.mark.parametrize(
    ("changes", "subject", "verdict", "text"),
    [
        ({"scans": Series()}, "scan", "FAULT", "none came in 5 s: is its driver running, and does a bridge carry"),
        (
            {"scans": Series(), "last_error": "rover/scan: range of beam 3 is nan", "rejected": 9},
            "scan", "FAULT", "all that came was refused: rover/scan: range of beam 3 is nan",
        ),
        ({"rejected": 2, "last_error": "rover/odom: x"}, "messages", "WARN", "2 scans or odometries were malformed"),
        ({"odometry": Series()}, "odometry", "FAULT", "none came in 5 s"),
        ({"scans": series(scan, period_ms=500, lag_ms=20)}, "scan", "FAULT", "the longest pause was 0.50 s"),
        ({"scans": series(scan, period_ms=250, lag_ms=20)}, "scan", "WARN", "expected 5 Hz or more"),
        ({"scans": series(lambda t: scan(T0_NS), period_ms=100, lag_ms=0)}, "scan", "FAULT", "its driver hangs"),
        ({"scans": series(scan, period_ms=100, lag_ms=3000)}, "scan stamps", "FAULT", "3.00 s old when they come"),
        ({"scans": series(scan, period_ms=100, lag_ms=-500)}, "scan stamps", "FAULT", "0.50 s in the future"),
        (
            {"odometry": series(standing_odometry, period_ms=20, lag_ms=400)},
            "odometry stamps", "FAULT", "0.40 s old when they come",
        ),
        (
            {"odometry": series(standing_odometry, period_ms=20, lag_ms=250)},
            "scan and odometry", "FAULT", "50 of 50 scans have no odometry",
        ),
        (
            {"scans": odd_scans(masked(range(-180, -100), range(100, 180)))},
            "view", "OK", "blind at 100° to -101°: what was seen there is remembered",
        ),
        ({"scans": odd_scans(masked(range(60, 120)))}, "view", "WARN", "blind at 60° to 119°: it may turn into"),
        ({"scans": odd_scans(masked(range(10, 20)))}, "view", "WARN", "blind at 10° to 19°: partly ahead"),
        ({"scans": odd_scans(masked(range(-100, 100)))}, "view", "FAULT", "mounted the other way round?"),
        (
            {"scans": odd_scans(own_post())},
            "outline", "FAULT", "6 beams end within the robot's own outline, about 0.18 m away at 172°",
        ),
        (
            {"clock": ProbeReading(None, None, None, 0, "", 0)}, "clock", "FAULT",
            "do its settings have a robot called rover, and its certificate that name?",
        ),
        ({"clock": ProbeReading(5000 * MS, 2 * MS, "edge", 0, "", 0)}, "clock", "WARN", "+5000.0 ms from this one's"),
        ({"clock": ProbeReading(0, 300 * MS, "edge", 0, "", 0)}, "clock", "WARN", "the network is slow"),
        ({"trouble": "the bumper is pressed"}, "base", "FAULT", "the bumper is pressed: the robot will not move"),
        ({"state": {"reason": "scan is 0.4 s old"}}, "client", "OK", "runs, and stands: scan is 0.4 s old"),
        ({"state": {"reason": None}}, "client", "OK", "runs, and drives"),
    ],
)  # fmt: skip
def test_what_is_amiss_is_named(settings, changes, subject, verdict, text):
    finding = the(examine(healthy(**changes), settings), subject)
    assert finding.verdict == verdict
    assert text in finding.text


def test_an_odometry_that_jumps_is_told(settings):
    moved = series(
        lambda t: Odometry(t, Pose2(9.0 * (t > T0_NS + 10**9), 0.0, 0.0), STANDSTILL), period_ms=20, lag_ms=5
    )
    finding = the(examine(healthy(odometry=moved), settings), "scan and odometry")
    assert (finding.verdict, finding.text[:37]) == (Verdict.WARN, "the odometry's pose jumped 1 times: t")


def test_late_plans_are_told_by_the_servers_clock(settings):
    # Stamped by a server's clock that is 5 s ahead: 5.7 s − 5 s = 0.7 s from picture to robot.
    plan = Plan(0, np.array([[1.0, 0.0]]), epoch=1, seq=1, goal_id="g")
    clock = ProbeReading(5000 * MS, 2 * MS, "edge", 0, "", 0)
    for late_ms, verdict in ((700, Verdict.FAULT), (200, Verdict.OK)):
        plans = series(
            lambda t, late_ms=late_ms: replace(plan, stamp_ns=t + (5000 - late_ms) * MS), period_ms=200, lag_ms=0
        )
        finding = the(examine(healthy(plans=plans, clock=clock), settings), "plans")
        assert (finding.verdict, finding.text[:36]) == (verdict, f"5.0 Hz, {late_ms} ms from picture to robot")


def test_where_no_server_is_reached_only_the_senses_are_judged(settings):
    assert not {"clock", "plans", "client"} & verdicts(examine(healthy(clock=None), settings)).keys()


def test_a_lidar_of_half_a_turn_is_blind_behind():
    # 181 beams from −90° to +90° clockwise: what lies beyond half a beam is not seen.
    half = Scan(0, math.pi / 2, -math.pi / 180, 0.1, 10.0, np.full(181, np.inf, dtype=np.float32))
    assert sectors(blind_degrees([half])) == [Sector(91, -91)]
    assert sectors(blind_degrees([])) == [Sector(-180, 179)]


def test_a_lidar_that_is_mounted_the_other_way_round_is_judged_as_it_sits(settings):
    turned = replace(settings, lidar=LidarSettings(x_m=0.1, yaw_rad=math.pi))
    findings = examine(healthy(scans=odd_scans(masked(range(-60, 60)))), turned)
    assert the(findings, "view").text.startswith("blind at 120° to -121°")  # as far behind as it was ahead
    # 2.5 m at 20°, turned: 0.1 − 2.5 cos 20° = −2.249 and −2.5 sin 20° = −0.855, which are 2.41 m; beam 0 is masked.
    assert the(examine(healthy(), turned), "scan").text.endswith("nearest 2.41 m at -159°")


def test_a_gap_of_four_degrees_is_no_sector():
    assert sectors(blind_degrees([scan(0, masked(range(4)))])) == []
    assert sectors(blind_degrees([scan(0, masked(range(5)))])) == [Sector(0, 4)]


def test_an_address_where_nothing_listens_is_told(endpoint):
    assert unreachable([endpoint], Credentials()).startswith(f"{endpoint}: nothing listens there")
    assert "no machine is called no.such.invalid" in unreachable(["tcp/no.such.invalid:7447"], Credentials())
    assert unreachable(["udp/127.0.0.1:1"], Credentials()) is None
    assert unreachable(["tcp/127.0.0.1:99999"], Credentials()) is not None


@contextmanager
def robot_and_server(router, *, answers_time: bool = True):
    """A bridge that publishes scans and odometry, and a server that tells its time."""
    stop = threading.Event()

    def publish() -> None:
        while not stop.wait(0.02):
            now_ns = time.time_ns()
            router.put(keys.odom(ROBOT), cdr.encode_odometry(Odometry(now_ns, Pose2(0.0, 0.0, 0.0), STANDSTILL)))
            router.put(keys.scan(ROBOT), cdr.encode_scan(scan(now_ns)))
            router.put(keys.state(ROBOT), encode_state(STATE))

    def tell_time(query) -> None:
        with query:
            t1_ns = decode_time_request(query.payload.to_bytes()).t1_ns
            query.reply(keys.time(ROBOT), encode_time_reply(TimeReply(t1_ns, time.time_ns(), time.time_ns(), "edge")))

    clock = router.declare_queryable(keys.time(ROBOT), tell_time) if answers_time else None
    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        if clock is not None:
            clock.undeclare()


STATE = {"robot": ROBOT, "moving": False, "stopped": False, "epoch": 0, "reason": "no plan yet"}


def doctor(*options: str) -> int:
    return main(["doctor", "--robot", ROBOT, "--seconds", "1", *options])


def test_the_command_finds_a_robot_and_its_server_well(endpoint, router, capsys):
    commands = router.declare_subscriber(keys.cmd_vel(ROBOT))
    with robot_and_server(router):
        assert doctor("--connect", endpoint) == 0
    out = capsys.readouterr().out
    assert "FAULT" not in out
    assert f"reached at {endpoint}" in out
    assert "360 beams" in out
    assert "runs, and stands: no plan yet" in out
    assert commands.try_recv() is None  # it sent no velocity, not even zero


def test_the_command_finds_a_server_that_does_not_know_the_robot(endpoint, router, capsys):
    with robot_and_server(router, answers_time=False):
        assert doctor("--connect", endpoint) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("FAULT")]
    assert line.split(maxsplit=2)[1:] == [
        "clock",
        "the server does not tell its time: do its settings have a robot called rover, and its certificate that name?",
    ]


def test_without_a_server_it_still_looks_at_the_robots_own_router(endpoint, router, capsys, tmp_path):
    config = tmp_path / "robot.yaml"
    config.write_text(
        f"robot: {ROBOT}\nserver: tcp/127.0.0.1:1\nprofile: megarover\ndriver: {{kind: zenoh, connect: '{endpoint}'}}\n"
    )
    with robot_and_server(router):
        assert main(["doctor", "--config", str(config), "--seconds", "1"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("FAULT  server")
    assert "nothing listens there" in lines[0]
    assert [line.split()[0] for line in lines[1:-1]] == ["OK"] * (len(lines) - 2)


def test_without_anything_it_says_so(endpoint, capsys):
    assert doctor("--connect", endpoint) == 1
    assert capsys.readouterr().out.count("FAULT") == 1
