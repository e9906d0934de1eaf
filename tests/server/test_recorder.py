"""A record as it is written while a server runs: what is in it, for readers that are not ours."""

from __future__ import annotations

import errno
import json
import logging
import os
import resource
import shutil
import struct
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
import zenoh
from mcap.reader import make_reader

from revnm_client import keys
from revnm_client.cdr import (
    encode_attachment,
    encode_odometry,
    encode_plan,
    encode_scan,
    encode_velocity,
)
from revnm_client.control_messages import encode_state
from revnm_client.errors import ConfigError
from revnm_client.geometry import Pose2
from revnm_client.messages import Plan, Velocity
from revnm_server.camera.jpeg import decode_jpeg
from revnm_server.ports import Heard
from revnm_server.recording.about import describe
from revnm_server.recording.entry_queue import Entry, EntryQueue, LogEntry, TickEntry
from revnm_server.recording.errors import RecordingError
from revnm_server.recording.heard_log import HeardLog
from revnm_server.recording.record_folder import RecordFolder
from revnm_server.recording.recorder import Recorder
from revnm_server.recording.recording import Recording, Rotation
from revnm_server.recording.scribe import Scribe
from revnm_server.recording.tick_document import HeardStamps, decode_tick
from revnm_server.recording.wire_tap import WireTap
from revnm_server.report import installed_versions
from revnm_server.settings import load_settings

from .recording_parts import (
    PLAN_M,
    STAMP_NS,
    UNKNOWN,
    VIEW,
    observed,
    odometry,
    read,
    recorder,
    records,
    scan,
)
from .waiting import eventually


def written(made: Recorder, count: int) -> None:
    """Wait until so many messages are in the file."""
    eventually(lambda: made.view().messages >= count)


def test_what_went_over_zenoh_is_recorded_byte_for_byte(router: zenoh.Session, tmp_path: Path) -> None:
    plan = Plan(STAMP_NS, PLAN_M, 3, 7, "g1")
    state = encode_state({"robot": "rover", "moving": True, "stopped": False, "epoch": 3, "reason": None})
    sent = {
        "/rover/scan": encode_scan(scan(STAMP_NS)),
        "/rover/odom": encode_odometry(odometry(STAMP_NS, 1.5)),
        "/rover/cmd_vel": encode_velocity(Velocity(0.25, -0.5)),
        "/rover/waypoints": encode_plan(plan),
        "/rover/revnm/state": state,
    }
    with recorder(router, tmp_path) as made:
        before = made.start().messages
        for topic, payload in sent.items():
            attachment = encode_attachment(plan) if topic == "/rover/waypoints" else None
            router.put(topic.removeprefix("/"), payload, attachment=attachment)
        written(made, before + len(sent) + 2)
    [path] = records(tmp_path)
    with path.open("rb") as file:
        raw = {channel.topic: message.data for _, channel, message in make_reader(file).iter_messages()}
    for topic in ("/rover/scan", "/rover/odom", "/rover/cmd_vel", "/rover/waypoints"):
        assert raw[topic] == sent[topic]
    messages = read(path)
    assert messages["/rover/revnm/state"][0].data == state.decode()
    assert json.loads(messages["/rover/waypoints/ticket"][0].data) == {"epoch": 3, "seq": 7, "goal": "g1", "server": ""}


class LateQueue(EntryQueue):
    """Is found empty; only then, and before anybody does anything about that, a tick and the stop come in."""

    recording: Recording | None = None

    def take(self, *, timeout_s: float) -> Entry | None:
        entry = super().take(timeout_s=timeout_s)
        if entry is None and self.recording is not None:
            recording, self.recording = self.recording, None
            recording.offer_tick(TickEntry(observed(0), (), STAMP_NS, 0))
            with suppress(RuntimeError):  # a thread cannot wait for itself: the stop is heard all the same
                recording.stop()
        return entry


def test_a_tick_just_before_the_stop_is_recorded(router: zenoh.Session, tmp_path: Path) -> None:
    queue = LateQueue()
    folder = RecordFolder(tmp_path, quota_bytes=1e9, least_free_bytes=0.0)
    scribe = Scribe("cam", ("rover",), jpeg_quality=80, site=None)
    tap = WireTap(router, ("rover",))
    recording = Recording(folder, Rotation(1e9, 1e9), tap, scribe, {}, lambda: VIEW, queue)
    queue.recording = recording
    eventually(lambda: not recording.active)
    [tick] = read(records(tmp_path)[0])["/revnm/tick"]
    assert decode_tick(tick.data).stamp_ns == STAMP_NS


def test_a_tick_is_recorded_for_viewers(router: zenoh.Session, tmp_path: Path) -> None:
    heard = HeardLog()
    with recorder(router, tmp_path, heard=heard) as made:
        made.start()
        heard.along("rover", Saying(Heard((odometry(STAMP_NS, 1.0),), (), 0, Pose2(0.1, 0.2, 3.0)))).listen()
        tick = observed(0)
        made.observe(tick)
    messages = read(records(tmp_path)[0])
    picture = messages["/cam/image/compressed"][0]
    assert picture.data.tobytes() == tick.frame.jpeg
    assert (picture.header.frame_id, picture.format) == ("cam", "jpeg")
    assert picture.header.stamp.sec * 10**9 + picture.header.stamp.nanosec == STAMP_NS
    assert tick.result is not None
    depth = messages["/cam/depth"][0]
    assert (depth.height, depth.width, depth.encoding) == (6, 8, "16UC1")
    disparity = depth.data.view("<u2").reshape(6, 8) / 1000.0
    np.testing.assert_allclose(disparity, tick.result.disparity, atol=5.1e-4)
    ego = messages["/rover/revnm/ego_depth"][0]
    np.testing.assert_array_equal(ego.data.view("<f4").reshape(6, 8), tick.result.ego_depths["rover"])
    goal, pixel = messages["/rover/goal"][0], messages["/rover/goal_pixel"][0]
    assert (goal.pose.position.x, goal.pose.position.y, goal.header.frame_id) == (3.0, 1.0, "floor")
    assert (pixel.point.x, pixel.point.y, pixel.header.frame_id) == (10.0, 20.0, "cam")
    assert len(messages["/rover/revnm/way"][0].poses) == 2
    assert messages["/cam/camera_info"][0].k[0] == 50.0
    moving = {t.child_frame_id: t for t in messages["/tf"][0].transforms}
    assert {child: t.header.frame_id for child, t in moving.items()} == {
        "cam": "floor",
        "rover/base_link": "floor",
        "rover/odom": "rover/base_link",
    }
    assert moving["cam"].transform.translation.z == 2.5
    assert moving["rover/odom"].transform.translation.x == -1.0
    # The optical axis, (0, 0, 1) turned by the camera's rotation, looks ahead and 0.6 rad down.
    turn = moving["cam"].transform.rotation
    ahead = turned((turn.x, turn.y, turn.z, turn.w), np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(ahead, [np.cos(0.6), 0.0, -np.sin(0.6)], atol=1e-12)
    still = messages["/tf_static"][0].transforms
    assert [(t.header.frame_id, t.child_frame_id) for t in still] == [("rover/base_link", "base_link")]
    document = json.loads(messages["/revnm/tick"][0].data)
    assert document["plans_m"] == {"rover": PLAN_M.tolist()}
    heard_then = {"robot": "rover", "offset_ns": 0, "odom": [STAMP_NS], "scan": [], "lidar": [0.1, 0.2, 3.0]}
    assert document["heard"] == [heard_then]
    told = decode_tick(messages["/revnm/tick"][0].data).heard[0]
    assert told == HeardStamps("rover", 0, (STAMP_NS,), (), Pose2(0.1, 0.2, 3.0))
    del heard_then["lidar"]  # as in records of before
    old = decode_tick(json.dumps(document | {"heard": [heard_then]})).heard[0]
    assert old.robot_from_lidar == Pose2(0.0, 0.0, 0.0)
    assert document["calibration"]["status"] == "good"
    assert messages["/diagnostics"][0].status[0].name == "revnm: camera"


class Saying:
    """Senses that hear one thing."""

    def __init__(self, heard: Heard) -> None:
        self.heard, self.rejected = heard, {}

    def listen(self) -> Heard:
        return self.heard


def turned(quaternion: tuple[float, float, float, float], vector: np.ndarray) -> np.ndarray:
    """The vector turned by a unit quaternion: v + 2 w (q × v) + 2 q × (q × v)."""
    axis, w = np.array(quaternion[:3]), quaternion[3]
    across = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * across + np.cross(axis, across))


def test_frames_that_a_robot_names_hang_on_the_tree(router: zenoh.Session, tmp_path: Path) -> None:
    laser = bytearray(encode_scan(scan(STAMP_NS)))
    place = laser.index(b"base_link\x00")
    laser[place : place + 9] = b"laser_top"
    with recorder(router, tmp_path, robots=("rover", "other")) as made:
        before = made.start().messages
        router.put(keys.scan("rover"), bytes(laser))
        router.put(keys.odom("rover"), encode_odometry(odometry(STAMP_NS)))
        router.put(keys.scan("other"), encode_scan(scan(STAMP_NS)))  # base_link is the first robot's already
        written(made, before + 5)
    last = read(records(tmp_path)[0])["/tf_static"][-1]
    assert {t.child_frame_id: t.header.frame_id for t in last.transforms} == {
        "base_link": "rover/base_link",
        "laser_top": "rover/base_link",
        "odom": "rover/odom",
    }
    assert all(t.header.stamp.sec == 0 for t in last.transforms)


def test_malformed_payloads_are_counted_and_not_recorded(router: zenoh.Session, tmp_path: Path) -> None:
    with recorder(router, tmp_path) as made:
        before = made.start().messages
        for key in (keys.scan("rover"), keys.odom("rover"), keys.cmd_vel("rover"), keys.waypoints("rover")):
            router.put(key, b"\x00\x01\x00\x00rubbish")
        router.put(keys.state("rover"), b"\xff\xfe")
        router.put(keys.waypoints("rover"), encode_plan(Plan(STAMP_NS, PLAN_M, 1, 1, "g")), attachment=b"\xff")
        router.put(keys.cmd_vel("rover"), encode_velocity(Velocity(0.0, 0.0)))
        written(made, before + 1)
        eventually(lambda: made.view().refused == 6)
    assert "/rover/cmd_vel" in read(records(tmp_path)[0])


def test_a_record_that_begins_in_the_middle_knows_where_things_are(router: zenoh.Session, tmp_path: Path) -> None:
    with recorder(router, tmp_path) as made:
        made.observe(observed(0))
        made.start()
    messages = read(records(tmp_path)[0])
    [moving] = messages["/tf"]
    assert moving.transforms[0].header.stamp.sec == STAMP_NS // 10**9
    assert "/revnm/tick" not in messages


def test_ticks_without_a_map_and_ticks_that_failed_are_recorded(router: zenoh.Session, tmp_path: Path) -> None:
    plain = observed(1, calibration=None, as_jpeg=False)
    failed = type(plain)(plain.frame, plain.goals, None, frozenset())
    with recorder(router, tmp_path, jpeg_quality=100) as made:
        made.start()
        for tick in (plain, observed(2, calibration=UNKNOWN), failed):
            made.observe(tick)
    messages = read(records(tmp_path)[0])
    documents = [json.loads(message.data) for message in messages["/revnm/tick"]]
    assert [document["failed"] for document in documents] == [False, False, True]
    assert not any("calibration" in document for document in documents)
    assert "/tf" not in messages
    near = decode_jpeg(messages["/cam/image/compressed"][0].data.tobytes()).astype(int) - plain.frame.image
    assert np.abs(near).mean() < 2.0


def test_the_calibration_is_told_when_it_changes_and_in_every_file(router: zenoh.Session, tmp_path: Path) -> None:
    with recorder(router, tmp_path) as made:
        for _ in range(2):
            made.start()
            for number in range(3):
                made.observe(observed(number))
            made.stop()
    for path in records(tmp_path):
        documents = [json.loads(message.data) for message in read(path)["/revnm/tick"]]
        assert ["calibration" in document for document in documents] == [True, False, False]


def test_the_log_is_recorded(router: zenoh.Session, tmp_path: Path) -> None:
    source = logging.getLogger("revnm_server.service")
    with recorder(router, tmp_path) as made:
        made.start()
        source.warning("tick failed: %s", "no such thing")
        made.stop()
        source.warning("afterwards")
    lines = read(records(tmp_path)[0])["/rosout"]
    assert [(line.msg, line.level, line.name) for line in lines] == [
        ("tick failed: no such thing", 30, "revnm_server.service")
    ]


def test_start_and_stop_may_be_repeated(router: zenoh.Session, tmp_path: Path) -> None:
    with recorder(router, tmp_path / "new" / "folder") as made:
        assert made.view().name is None
        assert made.stop().active is False
        first = made.start()
        assert made.start().name == first.name
        assert first.active
        stopped = made.stop()
        assert (stopped.active, stopped.name, stopped.reason) == (False, first.name, None)
        assert made.start().name != first.name
    assert len(records(tmp_path / "new" / "folder")) == 2
    assert not list((tmp_path / "new" / "folder").glob("*.part"))


def test_files_are_rotated_by_size_and_each_stands_alone(router: zenoh.Session, tmp_path: Path) -> None:
    with recorder(router, tmp_path, rotate_mb=0.06) as made:
        made.start()
        for number in range(60):
            made.observe(observed(number))
        eventually(lambda: len(records(tmp_path)) >= 2)
    files = records(tmp_path)
    assert sum(len(read(path).get("/revnm/tick", [])) for path in files) == 60
    for path in files:
        assert read(path)["/tf_static"]
        with path.open("rb") as file:
            assert make_reader(file).get_header().profile == "ros2"


def test_files_are_rotated_by_time(router: zenoh.Session, tmp_path: Path) -> None:
    with recorder(router, tmp_path, rotate_s=0.05) as made:
        made.start()
        eventually(lambda: len(records(tmp_path)) >= 2)


def test_the_oldest_records_make_room_and_nothing_else_does(router: zenoh.Session, tmp_path: Path) -> None:
    def ours(name: str, size: int = 200_000) -> Path:
        with recorder(router, tmp_path / "make") as made:
            made.start()
        [source] = records(tmp_path / "make")
        path = folder / name
        path.write_bytes(source.read_bytes() + bytes(size))
        source.unlink()
        return path

    folder = tmp_path / "records"
    folder.mkdir()
    oldest = ours("revnm-20200101-000000-000.mcap")
    cut = ours("revnm-20200101-000001-000.mcap.part")
    held = ours("revnm-20200101-000002-000.mcap.part")
    kept = ours("revnm-20200102-000000-000.mcap")
    strangers = [folder / name for name in ("revnm-20190101-000000-000.mcap", "notes.mcap", "revnm-x.mcap")]
    for path in strangers:
        path.write_bytes(b"\x89MCAP0\r\n" + bytes(900_000))
    link = folder / "revnm-20180101-000000-000.mcap"
    link.symlink_to(kept)
    with held.open("rb") as other, writing(other), recorder(router, folder, quota_gb=3e-4, rotate_mb=0.05) as made:
        made.start()
    assert not oldest.exists()
    assert not cut.exists()
    assert held.exists()
    assert kept.exists()
    assert link.is_symlink()
    assert all(path.exists() for path in strangers)


@contextmanager
def writing(file) -> Iterator[None]:  # type: ignore[no-untyped-def]
    """Hold a part as the server that writes it does."""
    import fcntl

    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    yield


def test_a_full_disk_stops_the_record_and_nothing_else(router: zenoh.Session, tmp_path: Path) -> None:
    with recorder(router, tmp_path) as made:
        made.start()
        with largest_file(400_000):
            numbers = iter(range(10_000))
            eventually(lambda: made.observe(observed(next(numbers))) or not made.view().active)
        view = made.view()
        assert view.reason is not None
        assert os.strerror(errno.EFBIG) in view.reason
        made.observe(observed(0))
        again = made.start()
        assert (again.active, again.reason) == (True, None)
    assert len(list(tmp_path.glob("*.part"))) == 1
    assert len(records(tmp_path)) == 1


@contextmanager
def largest_file(size_bytes: int) -> Iterator[None]:
    """No file of this process may become larger: the nearest to a full disk that needs no disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_too_little_free_space_refuses_or_stops(router: zenoh.Session, tmp_path: Path) -> None:
    with recorder(router, tmp_path) as made:
        made.start()
        made.stop()
    before = records(tmp_path)
    with recorder(router, tmp_path, least_free_gb=1e9) as made, pytest.raises(RecordingError, match="keeps 1e"):
        made.start()
    assert records(tmp_path) == before != []  # to delete them all would not have helped


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="needs a small disk of its own: /dev/shm")
def test_a_disk_that_others_fill_ends_the_record_in_order(router: zenoh.Session) -> None:
    with tempfile.TemporaryDirectory(dir="/dev/shm") as name:
        folder, filler = Path(name), Path(name) / "filler"
        filler.write_bytes(bytes(20_000_000))
        least_free_gb = shutil.disk_usage(folder).free / 1e9
        filler.write_bytes(b"")
        with recorder(router, folder, least_free_gb=least_free_gb) as made:
            made.start()
            made.observe(observed(0))
            filler.write_bytes(bytes(30_000_000))
            eventually(lambda: not made.view().active)
            assert "GB free" in str(made.view().reason)
        assert read(records(folder)[0])["/revnm/tick"]


def test_a_folder_that_is_none_is_refused_in_words(router: zenoh.Session, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file")
    with recorder(router, taken) as made, pytest.raises(RecordingError, match=f"{taken}: File exists"):
        made.start()
    with recorder(router, None) as made, pytest.raises(RecordingError, match=r"set recording\.folder"):
        made.start()
    with recorder(router, Path("/proc/nothing")) as made, pytest.raises(RecordingError, match="/proc/nothing"):
        made.start()
    with recorder(router, Path("/proc")) as made, pytest.raises(RecordingError, match="/proc/revnm-"):
        made.start()


def test_a_server_drives_though_it_cannot_record_from_its_start(router: zenoh.Session, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file")
    with recorder(router, taken, from_start=True) as made:
        assert "File exists" in str(made.view().reason)
    with recorder(router, tmp_path / "fine", from_start=True) as made:
        assert made.view().active


def test_a_full_queue_drops_and_counts_and_never_waits() -> None:
    queue = EntryQueue(most_lines=3, most_tick_bytes=15_000)
    line, tick = LogEntry("x", 20, "name", 0), TickEntry(observed(0), (), 0, 0)  # a tick takes 48 × 64 × 3 bytes
    assert [queue.offer_line(line) for _ in range(5)] == [True, True, True, False, False]
    assert [queue.offer_tick(tick) for _ in range(2)] == [True, False]
    assert queue.dropped == 3
    assert [queue.take(timeout_s=1.0) for _ in range(4)] == [line, line, line, tick]
    assert queue.offer_line(line)
    assert queue.offer_tick(tick)
    assert queue.dropped == 3


def test_settings_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ConfigError, match="from_start needs a folder"):
        load_settings(overrides={"recording": {"from_start": True}})
    with pytest.raises(ConfigError, match="holds no two files"):
        load_settings(overrides={"recording": {"quota_gb": 0.9, "rotate_mb": 500}})


def test_a_record_says_what_made_it_and_nothing_secret(tmp_path: Path, tiny_bundle: Path) -> None:
    settings = load_settings(
        overrides={
            "camera": {"url": "rtsp://admin:s3cret@camera/stream", "name": "hall"},
            "http": {"token": "0123456789abcdefXYZ"},
        }
    )
    about = describe(settings, tiny_bundle)
    told = json.loads(about["settings"])
    assert told["camera"] == {"name": "hall", "url": "rtsp://***@camera/stream"}
    assert told["perception"]["planner"] == "revnm"
    assert set(told) == {"camera", "depth", "perception", "robots"}
    assert len(about["bundle_manifest_sha256"]) == 64
    assert not any(secret in str(about) for secret in ("s3cret", "0123456789abcdefXYZ"))


def test_a_package_that_another_replaces_is_no_reason_not_to_start() -> None:
    assert installed_versions(["numpy", "no-such-package"])["no-such-package"] is None


def test_threads_may_switch_at_once(router: zenoh.Session, tmp_path: Path) -> None:
    with recorder(router, tmp_path) as made:
        threads = [threading.Thread(target=action) for action in (made.start, made.stop) * 4]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert not list(tmp_path.glob("*.part"))


def test_sizes_of_strings_in_the_head_are_those_of_mcap(router: zenoh.Session, tmp_path: Path) -> None:
    with recorder(router, tmp_path) as made:
        made.start()
    head = records(tmp_path)[0].read_bytes()[:40]
    assert head[:8] == b"\x89MCAP0\r\n"
    assert head[8] == 1
    assert head[17:25] == struct.pack("<I", 4) + b"ros2"
