"""``revnm-sim raycast``: exact depth images a second, of the ray caster and of PyBullet's renderer."""

from __future__ import annotations

import argparse
import math
import re
import shlex
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
from numba import cuda
from tqdm import tqdm

from revnm_client.errors import ConfigError, ContractError
from revnm_sim.bench.report import table, write_report
from revnm_sim.camera import Camera
from revnm_sim.generation.placement import sample_camera
from revnm_sim.rays.cuda_raycast import cast_depths_cuda
from revnm_sim.rays.raycast import cast_depth
from revnm_sim.scene import add_floor, add_obstacle
from revnm_sim.software_renderer import Region, render
from revnm_sim.world import World, primitive_arrays
from revnm_sim.worlds import WORLDS, named_site

_HFOV_RAD = math.radians(120.0)
_ATTEMPTS = 20
_WARM_UP = 2
_BATCH = 256  # images that a graphics card gets at a time


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument(
        "--world",
        default="random_pillar,rooms",
        help=f"comma-separated, of: {', '.join(WORLDS)}, or paths of world files (default: %(default)s)",
    )
    parser.add_argument("--size", default="256x192", help="WIDTHxHEIGHT of the images (default: %(default)s)")
    parser.add_argument("--images", type=int, default=40, help="images of each world (default: 40)")
    parser.add_argument("--seed", type=int, default=6000, help="of worlds and cameras (default: 6000)")
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json")


def run(args: argparse.Namespace) -> int:
    """Measure, write the report and print the table."""
    size = _size(args.size)
    if args.images < 1 or args.seed < 0:
        raise ConfigError(f"--images {args.images} --seed {args.seed}: expected at least 1 and 0")
    args.out.mkdir(parents=True, exist_ok=True)
    rows = [row for world in dict.fromkeys(args.world.split(",")) for row in _rows(world, size, args)]
    options = ["--world", args.world, "--size", args.size, "--images", str(args.images), "--seed", str(args.seed)]
    write_report(args.out / "report.json", rows, shlex.join(["revnm-sim", "raycast", *options]))
    print(table(rows))
    return 0


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"([1-9]\d{0,3})x([1-9]\d{0,3})", text)
    if found is None:
        raise ConfigError(f"--size {text}: expected WIDTHxHEIGHT, such as 256x192")
    return int(found[1]), int(found[2])


def _rows(name: str, size: tuple[int, int], args: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row of each renderer; they take turns, image by image."""
    rng = np.random.default_rng(args.seed)
    world = named_site(name, args.seed).world
    cameras = [_camera(name, world, size, rng) for _ in range(args.images)]
    arrays, hw = primitive_arrays(world.primitives), size[::-1]
    client = _client(world)
    whole = Region(0, 0, *size)
    renderers: dict[str, Callable[[Camera], object]] = {
        "raycast": lambda camera: cast_depth(arrays, camera, hw),
        "pybullet": lambda camera: render(client, camera, whole, 1).depth,
    }
    times: dict[str, list[float]] = {renderer: [] for renderer in renderers}
    for number, camera in enumerate(tqdm([*cameras[:_WARM_UP], *cameras], desc=name, unit=" images")):
        for renderer, draw in renderers.items():
            elapsed_ms = _elapsed_ms(draw, camera)
            if number >= _WARM_UP:
                times[renderer].append(elapsed_ms)
    pybullet.disconnect(physicsClientId=client)
    if cuda.is_available():
        times["raycast_cuda"] = _cuda_ms(lambda batch: cast_depths_cuda(arrays, batch, hw), cameras)
    slow = float(np.mean(times["pybullet"]))
    return [_row(name, size, renderer, found, slow) for renderer, found in times.items()]


def _row(world: str, size: tuple[int, int], renderer: str, times_ms: Sequence[float], slow_ms: float) -> dict[str, Any]:
    p50, p95 = np.percentile(times_ms, (50.0, 95.0))
    mean = float(np.mean(times_ms))
    return {
        "world": world,
        "width_px": size[0],
        "height_px": size[1],
        "renderer": renderer,
        "images": len(times_ms),
        "images_per_s": round(1e3 / mean, 1),
        "p50_ms": round(float(p50), 3),
        "p95_ms": round(float(p95), 3),
        "times_pybullet": round(slow_ms / mean, 1),
    }


def _camera(name: str, world: World, size: tuple[int, int], rng: np.random.Generator) -> Camera:
    for _ in range(_ATTEMPTS):
        try:
            return sample_camera(world, rng, width_px=size[0], height_px=size[1], hfov_rad=_HFOV_RAD)
        except ContractError:
            continue
    raise ContractError(f"world {name!r}: no place for a camera in {_ATTEMPTS} draws")


def _client(world: World) -> int:
    client: int = pybullet.connect(pybullet.DIRECT)
    add_floor(client, world)
    for primitive in world.primitives:
        add_obstacle(client, primitive)
    return client


def _elapsed_ms(draw: Callable[[Camera], object], camera: Camera) -> float:
    started = time.perf_counter()
    draw(camera)
    return (time.perf_counter() - started) * 1e3


def _cuda_ms(draw: Callable[[list[Camera]], object], cameras: list[Camera]) -> list[float]:
    """Return the time per image of batches, one number a batch; the first, which compiles, is left out."""
    batch = (cameras * _BATCH)[:_BATCH]
    draw(batch)
    times = []
    for _ in cameras:
        started = time.perf_counter()
        draw(batch)
        times.append((time.perf_counter() - started) * 1e3 / _BATCH)
    return times
