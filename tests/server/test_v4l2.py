"""FFmpeg's Video4Linux input on a device that a preloaded library pretends to be: no test machine has a camera."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FAKE = Path(__file__).with_name("fake_v4l2.c")
DRIVER = """
import json, os, sys, time
from revnm_server.camera import CameraState
from revnm_server.camera.pyav_reader import PyavReader
from revnm_server.camera.url import parse_camera_url

def look(query, until):
    camera = PyavReader(parse_camera_url("v4l2:///dev/video-fake" + query))
    deadline_s = time.monotonic() + 10
    while camera.status().state is not until and time.monotonic() < deadline_s:
        time.sleep(0.01)
    status, frame = camera.status(), camera.latest()
    camera.close()
    return [status.state, status.reason, frame and frame.size_px, frame and frame.image[9, 9].tolist()]

seen = {query: look(query, CameraState.RUNNING) for query in ("", "?size=320x240&fps=50&format=yuyv422")}
seen |= {query: look(query, CameraState.RECONNECTING) for query in ("?fps=30", "?format=h264")}
seen["?size=1280x720"] = look("?size=1280x720", CameraState.STALE)
os.environ["FAKE_BUSY"] = "1"
seen["busy"] = look("", CameraState.RECONNECTING)
os.environ["FAKE_OPEN_ERRNO"] = "13"
seen["forbidden"] = look("", CameraState.RECONNECTING)
print(json.dumps(seen))
"""


@pytest.mark.skipif(
    shutil.which("cc") is None or not Path("/usr/include/linux/videodev2.h").exists(),
    reason="needs a C compiler and the headers of Linux",
)
def test_a_device_is_read_and_its_troubles_are_told(tmp_path: Path) -> None:
    library = tmp_path / "fake_v4l2.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(library), str(FAKE), "-ldl"], check=True)
    ran = subprocess.run(
        [sys.executable, "-c", DRIVER],
        env=os.environ | {"LD_PRELOAD": str(library)},
        capture_output=True,
        check=True,
        timeout=60,
    )
    seen = json.loads(ran.stdout)
    device, hint = "/dev/video-fake", "; v4l2-ctl -d /dev/video-fake --list-formats-ext shows what it can"
    state, _, size_px, pixel = seen[""]
    assert (state, size_px) == ("running", [640, 480])
    assert pixel[1] > pixel[0]  # luma and chroma of the first picture are all 100: a green
    assert seen["?size=320x240&fps=50&format=yuyv422"][2] == [320, 240]
    assert seen["?fps=30"][1] == f"{device}: no such device: was the camera unplugged?"  # after 200 pictures
    assert seen["?size=1280x720"][1] == f"{device}: what it gives is no picture with size=1280x720{hint}"
    assert seen["?size=1280x720"][2] is None
    assert seen["?format=h264"][1] == f"{device}: it refuses format=h264{hint}"
    assert seen["busy"][1] == f"{device}: another program uses it"
    assert seen["forbidden"][1] == f"{device}: permission denied: is the user in the group video?"
