"""Which tag library is used where pyapriltags is missing or its library does not load."""

from __future__ import annotations

import sys
from types import ModuleType

import pytest

from revnm_client.errors import ConfigError
from revnm_server.settings import load_settings
from revnm_server.tag import open_tag_library


class _Broken(ModuleType):
    """A pyapriltags whose shared library does not load."""

    class Detector:
        def __init__(self, **_: object) -> None:
            raise OSError("libapriltag.so: cannot open shared object file")


@pytest.fixture(params=["missing", "broken"])
def without_apriltag(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make pyapriltags unusable, as it is where there is no wheel, or one for another system."""
    monkeypatch.setitem(sys.modules, "pyapriltags", None if request.param == "missing" else _Broken("pyapriltags"))
    monkeypatch.delitem(sys.modules, "revnm_server.tag.apriltag", raising=False)


def test_the_april_tag_library_is_the_first_choice() -> None:
    assert [open_tag_library(name).library.name for name in ("auto", "apriltag", "opencv")] == [
        "apriltag",
        "apriltag",
        "opencv",
    ]
    assert open_tag_library("auto").note is None


@pytest.mark.usefixtures("without_apriltag")
def test_opencv_steps_in_and_says_so(caplog: pytest.LogCaptureFixture) -> None:
    opened = open_tag_library("auto")
    assert opened.library.name == "opencv"
    assert opened.note is not None
    assert "the AprilTag library does not load" in opened.note
    assert opened.note in caplog.text
    assert open_tag_library("opencv").note is None  # who asked for it need not be told


@pytest.mark.usefixtures("without_apriltag")
def test_what_was_asked_for_is_not_replaced() -> None:
    with pytest.raises(ConfigError, match=r"perception\.tag_library apriltag: .* set auto or opencv"):
        open_tag_library("apriltag")


def test_the_setting_knows_three_words() -> None:
    assert load_settings().perception.tag_library == "auto"
    with pytest.raises(ConfigError, match=r"perception\.tag_library"):
        load_settings(overrides={"perception": {"tag_library": "aruco"}})
