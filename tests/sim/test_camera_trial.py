"""The measuring of the camera reader: times in pictures survive compression, faults are timed, the simulator films."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revnm_sim.burnt_time import burn_time, read_age_ms
from revnm_sim.cli import main
from revnm_sim.live.rtsp_server import RtspServer
from revnm_sim.measures.camera_trial import BREAKAGES, Scene, sample_ages_ms, time_4k, time_fault, watched


@pytest.mark.parametrize("time_ms", [0, 1, 123_456_789, (1 << 32) - 1, (1 << 40) + 5])
def test_a_burnt_time_is_read_again(time_ms: int) -> None:
    luma = np.full((480, 640), 90, np.uint8)
    burn_time(luma, time_ms)
    noisy = (luma + np.random.default_rng(0).normal(0, 20, luma.shape)).clip(0, 255).astype(np.uint8)
    assert read_age_ms(noisy, time_ms + 70) == 70


def test_a_picture_without_a_time_has_no_age() -> None:
    assert read_age_ms(np.full((480, 640), 90, np.uint8), 5) is None


def test_faults_and_ages_are_timed() -> None:
    scene = Scene((640, 480))
    with watched(scene, fps=10) as (server, camera):
        frozen = time_fault(server, camera, BREAKAGES["frozen"], hold_s=0.1)
        assert frozen.state == "stale"
        assert 0.5 < frozen.state_after_s < 5.0  # a second after the last picture, which came before
        assert "no new picture" in frozen.reason
        dropped = time_fault(server, camera, BREAKAGES["dropped"], hold_s=0.0)
        assert dropped.state == "reconnecting"
        assert 0.2 < dropped.recovered_after_s < 20.0  # it waits at least half of half a second
        ages_ms = sample_ages_ms(camera, rate_hz=20.0, count=3)
        assert all(0 <= age_ms < 20_000 for age_ms in ages_ms)
        assert time_4k(scene, camera, hold_s=0.0).state == "running"


def test_the_command_refuses_nonsense(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["camera", "--repeats", "0", "--out", str(tmp_path)]) == 2
    assert "--repeats" in capsys.readouterr().err


@pytest.mark.parametrize("address", ["8554", "host:", "host:x", "host:70000"])
def test_an_address_for_rtsp_is_checked(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["run", "--rtsp", address])
    assert "expected HOST:PORT" in capsys.readouterr().err


def test_a_taken_address_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with RtspServer() as server:
        assert main(["run", "--rtsp", server.url.split("/")[2]]) == 2
    assert "cannot serve RTSP on 127.0.0.1" in capsys.readouterr().err
