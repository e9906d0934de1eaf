"""World files: one YAML format for every world, described in ``docs/world-format.md``.

A file is hostile until it has been checked: aliases, duplicate and unknown keys, and numbers out of range are
refused, with the file, the line and the key in the message.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from revnm_client.errors import FileError
from revnm_client.geometry import Pose2
from revnm_sim.world import Bounds, Primitive, Shape, World

_MOST_BYTES = 4_000_000
_MOST_PRIMITIVES = 10_000
_DEEPEST = 10

Coordinate = Annotated[float, Field(strict=True, ge=-1000.0, le=1000.0, allow_inf_nan=False)]
Extent = Annotated[float, Field(strict=True, gt=0.0, le=1000.0, allow_inf_nan=False)]
Angle = Annotated[float, Field(strict=True, ge=-360.0, le=360.0, allow_inf_nan=False)]
Channel = Annotated[int, Field(strict=True, ge=0, le=255)]
Colour = tuple[Channel, Channel, Channel]
Name = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9_-]{1,64}$")]

Key = str | int
Place = tuple[Key, ...]


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


class _File(_Strict):
    format: Literal[1]
    name: Name
    bounds: _Bounds
    floor: _Floor
    prefabs: dict[Name, list[Annotated[_Box | _Cylinder, Field(discriminator="shape")]]]
    placements: list[_Placement]


class _Document:
    """The plain data of a YAML file, and on which line each part of it stands."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines: dict[Place, int] = {(): 1}
        self._scalars = yaml.SafeLoader("")
        try:
            if path.stat().st_size > _MOST_BYTES:
                raise FileError(f"{path}: larger than {_MOST_BYTES} bytes")
            text = path.read_text(encoding="utf-8")
            self._refuse_bombs(text)
            node = yaml.compose(text, Loader=yaml.SafeLoader)
            self.data = self._plain(node, ())
        except OSError as error:
            raise FileError(f"{path}: cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise FileError(f"{path}: is no UTF-8 text") from error
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else 1
            raise FileError(f"{path}:{line}: is no YAML: {error.problem}") from error
        except (yaml.YAMLError, ValueError) as error:
            raise FileError(f"{path}: is no YAML: {error}") from error

    def refuse(self, place: Place, problem: str) -> NoReturn:
        """Raise a FileError that names the file, the line and the key."""
        known = place
        while known not in self.lines:
            known = known[:-1]
        raise FileError(f"{self.path}:{self.lines[known]}: {_dotted(place)}: {problem}")

    def _refuse_bombs(self, text: str) -> None:
        """Refuse what makes a small file huge or slow to read: aliases, and lists in lists in lists."""
        depth = 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            line = event.start_mark.line + 1 if event.start_mark else 1
            if isinstance(event, yaml.AliasEvent):
                raise FileError(f"{self.path}:{line}: *{event.anchor}: expected the value itself, not an alias")
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST:
                raise FileError(f"{self.path}:{line}: expected at most {_DEEPEST} levels of nesting")

    def _plain(self, node: yaml.Node | None, place: Place) -> Any:
        if node is None:
            return None
        self.lines[place] = node.start_mark.line + 1
        if isinstance(node, yaml.SequenceNode):
            return [self._plain(child, (*place, i)) for i, child in enumerate(node.value)]
        if not isinstance(node, yaml.MappingNode):
            return self._scalars.construct_object(node)
        mapping: dict[str, Any] = {}
        for key, value in node.value:
            inner = (*place, str(key.value))
            self.lines[inner] = key.start_mark.line + 1
            if str(key.value) in mapping:
                self.refuse(inner, "stands here a second time: expected every key once")
            mapping[str(key.value)] = self._plain(value, inner)
            self.lines[inner] = key.start_mark.line + 1
        return mapping


def load_world(path: Path) -> World:
    """Read a world file.

    Args:
        path: The YAML file.

    Raises:
        FileError: It cannot be read, or breaks the format; the text names file, line, key and what was expected.
    """
    document = _Document(path)
    try:
        content = _File.model_validate(document.data)
    except ValidationError as error:
        _explain(document, error)
    bounds = Bounds(*(getattr(content.bounds, name) for name in Bounds._fields))
    if bounds.x_min_m >= bounds.x_max_m or bounds.y_min_m >= bounds.y_max_m:
        document.refuse(("bounds",), f"expected x_min_m < x_max_m and y_min_m < y_max_m, got {tuple(bounds)}")
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
    return World(content.name, bounds, content.floor.colour, tuple(primitives))


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


def _explain(document: _Document, error: ValidationError) -> NoReturn:
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


def _dotted(place: Place) -> str:
    """Write a place as ``placements[2].prefab``."""
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in place)
    return text.lstrip(".") or "the file"
