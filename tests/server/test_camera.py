from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray

from revnm_client import keys
from revnm_client.cdr import encode_image
from revnm_client.errors import ConfigError, MessageError
from revnm_client.link import open_router
from revnm_client.messages import CompressedImage
from revnm_server.camera import CameraState, open_camera
from revnm_server.camera.jpeg import decode_jpeg, encode_jpeg, jpeg_size
from revnm_server.camera.pyav_reader import PyavReader
from revnm_server.camera.url import FileCamera, NetworkCamera, parse_camera_url, redact
from revnm_sim.live.rtsp_server import Fault, RtspServer, filming

from .waiting import eventually

LOGIN = ("viewer", "s3cret")


@pytest.fixture(scope="module")
def session() -> Iterator[zenoh.Session]:
    with open_router(["tcp/127.0.0.1:0"]) as router:
        yield router


def counting_picture(index: int) -> NDArray[np.uint8]:
    """A dark picture with one bright column that moves to the right."""
    image = np.full((96, 160, 3), 20, dtype=np.uint8)
    image[:, 8 * (index % 20) : 8 * (index % 20) + 8] = (230, 40, 40)
    return image


def write_video(path: Path, frames: int, *, fps: int = 50) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=fps, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = 160, 96, "yuv420p"
        stream.time_base = Fraction(1, fps)
        for index in range(frames):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(counting_picture(index), format="rgb24")))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("rtsp://admin:pa%40ss@10.0.0.5:554/live", "rtsp://***@10.0.0.5:554/live"),
        ("rtsp://cam/live?user=admin&password=x", "rtsp://cam/live?user=***&password=***"),
        ("rtsp://a:b@c@host/x", "rtsp://***@host/x"),
        ("rtsp://cam:554/user=admin&password=x&channel=1", "rtsp://cam:554/user=***&password=***&channel=***"),
        ("rtsp://a:pa#ss@host/x", "rtsp://***@host/x"),
        ("rtsp://a:12/34@host/x", "rtsp://***@host/x"),
        ("rtsps://10.0.0.1:7441/7vpkH1W5oKq9gEtQ?enableSrtp", "rtsps://10.0.0.1:7441/***?enableSrtp=***"),
        ("rtsp://cam/Streaming/Channels/102", "rtsp://cam/Streaming/Channels/102"),
        ("rtsp://cam/h264Preview_01_main", "rtsp://cam/h264Preview_01_main"),
        ("rtsp://[a:b", "***"),
        ("file:///tmp/a.mp4?loop=1", "file:///tmp/a.mp4?loop=1"),
    ],
)
def test_addresses_are_shown_without_credentials(url: str, shown: str) -> None:
    assert redact(url) == shown


@pytest.mark.parametrize(
    "url",
    [
        "",
        "http://u:secret@cam/x",
        "rtsp://u:secret#1@cam/x",
        "rtsp://u:secret/1@cam/x",
        "rtsp://u:1@[secret",
        "rtsp://",
        "file://relative.mp4",
        "file:relative.mp4",
        "file:///a?speed=2",
        "file:///a?speed",
        "zenoh://a b",
        "zenoh://c/d",
    ],
)
def test_other_addresses_are_refused_without_telling_secrets(url: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_camera_url(url)
    assert "secret" not in str(caught.value)


def test_options_of_a_file() -> None:
    assert parse_camera_url("file:///a%20b.mp4?loop=1&realtime=0") == FileCamera(
        Path("/a b.mp4"), loop=True, realtime=False
    )


def test_a_file_plays_to_its_end(tmp_path: Path, session: zenoh.Session) -> None:
    camera = open_camera(f"file://{write_video(tmp_path / 'a.mp4', 10)}?realtime=0", session)
    try:
        eventually(lambda: camera.status().state is CameraState.ENDED)
        frame = camera.latest()
        assert frame is not None
        assert frame.seq == 10
        assert frame.size_px == (160, 96)
        assert camera.status().reason == "the file is over"
        # The ninth column of the last picture is the bright one, red first.
        assert frame.image[48, 76, 0] > 150 > frame.image[48, 76, 2]
    finally:
        camera.close()


def test_a_file_loops_at_the_speed_of_its_recording(tmp_path: Path, session: zenoh.Session) -> None:
    camera = open_camera(f"file://{write_video(tmp_path / 'a.mp4', 10)}?loop=1", session)
    try:
        began_s = time.monotonic()
        eventually(lambda: camera.wait_newer(0, timeout_s=0.0) and camera.latest().seq >= 25)  # type: ignore[union-attr]
        assert time.monotonic() - began_s > 0.35  # two turns of 10 pictures at 50 a second take 0.4 s
        assert camera.status().state is CameraState.RUNNING
    finally:
        camera.close()


def test_a_missing_file_says_so(tmp_path: Path, session: zenoh.Session) -> None:
    camera = open_camera(f"file://{tmp_path}/none.mp4", session)
    try:
        eventually(lambda: camera.status().state is CameraState.RECONNECTING)
        assert camera.status().reason == "No such file or directory"
        assert camera.latest() is None
    finally:
        camera.close()


def test_a_file_without_pictures_says_so(tmp_path: Path, session: zenoh.Session) -> None:
    with av.open(str(tmp_path / "sound.wav"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        silence = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        silence.sample_rate = 8000
        container.mux(stream.encode(silence))
    camera = open_camera(f"file://{tmp_path}/sound.wav", session)
    try:
        eventually(lambda: camera.status().state is CameraState.RECONNECTING)
        assert "no pictures in it" in str(camera.status().reason)
    finally:
        camera.close()


def test_rtsp_runs_freezes_and_comes_back() -> None:
    with RtspServer(login=LOGIN) as server, filming(server, counting_picture, fps=15):
        source = parse_camera_url(server.url)
        assert isinstance(source, NetworkCamera)
        camera = PyavReader(source, timeout_s=2.0)  # well over the second after which the picture is stale
        try:
            frame = eventually(lambda: camera.wait_newer(-1, timeout_s=0.1))
            assert frame.size_px == (160, 96)
            assert eventually(lambda: camera.status().fps) > 5
            assert "s3cret" not in camera.redacted_url

            server.set_fault(Fault.FROZEN)
            eventually(lambda: camera.status().state is CameraState.STALE, within_s=3.0)
            assert camera.status().reason.startswith("no new picture for")  # type: ignore[union-attr]
            eventually(lambda: camera.status().state is CameraState.RECONNECTING, within_s=8.0)
            assert camera.status().reason == "nothing came for 2.0 s"
            assert "s3cret" not in str(camera.status())

            server.set_fault(Fault.NONE)
            eventually(lambda: camera.status().state is CameraState.RUNNING, within_s=10.0)
            assert server.connected >= 2
        finally:
            camera.close()
        assert camera.status().state is CameraState.ENDED


def test_rtsp_reconnects_after_the_connection_broke() -> None:
    with RtspServer(login=LOGIN) as server, filming(server, counting_picture, fps=15):
        source = parse_camera_url(server.url)
        assert isinstance(source, NetworkCamera)
        camera = PyavReader(source)
        try:
            eventually(lambda: camera.status().state is CameraState.RUNNING)
            server.drop()
            eventually(lambda: camera.status().state is CameraState.RECONNECTING)
            eventually(lambda: camera.status().state is CameraState.RUNNING)
            assert server.connected == 2
        finally:
            camera.close()


def test_an_unreachable_camera_is_tried_again_and_tells_no_password() -> None:
    with RtspServer(login=LOGIN) as server, filming(server, counting_picture, fps=15):
        url = server.url
    source = parse_camera_url(url)
    assert isinstance(source, NetworkCamera)
    camera = PyavReader(source)
    try:
        eventually(lambda: camera.status().state is CameraState.RECONNECTING)
        assert camera.status().reason == "Connection refused"
    finally:
        camera.close()


def jpeg_message(stamp_ns: int, image: NDArray[np.uint8] | None = None) -> bytes:
    data = encode_jpeg(counting_picture(0) if image is None else image)
    return encode_image(CompressedImage(stamp_ns, "jpeg", data))


def test_zenoh_pictures_keep_their_stamp_where_it_is_believable(session: zenoh.Session) -> None:
    camera = open_camera("zenoh://hall", session)
    try:
        jpeg_message(0)  # the first one takes its time: message types are read
        now_ns = time.time_ns()
        session.put(keys.image("hall"), jpeg_message(now_ns - 200_000_000))
        frame = eventually(lambda: camera.wait_newer(-1, timeout_s=0.1))
        assert frame.stamp_ns == now_ns - 200_000_000
        session.put(keys.image("hall"), jpeg_message(7_000_000_000))  # a clock that counts from its start
        frame = eventually(lambda: camera.wait_newer(frame.seq, timeout_s=0.1))
        assert abs(frame.stamp_ns - time.time_ns()) < 1_000_000_000
    finally:
        camera.close()


def test_zenoh_liveness_is_by_stamp_and_not_by_content(session: zenoh.Session) -> None:
    camera = open_camera("zenoh://lobby", session)
    try:
        stamp_ns = time.time_ns()

        def send_same_picture_with_new_stamp() -> bool:
            session.put(keys.image("lobby"), jpeg_message(time.time_ns()))
            return (camera.latest() or frame_zero).seq >= 20

        frame_zero = eventually(
            lambda: session.put(keys.image("lobby"), jpeg_message(stamp_ns)) or camera.wait_newer(-1, timeout_s=0.1)
        )
        eventually(send_same_picture_with_new_stamp)
        assert camera.status().state is CameraState.RUNNING

        last_ns = time.time_ns()

        def send_frozen_picture() -> bool:
            session.put(keys.image("lobby"), jpeg_message(last_ns))
            return camera.status().state is CameraState.STALE

        eventually(send_frozen_picture, within_s=4.0)
        assert "frozen" in str(camera.status().reason)
    finally:
        camera.close()


def test_zenoh_garbage_and_bombs_are_counted(session: zenoh.Session) -> None:
    camera = open_camera("zenoh://yard", session)
    bomb = bytearray(encode_jpeg(counting_picture(0)))
    place = bomb.index(b"\xff\xc0")
    bomb[place + 5 : place + 9] = b"\xff\xff\xff\xff"  # claims 65535 x 65535
    payloads = [b"garbage", jpeg_message(1)[:-500], encode_image(CompressedImage(1, "jpeg", bytes(bomb)))]
    try:
        for count, payload in enumerate(payloads, start=1):
            session.put(keys.image("yard"), payload)
            eventually(lambda count=count: camera.status().rejected == count)
        assert camera.latest() is None
        assert camera.status().state is CameraState.INIT
    finally:
        camera.close()


def test_jpeg_size_agrees_with_opencv() -> None:
    for shape in [(48, 64), (333, 77)]:
        image = np.random.default_rng(1).integers(0, 255, (*shape, 3), dtype=np.uint8)
        for flags in ([], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]):
            data = cv2.imencode(".jpg", image, flags)[1].tobytes()
            assert jpeg_size(data) == shape[::-1]
            assert decode_jpeg(data).shape == image.shape


def test_broken_jpegs_are_refused() -> None:
    data = encode_jpeg(counting_picture(0))
    rng = np.random.default_rng(2)
    for cut in range(0, 300, 7):
        with pytest.raises(MessageError):
            decode_jpeg(data[:cut])
    for _ in range(200):
        hostile = bytearray(data)
        for place in rng.integers(2, 200, 3):
            hostile[place] = rng.integers(256)
        with contextlib.suppress(MessageError):
            assert decode_jpeg(bytes(hostile)).ndim == 3
