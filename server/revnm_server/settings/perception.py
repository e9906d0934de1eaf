"""Settings of the models, of how they are run, and of what robots look like."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import pydantic

from revnm_server.networks.providers import Provider
from revnm_server.settings.section import Section


class PerceptionSettings(Section):
    """What makes plans, the models and how they are run, and what robots look like.

    ``planner`` is ``revnm``, the bundle's policy, or ``bev``, a search on the map that the camera's own calibration
    makes; that one needs ``tag_height_m``, the height of the tags over the floor, and the body of a robot, the
    tag in its middle. ``calibration_dir`` keeps what it learnt, and where robots are, over a restart. ``provider`` runs
    the networks, each with ``threads`` where that is the CPU. ``tag_library`` is what finds the tags: ``apriltag``,
    ``opencv``, which takes three times as long, or ``auto``, the former where it loads.
    """

    planner: Literal["revnm", "bev"] = "revnm"
    bundle: Path | None = None
    provider: Provider = "cpu"
    threads: Annotated[int, pydantic.Field(ge=1, le=64)] = 2
    tick_hz: Annotated[float, pydantic.Field(gt=0.0, le=60.0)] = 10.0
    max_sighting_age_s: Annotated[float, pydantic.Field(gt=0.0, le=1.0)] = 1.0
    tag_library: Literal["auto", "apriltag", "opencv"] = "auto"
    tag_size_m: Annotated[float, pydantic.Field(gt=0.0, le=2.0)] = 0.30
    tag_height_m: Annotated[float, pydantic.Field(ge=0.0, le=3.0)] = 0.14
    robot_length_m: Annotated[float, pydantic.Field(gt=0.0, le=5.0)] = 0.43
    robot_width_m: Annotated[float, pydantic.Field(gt=0.0, le=5.0)] = 0.36
    calibration_dir: Path | None = None
