"""``revnm-robot config``: what it prints, and its exit status."""

from __future__ import annotations

import json

import pytest

from revnm_client.cli import main
from revnm_client.settings import load_settings

TWELVE = """\
robot: rover
server: tcp/192.168.1.5:7447
profile: custom
limits: {max_v_mps: 0.4, max_w_radps: 1.0}
footprint: {length_m: 0.43, width_m: 0.36}
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(TWELVE)
    return path


def test_it_prints_what_is_in_effect_as_a_settings_file(file, capsys, tmp_path):
    assert main(["config", "check", str(file)]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"# {file}: good; in effect:\nrobot: rover\n")
    again = tmp_path / "again.yaml"
    again.write_text(out)
    assert load_settings(again) == load_settings(file)


def test_a_profile_tells_its_source(file, capsys):
    file.write_text("robot: rover\nserver: tcp/a:1\nprofile: kachaka\n")
    assert main(["config", "check", str(file)]) == 0
    assert "# kachaka: pf-robotics/kachaka-api" in capsys.readouterr().out


def test_it_prints_every_problem_and_returns_2(file, capsys):
    file.write_text(TWELVE.replace("0.4,", "12.0,").replace("0.36", "-1"))
    assert main(["config", "check", str(file)]) == 2
    assert capsys.readouterr().err.splitlines() == [
        f"{file}:4: limits.max_v_mps: 12.0: expected 0.05 to 2.0",
        f"{file}:5: footprint.width_m: -1: expected 0.05 to 2.0",
    ]


def test_a_file_that_is_none_is_an_error_and_no_traceback(tmp_path, capsys):
    assert main(["config", "check", str(tmp_path / "none.yaml")]) == 2
    assert "cannot be read: No such file" in capsys.readouterr().err


def test_files_that_are_not_there_are_told_with_key_and_remedy(file, capsys, tmp_path):
    server = "server: tls/192.168.1.5:7447\nsecurity: {authority: a.pem, certificate: r.pem, key: r.key}"
    file.write_text(TWELVE.replace("server: tcp/192.168.1.5:7447", server))
    (tmp_path / "a.pem").touch()
    assert main(["config", "check", str(file)]) == 2
    assert capsys.readouterr().err == (
        f"revnm-robot: {file}: security.certificate: {tmp_path}/r.pem: cannot be read: there is no such file "
        "(revnm-server pki robot can make it)\n"
    )
    for name in ("r.pem", "r.key"):
        (tmp_path / name).touch()
    assert main(["config", "check", str(file)]) == 0


def test_it_prints_the_schema(capsys):
    assert main(["config", "schema"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"]["robot"]["type"] == "string"
