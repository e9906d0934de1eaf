from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest

from revnm_sim.live.children import ChildError, Children

PROGRAMS = {
    "patient": "import threading\n\ndef main():\n    print('patient', flush=True)\n    threading.Event().wait(60)\n",
    "failing": "def main():\n    print('no bread left', flush=True)\n    return 7\n",
    "curious": (
        "import os, sys, threading\n\ndef main():\n"
        "    print(sys.argv[1:], os.environ['COLOUR'], flush=True)\n    threading.Event().wait(60)\n"
    ),
}


@pytest.fixture
def children(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Children:
    for name, text in PROGRAMS.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return Children(tmp_path)


def wait_for_text(path: Path, text: str) -> None:
    deadline_s = time.monotonic() + 20.0
    while text not in path.read_text():
        assert time.monotonic() < deadline_s, f"{text!r} did not appear in {path}"
        threading.Event().wait(0.01)


def check_for(children: Children, seconds: float) -> None:
    deadline_s = time.monotonic() + seconds
    while time.monotonic() < deadline_s:
        children.check()
        threading.Event().wait(0.01)


def test_child_that_ends_is_reported_with_the_end_of_its_log(children: Children) -> None:
    with children:
        children.start("patient", "patient", [], env={})
        children.start("failing", "failing", [], env={})
        with pytest.raises(ChildError, match=r"(?s)failing ended with status 7.*failing\.log.*no bread left"):
            check_for(children, 20.0)


def test_child_gets_its_arguments_and_environment(children: Children) -> None:
    with children:
        children.start("curious", "curious", ["--seed", "3"], env={"COLOUR": "green"})
        wait_for_text(children.log_path("curious"), "['--seed', '3'] green")


def test_a_killed_child_is_not_missed_and_starts_again_with_its_log_behind_it(children: Children) -> None:
    with children:
        children.start("patient", "patient", [], env={})
        wait_for_text(children.log_path("patient"), "patient")
        before = children.pid("patient")
        children.kill("patient")
        assert not Path(f"/proc/{before}").exists()
        children.check()
        children.restart("patient")
        wait_for_text(children.log_path("patient"), "patient\npatient")
        assert children.pid("patient") != before


def test_a_frozen_child_is_frozen(children: Children) -> None:
    with children:
        children.start("patient", "patient", [], env={})
        children.send_signal("patient", signal.SIGSTOP)
        status = Path(f"/proc/{children.pid('patient')}/status")
        deadline_s = time.monotonic() + 5.0
        while "State:\tT" not in status.read_text():
            assert time.monotonic() < deadline_s
            threading.Event().wait(0.01)
        children.send_signal("patient", signal.SIGCONT)


def test_closing_ends_all(children: Children, tmp_path: Path) -> None:
    children.start("patient", "patient", [], env={})
    wait_for_text(children.log_path("patient"), "patient")
    children.check()
    children.close()
    running = [p for p in Path("/proc").glob("[0-9]*/environ") if _started_here(p, tmp_path)]
    assert running == []


def _started_here(environ: Path, folder: Path) -> bool:
    try:
        return os.fsencode(f"PYTHONPATH={folder}") in environ.read_bytes() and environ.parent.name != str(os.getpid())
    except OSError:
        return False
