"""What commands end with."""

from __future__ import annotations

import subprocess
import sys

import pytest

from revnm_client.errors import ConfigError
from revnm_client.exit_status import exit_status


def raising(error: BaseException):
    def command() -> int:
        raise error

    return command


def test_a_command_says_its_own_status_and_nothing_else(capsys):
    assert exit_status("revnm-x", lambda: 1) == 1
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (ConfigError("--port 7x: expected a number"), 2, "--port 7x: expected a number"),
        (KeyboardInterrupt(), 130, "over"),
    ],
)
def test_what_ends_it_is_said_in_one_line(error, status, said, capsys):
    assert exit_status("revnm-x", raising(error), stopped="over") == status
    assert capsys.readouterr().err == f"revnm-x: {said}\n"


def test_a_broken_pipe_that_is_not_the_output_is_no_quiet_end():
    with pytest.raises(BrokenPipeError):
        exit_status("revnm-x", raising(BrokenPipeError()))


@pytest.mark.parametrize("buffered", [True, False])
def test_a_reader_that_leaves_early_makes_no_noise(buffered):
    command = [sys.executable, *([] if buffered else ["-u"]), "-m", "revnm_client.cli", "config", "schema"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
        assert process.wait(20.0) == 141
