"""The layout of the settings file: which keys there are, and what each may be."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from revnm_client.settings.document import Place
from revnm_client.settings.kinds import (
    Anything,
    Choice,
    Flag,
    Kind,
    Note,
    Number,
    OneOrMore,
    Schema,
    Section,
    Text,
    Whole,
    as_mapping,
)
from revnm_client.settings.profiles import PROFILES

CUSTOM = "custom"

_CLASS = r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*:[A-Za-z_]\w*"
_NAME = Text(r"[A-Za-z0-9_-]{1,32}", "1 to 32 of A-Z a-z 0-9 _ -, as the server knows the robot")
_ENDPOINT = Text(r"[a-z][a-z0-9_-]*/\S+", "tcp/HOST:PORT or the like, such as tcp/192.168.1.5:7447")
_HOST_PORT = Text(r"[A-Za-z0-9._-]+(:[0-9]{1,5})?", "HOST or HOST:PORT, such as 192.168.1.20:26400")
_TOPIC = Text(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*/?", "a name of ROS 2 such as scan or front/scan")
_FILE = Text(r"[^\0]+", "the path of a file")
_COMMAND = Choice(("twist", "twist_stamped"))

DRIVERS: dict[str, Section] = {
    "zenoh": Section({"kind": Anything(), "connect": OneOrMore(_ENDPOINT), "cmd_vel": _COMMAND}),
    "rmw_zenoh": Section(
        {
            "kind": Anything(),
            "connect": OneOrMore(_ENDPOINT),
            "domain": Whole(0, 232),
            "namespace": _TOPIC,
            "scan_topic": _TOPIC,
            "odom_topic": _TOPIC,
            "cmd_vel_topic": _TOPIC,
            "cmd_vel": _COMMAND,
            "distro": Choice(("humble",)),
        }
    ),
    "kachaka": Section({"kind": Anything(), "address": _HOST_PORT}, required=("address",)),
}


@dataclass(frozen=True, slots=True)
class Driver:
    """The driver's kind and its options: those of a kind of ours are known, those of a class of somebody's are not."""

    def read(self, value: Any, place: Place, note: Note) -> Any:
        """Return the keys that are there."""
        given = as_mapping(value, place, note)
        kind = given.get("kind", "zenoh")
        if isinstance(kind, str) and kind in DRIVERS:
            return DRIVERS[kind].read(given, place, note)
        if not isinstance(kind, str) or not re.fullmatch(_CLASS, kind):
            expected = f"one of {', '.join(DRIVERS)}, or package.module:Class"
            note((*place, "kind"), f"{kind!r:.80}: expected {expected}")
        return given

    def schema(self) -> Schema:
        """Return the JSON Schema: one shape a kind."""
        shapes = [{**section.schema(), "title": kind} for kind, section in DRIVERS.items()]
        for kind, shape in zip(DRIVERS, shapes, strict=True):
            shape["properties"]["kind"] = {"const": kind}
            if kind != "zenoh":  # the one that is meant where no kind is said
                shape["required"] = ["kind", *shape["required"]]
        foreign = {"type": "object", "properties": {"kind": {"type": "string", "pattern": f"^{_CLASS}$"}}}
        return {"anyOf": [*shapes, {**foreign, "required": ["kind"]}]}


SECURITY = Section({"authority": _FILE, "certificate": _FILE, "key": _FILE, "password_file": _FILE})
LIMITS = Section(
    {
        "max_v_mps": Number(0.05, 2.0),
        "max_w_radps": Number(0.1, 4.0),
        "max_a_mps2": Number(0.1, 5.0),
        "max_alpha_radps2": Number(0.2, 20.0),
    }
)
FOOTPRINT = Section({"length_m": Number(0.05, 2.0), "width_m": Number(0.05, 2.0), "center_x_m": Number(-1.0, 1.0)})
LIDAR = Section(
    {
        "x_m": Number(-1.0, 1.0),
        "y_m": Number(-1.0, 1.0),
        "yaw_rad": Number(-3.1416, 3.1416),
        "zero_is_open": Flag(),
    }
)
BRAKING = Section(
    {
        "delay_s": Number(0.05, 1.0),
        "braking_mps2": Number(0.1, 5.0),
        "braking_radps2": Number(0.2, 20.0),
        "margin_m": Number(0.0, 0.5),
    }
)
SAFETY = Section(
    {
        "max_plan_age_s": Number(0.1, 2.0),
        "max_scan_age_s": Number(0.1, 1.0),
        "max_odometry_age_s": Number(0.1, 1.0),
    }
)
LOG = Section({"level": Choice(("debug", "info", "warning", "error")), "format": Choice(("text", "json"))})

_FIELDS: dict[str, Kind] = {
    "robot": _NAME,
    "server": OneOrMore(_ENDPOINT),
    "security": SECURITY,
    "profile": Choice((*PROFILES, CUSTOM)),
    "driver": Driver(),
    "limits": LIMITS,
    "footprint": FOOTPRINT,
    "lidar": LIDAR,
    "braking": BRAKING,
    "safety": SAFETY,
    "log": LOG,
}
ROOT = Section(_FIELDS, required=("robot", "server", "profile"))

NEEDED_BY_CUSTOM = (
    ("limits", "max_v_mps"),
    ("limits", "max_w_radps"),
    ("footprint", "length_m"),
    ("footprint", "width_m"),
)
