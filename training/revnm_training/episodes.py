"""Episodes: what a data set is made of, compact enough to keep and to hand around.

An episode names its world by family and seed and its camera by numbers; pictures are rendered from them when they
are read. Files are Arrow parquet, one row an episode, so that other tools can read them; the expert's waypoints are
stored, because asking the expert again costs more than rendering. Places are kept to the millimetre and angles to
10⁻⁴ rad, as steps from one to the next: so an episode takes less than a kilobyte. Imports neither torch nor PyBullet.

Symbols: G goals, S states, N frames of history, H waypoints.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from revnm_client.errors import ContractError, FileError
from revnm_client.geometry import FloatArray
from revnm_server.observation import ObservationSpec
from revnm_sim.camera import Camera

FORMAT = 2
_METADATA_KEY = b"revnm_episodes"
_MILLI, _YAW_UNIT = 1e-3, 1e-4  # metres, radians
_POSE_UNITS = np.array([_MILLI, _MILLI, _YAW_UNIT])
_FARTHEST = 32_767  # of an int16: worlds reach 32 m from their origin
_CAMERA_FIELDS = tuple(field.name for field in fields(Camera) if field.name != "position_m")


class StateKind(IntEnum):
    """How a state was chosen: the first three by :mod:`states`, NEAR and the rest, from drives, by :mod:`visited`."""

    EXPERT = 0
    RANDOM = 1
    NEAR = 2
    STUCK = 3
    ASTRAY = 4
    VISITED = 5


@dataclass(frozen=True, slots=True)
class EpisodeLayout:
    """The lengths that all episodes of a file share.

    Attributes:
        history: N, robot poses a state: the present one and N − 1 earlier ones.
        history_interval_s: Time between two of them.
        waypoints: H, waypoints of a label.
        spacing_m: Path length between two waypoints.
    """

    history: int
    history_interval_s: float
    waypoints: int
    spacing_m: float


@dataclass(frozen=True, slots=True)
class Episode:
    """One world seen by one camera, with goals and labelled robot states.

    Attributes:
        family: Name of the world's generator.
        world_seed: Its seed.
        camera: The remote camera.
        goals_m: (G, 2) float64, world frame, metres.
        goal: (S,) uint8, which goal a state is labelled for.
        kind: (S,) uint8, a :class:`StateKind`.
        poses: (S, N, 3) float64, x, y (metres) and yaw (radians) of the robot, world frame, the newest last.
        waypoints_m: (S, H, 2) float32, the expert's way from the newest pose, robot frame, metres.
    """

    family: str
    world_seed: int
    camera: Camera
    goals_m: FloatArray
    goal: NDArray[np.uint8]
    kind: NDArray[np.uint8]
    poses: FloatArray
    waypoints_m: NDArray[np.float32]


def layout_of(spec: ObservationSpec) -> EpisodeLayout:
    """Return the layout that an observation needs."""
    return EpisodeLayout(spec.history, spec.history_interval_s, spec.waypoints, spec.spacing_m)


def _schema(layout: EpisodeLayout) -> Any:
    camera = [(name, pa.int32() if name.endswith("_px") else pa.float64()) for name in _CAMERA_FIELDS]
    metadata = json.dumps({"format": FORMAT, **asdict(layout)})
    return pa.schema(
        [
            ("family", pa.string()),
            ("world_seed", pa.int64()),
            ("camera", pa.struct([*camera, ("position_m", pa.list_(pa.float64(), 3))])),
            ("goals_m", pa.list_(pa.float64())),
            ("goal", pa.list_(pa.uint8())),
            ("kind", pa.list_(pa.uint8())),
            ("poses", pa.list_(pa.int16())),
            ("waypoints", pa.list_(pa.int16())),
        ],
        metadata={_METADATA_KEY: metadata.encode()},
    )


def write_episodes(path: Path, episodes: Iterable[Episode], layout: EpisodeLayout) -> None:
    """Write a file of episodes; it appears whole or not at all."""
    rows = [_to_row(episode) for episode in episodes]
    table = pa.Table.from_pylist(rows, schema=_schema(layout))
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    steps = {f"{name}.list.element": "DELTA_BINARY_PACKED" for name in ("goal", "kind", "poses", "waypoints")}
    pq.write_table(table, partial, compression="zstd", compression_level=9, use_dictionary=False, column_encoding=steps)
    partial.replace(path)


def _to_row(episode: Episode) -> dict[str, Any]:
    """Return the row of an episode.

    Raises:
        ContractError: A place is more than 32 m from the world's origin.
    """
    camera: dict[str, Any] = {name: getattr(episode.camera, name) for name in _CAMERA_FIELDS}
    return {
        "family": episode.family,
        "world_seed": episode.world_seed,
        "camera": camera | {"position_m": list(episode.camera.position_m)},
        "goals_m": episode.goals_m.ravel(),
        "goal": episode.goal,
        "kind": episode.kind,
        "poses": _steps(_unwrapped(episode.poses[:, ::-1]), _POSE_UNITS),
        "waypoints": _steps(episode.waypoints_m, np.array(_MILLI)),
    }


def _unwrapped(poses: FloatArray) -> FloatArray:
    """Return poses (S, K, 3) whose yaw begins within ± π and goes on without jumps."""
    yaw = np.unwrap(poses[..., 2], axis=1)
    turns = math.tau * np.rint(yaw[:, :1] / math.tau)
    return np.concatenate([poses[..., :2], (yaw - turns)[..., None]], axis=-1)


def _steps(values: FloatArray | NDArray[np.float32], units: FloatArray) -> NDArray[np.int16]:
    """Return arrays (S, K, D) as the first of the K and the steps that follow, number by number: D · K · S integers."""
    whole = np.rint(values / units).astype(np.int64)
    steps = np.diff(whole, axis=1, prepend=0)
    if np.abs(steps).max(initial=0) > _FARTHEST:
        raise ContractError(f"an episode's place is {_MILLI * np.abs(whole).max():.1f} m from its origin: too far")
    return np.ascontiguousarray(steps.transpose(2, 1, 0)).ravel().astype(np.int16)


def _unstep(steps: NDArray[np.int16], units: FloatArray) -> FloatArray:
    """Return the inverse of :func:`_steps` for steps (D, K, S): (S, K, D)."""
    return np.asarray(np.cumsum(steps.transpose(2, 1, 0).astype(np.int64), axis=1) * units)


def read_episodes(path: Path) -> tuple[EpisodeLayout, list[Episode]]:
    """Read a file of episodes and check it.

    Raises:
        FileError: The file is missing, truncated, of another format or version, or its numbers are absurd; the text
            names the file and, where there is one, the row.
    """
    layout = read_layout(path)
    try:
        rows = pq.read_table(path).to_pylist()
    except (OSError, pa.ArrowException) as error:
        raise FileError(f"{path}: damaged or truncated: {error}") from error
    return layout, [_from_row(row, layout, f"{path}: row {number}") for number, row in enumerate(rows)]


def read_layout(path: Path) -> EpisodeLayout:
    """Read the layout of a file of episodes without its rows.

    Raises:
        FileError: As :func:`read_episodes`.
    """
    try:
        schema = pq.read_schema(path)
    except (OSError, pa.ArrowException) as error:
        raise FileError(f"{path}: no readable parquet file, perhaps truncated: {error}") from error
    try:
        stored = json.loads((schema.metadata or {}).get(_METADATA_KEY, b"{}"))
        version = stored.pop("format", None)
        if version != FORMAT:
            raise FileError(f"{path}: episodes of format {FORMAT} expected, got {version}")
        layout = EpisodeLayout(**stored)
    except (ValueError, TypeError, AttributeError) as error:
        raise FileError(f"{path}: metadata {_METADATA_KEY.decode()} is malformed: {error}") from error
    if not schema.equals(_schema(layout)):
        raise FileError(f"{path}: columns {schema.names} are not those of episodes of format {FORMAT}")
    return layout


def _from_row(row: dict[str, Any], layout: EpisodeLayout, where: str) -> Episode:
    for name, value in row.items():
        if value is None:
            raise FileError(f"{where}: {name}: missing")
    camera = _camera(row["camera"], where)
    goals = _shaped(row["goals_m"], np.float64, (-1, 2), f"{where}: goals_m")
    count = len(row["goal"])
    goal = _shaped(row["goal"], np.uint8, (count,), f"{where}: goal")
    if not count:
        raise FileError(f"{where}: goal: an episode without states")
    if int(goal.max()) >= len(goals):
        raise FileError(f"{where}: goal: {int(goal.max())} of only {len(goals)} goals")
    poses = _shaped(row["poses"], np.int16, (3, layout.history, count), f"{where}: poses")
    waypoints = _shaped(row["waypoints"], np.int16, (2, layout.waypoints, count), f"{where}: waypoints")
    return Episode(
        family=row["family"],
        world_seed=row["world_seed"],
        camera=camera,
        goals_m=goals,
        goal=goal,
        kind=_shaped(row["kind"], np.uint8, (count,), f"{where}: kind"),
        poses=_unstep(poses, _POSE_UNITS)[:, ::-1],
        waypoints_m=_unstep(waypoints, np.array(_MILLI)).astype(np.float32),
    )


def _camera(stored: dict[str, Any], where: str) -> Camera:
    position = stored.pop("position_m")
    numbers = [*stored.values(), *(position or [None])]
    if any(number is None or not math.isfinite(number) for number in numbers):
        raise FileError(f"{where}: camera: finite numbers expected, got {stored}, {position}")
    if stored["width_px"] < 1 or stored["height_px"] < 1 or not 0.0 < stored["hfov_rad"] < math.pi:
        raise FileError(f"{where}: camera: impossible size or field of view: {stored}")
    return Camera(**stored, position_m=tuple(position))


def _shaped(values: Sequence[float], dtype: Any, shape: tuple[int, ...], where: str) -> NDArray[Any]:
    array = np.array(values, dtype=dtype)
    try:
        array = array.reshape(shape)
    except ValueError as error:
        raise FileError(f"{where}: {array.size} numbers do not fill {shape}") from error
    if not np.isfinite(array).all():
        raise FileError(f"{where}: a number is not finite")
    return array
