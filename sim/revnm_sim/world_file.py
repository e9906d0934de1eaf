"""World files: one YAML format for every world, described in ``docs/world-format.md``.

A file is hostile until it has been checked: what is malformed, unknown or out of range is refused, and so are cameras
and pairs that no trial could run with, with the file, the line and the key in the message.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from revnm_client.errors import FileError
from revnm_client.geometry import Pose2
from revnm_server.yaml_document import YamlDocument
from revnm_sim.camera import Camera
from revnm_sim.site import DETOUR_M, GOAL_RADIUS_M, Pair, Site
from revnm_sim.site_checks import flaws
from revnm_sim.world import Bounds, Primitive, Shape, World

_MOST_PRIMITIVES = 10_000
_MOST_TRIAL_PARTS = 1000  # cameras, and pairs

Coordinate = Annotated[float, Field(strict=True, ge=-1000.0, le=1000.0, allow_inf_nan=False)]
Extent = Annotated[float, Field(strict=True, gt=0.0, le=1000.0, allow_inf_nan=False)]
Angle = Annotated[float, Field(strict=True, ge=-360.0, le=360.0, allow_inf_nan=False)]
Channel = Annotated[int, Field(strict=True, ge=0, le=255)]
Colour = tuple[Channel, Channel, Channel]
Name = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9_-]{1,64}$")]

Pixels = Annotated[int, Field(strict=True, ge=16, le=8192)]
_LARGEST_M2 = 10_000.0  # grids of 0.05 m of such a floor fit into memory


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Bounds(_Strict):
    x_min_m: Coordinate
    y_min_m: Coordinate
    x_max_m: Coordinate
    y_max_m: Coordinate


class _Floor(_Strict):
    colour: Colour


class _Box(_Strict):
    shape: Literal["box"]
    centre_m: tuple[Coordinate, Coordinate, Coordinate]
    size_m: tuple[Extent, Extent, Extent]
    yaw_deg: Angle = 0.0
    colour: Colour


class _Cylinder(_Strict):
    shape: Literal["cylinder"]
    centre_m: tuple[Coordinate, Coordinate, Coordinate]
    diameter_m: Extent
    height_m: Extent
    colour: Colour


class _Placement(_Strict):
    prefab: Name
    x_m: Coordinate
    y_m: Coordinate
    yaw_deg: Angle = 0.0


class _Camera(_Strict):
    x_m: Coordinate
    y_m: Coordinate
    z_m: Coordinate
    yaw_deg: Angle
    pitch_deg: Annotated[float, Field(strict=True, ge=-90.0, le=90.0, allow_inf_nan=False)]
    roll_deg: Angle = 0.0
    width_px: Pixels = 640
    height_px: Pixels = 480
    hfov_deg: Annotated[float, Field(strict=True, ge=1.0, le=170.0, allow_inf_nan=False)] = 120.0

    def placed(self) -> Camera:
        yaw, pitch, roll, hfov = (math.radians(a) for a in (self.yaw_deg, self.pitch_deg, self.roll_deg, self.hfov_deg))
        return Camera(self.width_px, self.height_px, hfov, (self.x_m, self.y_m, self.z_m), yaw, pitch, roll)


class _Start(_Strict):
    x_m: Coordinate
    y_m: Coordinate
    yaw_deg: Angle


class _Goal(_Strict):
    x_m: Coordinate
    y_m: Coordinate


class _Pair(_Strict):
    start: _Start
    goal: _Goal

    def placed(self) -> Pair:
        start = Pose2(self.start.x_m, self.start.y_m, math.radians(self.start.yaw_deg))
        return Pair(start, (self.goal.x_m, self.goal.y_m))


class _File(_Strict):
    format: Literal[1]
    name: Name
    goal_radius_m: Extent = GOAL_RADIUS_M
    detour_m: Extent = DETOUR_M
    bounds: _Bounds
    floor: _Floor
    prefabs: dict[Name, list[Annotated[_Box | _Cylinder, Field(discriminator="shape")]]]
    placements: list[_Placement]
    cameras: Annotated[list[_Camera], Field(max_length=_MOST_TRIAL_PARTS)] = []
    pairs: Annotated[list[_Pair], Field(max_length=_MOST_TRIAL_PARTS)] = []


def load_site(path: Path) -> Site:
    """Read a world file.

    Args:
        path: The YAML file.

    Raises:
        FileError: It cannot be read, breaks the format, or a camera or pair does not fit into the world; the text
            names file, line, key and what was expected.
    """
    document = YamlDocument(path)
    try:
        content = _File.model_validate(document.data)
    except ValidationError as error:
        _explain(document, error)
    bounds = Bounds(*(getattr(content.bounds, name) for name in Bounds._fields))
    if bounds.x_min_m >= bounds.x_max_m or bounds.y_min_m >= bounds.y_max_m:
        document.refuse(("bounds",), f"expected x_min_m < x_max_m and y_min_m < y_max_m, got {tuple(bounds)}")
    area = (bounds.x_max_m - bounds.x_min_m) * (bounds.y_max_m - bounds.y_min_m)
    if area > _LARGEST_M2:
        document.refuse(("bounds",), f"expected at most {_LARGEST_M2:g} m², got {area:g} m²")
    site = Site(
        world=World(content.name, bounds, content.floor.colour, _placed_primitives(document, content)),
        where=document.where(("bounds",)),
        goal_radius_m=content.goal_radius_m,
        detour_m=content.detour_m,
        cameras=tuple(camera.placed() for camera in content.cameras),
        pairs=tuple(pair.placed() for pair in content.pairs),
        file_sha256=document.sha256,
    )
    for place, problem in flaws(site):
        document.refuse(place, problem)
    return site


def save_world(world: World, path: Path) -> None:
    """Write a world file; reading it gives the same world, angles to within rounding.

    Raises:
        FileError: The file cannot be written.
    """
    parts = [_part_data(primitive) for primitive in world.primitives]
    data = {
        "format": 1,
        "name": world.name,
        "bounds": world.bounds._asdict(),
        "floor": {"colour": list(world.floor_colour)},
        "prefabs": {"everything": parts},
        "placements": [{"prefab": "everything", "x_m": 0.0, "y_m": 0.0}],
    }
    try:
        path.write_text(yaml.safe_dump(data, sort_keys=False, default_flow_style=None), encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def _placed_primitives(document: YamlDocument, content: _File) -> tuple[Primitive, ...]:
    """Return the parts of all placed prefabs."""
    primitives: list[Primitive] = []
    for i, placement in enumerate(content.placements):
        if placement.prefab not in content.prefabs:
            known = ", ".join(sorted(content.prefabs)) or "none"
            problem = f"expected one of the file's prefabs ({known}), got {placement.prefab!r}"
            document.refuse(("placements", i, "prefab"), problem)
        frame = Pose2(placement.x_m, placement.y_m, math.radians(placement.yaw_deg))
        primitives += [_placed(part, frame) for part in content.prefabs[placement.prefab]]
        if len(primitives) > _MOST_PRIMITIVES:
            document.refuse(("placements", i), f"expected at most {_MOST_PRIMITIVES} boxes and cylinders in all")
    return tuple(primitives)


def _part_data(primitive: Primitive) -> dict[str, Any]:
    shared = {"centre_m": list(primitive.centre_m), "colour": list(primitive.colour)}
    if primitive.shape is Shape.CYLINDER:
        diameter, _, height = primitive.size_m
        return {"shape": "cylinder", **shared, "diameter_m": diameter, "height_m": height}
    yaw = math.degrees(primitive.yaw_rad)
    return {"shape": "box", **shared, "size_m": list(primitive.size_m), "yaw_deg": yaw}


def _placed(part: _Box | _Cylinder, frame: Pose2) -> Primitive:
    """Return a prefab's part in the world."""
    x, y, z = part.centre_m
    if isinstance(part, _Box):
        pose = frame @ Pose2(x, y, math.radians(part.yaw_deg))
        return Primitive(Shape.BOX, (pose.x_m, pose.y_m, z), part.size_m, pose.yaw_rad, part.colour)
    pose = frame @ Pose2(x, y, 0.0)
    size = (part.diameter_m, part.diameter_m, part.height_m)
    return Primitive(Shape.CYLINDER, (pose.x_m, pose.y_m, z), size, pose.yaw_rad, part.colour)


def _explain(document: YamlDocument, error: ValidationError) -> NoReturn:
    """Raise the first problem that pydantic found, in the words of the file."""
    first = error.errors(include_url=False, include_context=False)[0]
    # Where a box or a cylinder may stand, pydantic puts the chosen shape into the place; the file has no such key.
    place = tuple(key for i, key in enumerate(first["loc"]) if not (i == 3 and key in ("box", "cylinder")))
    if first["type"] == "extra_forbidden":
        document.refuse(place, "is no key of the format here")
    if first["type"] == "missing":
        document.refuse(place, "is missing")
    if first["type"] in ("model_type", "model_attributes_type"):
        document.refuse(place, f"expected keys with values, got {first['input']!r:.80}")
    document.refuse(place, f"{first['msg'][0].lower()}{first['msg'][1:]}, got {first['input']!r:.80}")
