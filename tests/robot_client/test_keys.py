from __future__ import annotations

import pytest
import zenoh

from revnm_client import keys
from revnm_client.errors import ConfigError

ALL_KEYS = [
    (keys.scan, "rover/scan"),
    (keys.odom, "rover/odom"),
    (keys.cmd_vel, "rover/cmd_vel"),
    (keys.waypoints, "rover/waypoints"),
    (keys.state, "rover/revnm/state"),
    (keys.stop, "rover/revnm/stop"),
    (keys.time, "rover/revnm/time"),
    (keys.image, "rover/image/compressed"),
]


@pytest.mark.parametrize(("key", "expected"), ALL_KEYS)
def test_keys_follow_the_ros_bridge(key, expected):
    assert key("rover") == expected
    assert str(zenoh.KeyExpr(key("rover"))) == expected  # Zenoh accepts it as canonical


@pytest.mark.parametrize("name", ["a", "Rover-7_b", "x" * 32])
def test_names_that_are_names(name):
    assert keys.check_name(name) == name


@pytest.mark.parametrize(
    "name", ["", "x" * 33, "a/b", "*", "**", "a b", "rover\n", "röver", "$x", "a#", "a?", "@", ".", "a\0"]
)
@pytest.mark.parametrize("key", [key for key, _ in ALL_KEYS])
def test_names_that_would_reach_other_keys_are_refused(key, name):
    with pytest.raises(ConfigError, match="no robot or camera name"):
        key(name)
