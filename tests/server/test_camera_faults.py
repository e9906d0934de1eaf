"""What the reader says of cameras that are broken, and that it says it without their passwords."""

from __future__ import annotations

import errno
import logging
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from revnm_client.errors import ConfigError, FileError
from revnm_server.camera import CameraState
from revnm_server.camera.backoff import Backoff
from revnm_server.camera.lag import StreamLag
from revnm_server.camera.pyav_reader import PyavReader
from revnm_server.camera.stream import StreamSource, explain
from revnm_server.camera.url import DeviceCamera, FileCamera, NetworkCamera, parse_camera_url
from revnm_server.settings import Settings, load_settings
from revnm_server.settings.camera import CameraSettings
from revnm_sim.live.h264_rtp import H264Encoder
from revnm_sim.live.rtsp_server import Fault, RtspServer, filming

from .waiting import eventually

SECRET = "s3cret"


def shaded(index: int) -> NDArray[np.uint8]:
    """A picture whose brightness tells its number, modulo ten."""
    return np.full((96, 160, 3), 20 + 20 * (index % 10), dtype=np.uint8)


@contextmanager
def reading(source: StreamSource | str, *, lag_bin_s: float = 1.0) -> Iterator[PyavReader]:
    camera = PyavReader(
        parse_camera_url(source) if isinstance(source, str) else source,  # type: ignore[arg-type]
        new_lag=lambda: StreamLag(bin_s=lag_bin_s),
    )
    try:
        yield camera
    finally:
        camera.close()


@contextmanager
def hanging_up() -> Iterator[tuple[str, list[float]]]:
    """A camera that closes every connection at once; yield its address and when somebody came."""
    came_s: list[float] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def run() -> None:
            try:
                while True:
                    listener.accept()[0].close()
                    came_s.append(time.monotonic())
            except OSError:
                pass

        thread = threading.Thread(target=run)
        thread.start()
        yield f"rtsp://viewer:{SECRET}@127.0.0.1:{listener.getsockname()[1]}/x", came_s
        listener.shutdown(socket.SHUT_RDWR)
        thread.join()


def test_options_of_a_device() -> None:
    assert parse_camera_url("v4l2:///dev/video0") == DeviceCamera(Path("/dev/video0"), None, None, None)
    wanted = parse_camera_url("v4l2:///dev/v4l/by-id/usb-x-index0?size=1280x720&fps=30&format=mjpeg")
    assert wanted == DeviceCamera(Path("/dev/v4l/by-id/usb-x-index0"), (1280, 720), 30, "mjpeg")


@pytest.mark.parametrize(
    "rest", ["video0", "/etc/passwd", "/dev/video0?size=1280", "/dev/video0?fps=0", "/dev/video0?format=exe"]
)
def test_malformed_devices_are_refused(rest: str) -> None:
    with pytest.raises(ConfigError, match="v4l2:///dev/video0"):
        parse_camera_url(f"v4l2://{rest}")


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("/dev/no-camera", "/dev/no-camera: no such device: is the camera plugged in?"),
        ("/dev/null", "/dev/null: it is no camera"),
    ],
)
def test_a_device_that_is_no_camera_says_so(path: str, reason: str) -> None:
    with reading(f"v4l2://{path}") as camera:
        eventually(lambda: camera.status().state is CameraState.RECONNECTING)
        assert camera.status().reason == reason
        assert camera.redacted_url == f"v4l2://{path}"


def test_a_device_that_cannot_be_had_says_what_to_do() -> None:
    source = DeviceCamera(Path("/dev/video0"), None, None, None)
    busy = av.error.OSError(errno.EBUSY, "Device or resource busy", "/dev/video0")
    forbidden = av.error.PermissionError(errno.EACCES, "Permission denied", "/dev/video0")
    assert explain(busy, source) == "/dev/video0: another program uses it"
    assert explain(forbidden, source) == "/dev/video0: permission denied: is the user in the group video?"


def test_a_stream_of_the_wrong_codec_says_so_and_comes_back() -> None:
    with RtspServer() as server, filming(server, shaded, fps=15):
        server.set_fault(Fault.WRONG_CODEC)
        with reading(server.url) as camera:
            eventually(lambda: camera.status().state is CameraState.RECONNECTING)
            assert "no picture: is it of the codec that the camera says (hevc)?" in str(camera.status().reason)
            server.set_fault(Fault.NONE)
            eventually(lambda: camera.status().state is CameraState.RUNNING)


def test_a_refused_login_says_so_and_is_not_tried_often() -> None:
    with RtspServer(login=("viewer", "right")) as server:
        wrong = server.url.replace("right", SECRET)
        with reading(wrong) as camera:
            eventually(lambda: camera.status().state is CameraState.RECONNECTING)
            assert camera.status().reason == "the camera refuses the login: check user and password"
            came = server.connected
            with hanging_up() as (url, came_s), reading(url):
                eventually(lambda: len(came_s) >= 3)  # who is not locked out for it tries again soon
            assert server.connected == came


def test_a_silent_camera_is_given_up_and_tried_again() -> None:
    with RtspServer() as server:
        server.set_fault(Fault.BLACKHOLE)
        with reading(server.url) as camera:
            eventually(lambda: camera.status().reason == "nothing came for 2.0 s")
            eventually(lambda: server.connected >= 2)


def test_attempts_go_on_with_short_pauses_and_are_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    with hanging_up() as (url, came_s), caplog.at_level(logging.INFO), reading(url) as camera:
        eventually(lambda: len(came_s) >= 4)
        assert camera.status().state is CameraState.RECONNECTING
    assert np.diff(came_s).min() > 0.2
    assert max(Counter(record.getMessage() for record in caplog.records).values()) == 1


def test_pauses_are_short_and_differ() -> None:
    backoff, other = (Backoff(np.random.default_rng(seed)) for seed in (1, 2))
    pauses_s = [backoff.pause_s(worked=False) for _ in range(50)]
    assert 0.25 <= pauses_s[0] <= 0.5 <= pauses_s[1] <= 1.0
    assert all(0.75 <= pause_s <= 1.5 for pause_s in pauses_s[2:])
    assert len(set(pauses_s)) == 50
    assert other.pause_s(worked=False) != pauses_s[0]
    assert 0.25 <= backoff.pause_s(worked=True) <= 0.5 <= backoff.pause_s(worked=False) <= 1.0
    assert backoff.pause_s(worked=False, refused=True) >= 15.0


def test_pictures_that_cannot_be_decoded_are_passed_over(tmp_path: Path) -> None:
    encoder = H264Encoder((160, 96), fps=10)  # a key frame every 10 pictures
    pictures = [b"".join(b"\0\0\0\1" + unit for unit in encoder.encode(shaded(index))) for index in range(20)]
    pictures[12] = b"\0\0\0\1\x65" + np.random.default_rng(3).bytes(500)
    (tmp_path / "late.h264").write_bytes(b"".join(pictures[3:]))  # begins in the midst of a group
    with reading(FileCamera(tmp_path / "late.h264", loop=False, realtime=False)) as camera:
        eventually(lambda: camera.status().state is CameraState.ENDED)
        frame = camera.latest()
    assert frame is not None
    assert frame.seq >= 8
    assert abs(int(frame.image[48, 80, 0]) - 200) < 10


def test_a_picture_is_stamped_with_when_it_began_to_come() -> None:
    shown_ns: dict[int, int] = {}

    def picture(index: int) -> NDArray[np.uint8]:
        shown_ns[index % 10] = time.time_ns()
        return shaded(index)

    with RtspServer() as server, filming(server, picture, fps=4), reading(server.url) as camera:

        def stamped_well() -> bool:
            frame = camera.wait_newer(-1, timeout_s=0.1)
            if frame is None:
                return False
            late_s = (frame.stamp_ns - shown_ns[round((int(frame.image[0, 0, 0]) - 20) / 20)]) / 1e9
            return 0.0 <= late_s < 0.1  # FFmpeg gives it 0.25 s late, with the next one

        eventually(stamped_well)


@pytest.mark.parametrize("speed", [1.0, 0.99, 24 / 25, 21 / 25, 25 / 30, 1.05])
def test_a_camera_whose_clock_goes_wrong_is_not_late(speed: float) -> None:
    lag, jitter = StreamLag(), np.random.default_rng(0)
    late_s = [lag.note(speed * step / 25, 100 + step / 25 + jitter.exponential(0.02)) for step in range(3000)]
    assert max(late_s) < 0.3  # pictures are dropped from 0.5 s on


@pytest.mark.parametrize("speed", [1.0, 21 / 25])
def test_what_the_network_held_up_is_late_by_just_that(speed: float) -> None:
    lag = StreamLag()
    late_s = {}
    for step in range(1500):
        taken_s = step / 25
        came_s = 41.5 if 40.0 <= taken_s < 41.5 else taken_s  # nothing comes for 1.5 s, then all of it
        late_s[taken_s] = lag.note(speed * taken_s, 100 + came_s)
    assert late_s[39.96] == pytest.approx(0.0, abs=1e-6)
    assert late_s[40.2] == pytest.approx(1.3, abs=0.01)
    assert late_s[41.0] == pytest.approx(0.5, abs=0.01)
    assert late_s[42.0] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("fps", [5.0, 30.0])
def test_pictures_from_before_the_connection_are_none(fps: float) -> None:
    lag, rng = StreamLag(), np.random.default_rng(0)
    piled = round(2.0 * fps)  # since the last key frame, all within 0.2 s
    told = [lag.piled_up(k / fps, 0.2 * k / piled) for k in range(piled)]
    assert all(told)
    live = [
        lag.piled_up(k / fps, 0.2 + (k + 1 - piled + rng.uniform(0.0, 0.3)) / fps) for k in range(piled, 10 * piled)
    ]
    assert not any(live)


def test_a_stream_whose_stamps_go_too_fast_is_shown_after_seconds() -> None:
    lag = StreamLag()
    told = [lag.piled_up(0.1 * k, 0.04 * k) for k in range(200)]
    assert told.index(False) == 75


def test_pictures_that_piled_up_are_not_shown() -> None:
    """A camera whose pictures take ever longer to come, as where the computer decodes slower than they are sent."""
    began_ns = time.monotonic_ns()
    counter = iter(range(1_000_000))
    with RtspServer(fps=50) as server:  # a key frame every 50 pictures

        def show(*, slow: bool) -> None:
            late_ns = (time.monotonic_ns() - began_ns) * 9 // 10 if slow else 0  # slower than any clock
            server.show(shaded(next(counter)), taken_ns=time.monotonic_ns() - late_ns)

        with reading(server.url, lag_bin_s=0.05) as camera:
            eventually(lambda: show(slow=True) or camera.status().state is CameraState.RUNNING)
            eventually(lambda: show(slow=True) or "old when they are decoded" in str(camera.status().reason))
            assert camera.status().state is CameraState.STALE
            eventually(lambda: show(slow=False) or camera.status().state is CameraState.RUNNING)
            eventually(lambda: show(slow=False) or (camera.status().fps or 0.0) > 10.0)  # more than its key frames


def test_no_password_gets_out(
    caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    shown: list[str] = []
    with hanging_up() as (closing, _), RtspServer(login=("viewer", "right")) as server, caplog.at_level(logging.DEBUG):
        for url in (closing, server.url.replace("right", SECRET), f"rtsp://viewer:{SECRET}@127.0.0.1:1/x"):
            source = parse_camera_url(url)
            assert isinstance(source, NetworkCamera)
            with reading(source) as camera:
                eventually(lambda camera=camera: camera.status().state is CameraState.RECONNECTING)
                settings = load_settings(overrides={"camera": {"url": url}})
                texts = (source, camera, camera.redacted_url, camera.status(), settings, settings.camera)
                shown += [f"{text!r} {text}" for text in texts]
    file = tmp_path / "server.yaml"
    for line in (f'camera: {{url: "rtsp://a:{SECRET}@h/x', f"camera: {{name: 'rtsp://a:{SECRET}@h/x'}}"):
        file.write_text(line)
        with pytest.raises((FileError, ConfigError)) as caught:
            load_settings(file)
        shown.append(str(caught.value))
    for url in (f"zenoh://a:{SECRET}@h", f"v4l2://a:{SECRET}@h/dev/video0", f"rtsp://a:{SECRET}@h:99999/x"):
        with pytest.raises(ConfigError) as refused:
            parse_camera_url(url)
        shown.append(str(refused.value))
    assert isinstance(settings, Settings)
    assert isinstance(settings.camera, CameraSettings)
    assert SECRET not in "".join(shown)
    assert SECRET not in caplog.text
    assert SECRET not in "".join(capfd.readouterr())
