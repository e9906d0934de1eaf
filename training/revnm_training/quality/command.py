"""``revnm-train quality``: how good a bundle's imagined ego depth and its depth network are. Imports no torch."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from revnm_client.errors import ConfigError, FileError
from revnm_client.geometry import FloatArray
from revnm_server.networks.bundle import Bundle, default_bundle_path, load_bundle
from revnm_server.networks.checked_file import file_sha256
from revnm_server.networks.manifest import MANIFEST
from revnm_server.observation import Image32, ObservationSpec
from revnm_server.ports import EgoRequest
from revnm_server.stages.exo2ego import DIFFUSION_STEPS, OnnxExo2Ego
from revnm_sim.bench.report import table, write_report
from revnm_sim.worlds import is_generated, named_site
from revnm_training.quality.depth import measure_depth
from revnm_training.quality.encoder import ENCODER_PX, ENCODER_SHA256, DepthEncoder, encoder_path
from revnm_training.quality.metrics import (
    false_free,
    frechet_distance,
    kernel_distance,
    mean_ssim,
    psnr_db,
    sector_error_m,
)
from revnm_training.quality.sectors import metres, sector_distances
from revnm_training.quality.views import View, make_views

FORMAT = 1
_BATCH = 64  # the most robots that an exported denoiser is made for
_ONLY_IN_REPORT = ("seed", "bundle_sha256", "encoder_sha256")


@dataclass(frozen=True, slots=True)
class QualityConfig:
    """What to measure.

    Attributes:
        bundle: Folder of the bundle.
        worlds: Names or paths, see :func:`revnm_sim.worlds.named_site`.
        images: Images of a world.
        pictures: Pictures of a world for the depth network; 0 leaves it out.
        steps: DDIM steps; None takes the bundle's.
        seed: Of worlds, cameras and states.
        jobs: Processes that render, and threads of the network.
        out: Folder of ``report.json``; a run there is continued.
    """

    bundle: Path
    worlds: tuple[str, ...]
    images: int
    pictures: int
    steps: int | None
    seed: int
    jobs: int
    out: Path

    def command(self) -> str:
        """Return the command line that asks for this."""
        words = ["revnm-train", "quality", "--world", ",".join(self.worlds), "--images", str(self.images)]
        words += ["--pictures", str(self.pictures)]
        if self.bundle != default_bundle_path():
            words += ["--bundle", str(self.bundle)]
        if self.steps is not None:
            words += ["--steps", str(self.steps)]
        return shlex.join([*words, "--seed", str(self.seed), "--jobs", str(self.jobs), "--out", str(self.out)])


@dataclass(frozen=True, slots=True)
class Pictures:
    """True and imagined ego depth of the same views, (M, ego_px, ego_px) each, in [−1, 1]."""

    true: Image32
    imagined: Image32


def measure_quality(config: QualityConfig) -> list[dict[str, Any]]:
    """Measure every world, write ``report.json`` and print the table.

    Returns:
        The report's rows: for each world one of ``exo2ego`` and one of ``blank``, a picture of nothing, to read it
        against; then for each world one of ``depth``.

    Raises:
        ConfigError: An option is out of range, or the folder holds views of another run.
        FileError: Bundle, encoder, world file or kept views are malformed.
        ContractError: A world has no place for a camera.
    """
    _check(config)
    bundle = load_bundle(config.bundle, threads=config.jobs)
    if bundle.spec.ego_px != ENCODER_PX:
        raise ConfigError(f"{config.bundle}: ego_px {bundle.spec.ego_px}: the depth encoder sees {ENCODER_PX}")
    encoder = DepthEncoder(encoder_path(), threads=config.jobs)
    steps = config.steps or bundle.exo2ego.steps
    bundle = replace(bundle, exo2ego=replace(bundle.exo2ego, steps=steps))
    config.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for world in config.worlds:
        pictures = _pictures(config, bundle, world)
        common: dict[str, Any] = {"images": config.images, "steps": steps, "seed": config.seed}
        hashes = {"bundle_sha256": file_sha256(config.bundle / MANIFEST), "encoder_sha256": ENCODER_SHA256}
        for source, shown in (("exo2ego", pictures.imagined), ("blank", np.ones_like(pictures.true))):
            measured = measure(pictures.true, shown, bundle.spec, encoder)
            rows.append({"world": world, "source": source, **common, **measured, **hashes})
    depth = [_depth_row(config, world) for world in config.worlds] if config.pictures else []
    write_report(config.out / "report.json", rows + depth, config.command())
    for part in (rows, depth):
        if part:
            print(table([{key: value for key, value in row.items() if key not in _ONLY_IN_REPORT} for row in part]))
    return rows + depth


def _depth_row(config: QualityConfig, world: str) -> dict[str, Any]:
    errors = measure_depth(config.bundle, world, pictures=config.pictures, seed=config.seed, jobs=config.jobs)
    return {
        "world": world,
        "source": "depth",
        "pictures": config.pictures,
        "seed": config.seed,
        "abs_rel": round(errors.abs_rel, 4),
        "delta1": round(errors.delta1, 4),
        "bundle_sha256": file_sha256(config.bundle / MANIFEST),
    }


def measure(true: Image32, imagined: Image32, spec: ObservationSpec, encoder: DepthEncoder) -> dict[str, Any]:
    """Return every metric of imagined against true ego depth (M, 32, 32) in [−1, 1], rounded, by name with unit.

    See :mod:`revnm_training.quality.metrics` and :mod:`revnm_training.quality.sectors` for what they mean.
    """
    unit: tuple[FloatArray, ...] = tuple((ego.astype(np.float64) + 1.0) / 2.0 for ego in (true, imagined))
    features = (encoder.features(true), encoder.features(imagined))
    free_m: tuple[FloatArray, ...] = tuple(sector_distances(metres(ego, spec), spec) for ego in (true, imagined))
    per_image, pooled = psnr_db(unit[0], unit[1])
    overlooked, near = false_free(*free_m)
    return {
        "psnr_db": round(per_image, 2),
        "psnr_pooled_db": round(pooled, 2),
        "ssim": round(mean_ssim(unit[0], unit[1]), 4),
        "fdd": round(frechet_distance(*features), 3),
        "kid": round(kernel_distance(*features), 4),
        "sector_error_m": round(sector_error_m(*free_m), 3),
        "false_free_rate": None if overlooked is None else round(overlooked, 4),
        "near_sectors": near,
    }


def _check(config: QualityConfig) -> None:
    least = {
        "images": (config.images, 2),
        "pictures": (config.pictures, 0),
        "seed": (config.seed, 0),
        "jobs": (config.jobs, 1),
    }
    for name, (value, smallest) in least.items():
        if value < smallest:
            raise ConfigError(f"--{name} {value}: expected {smallest} or more")
    if config.steps is not None and not 1 <= config.steps <= DIFFUSION_STEPS:
        raise ConfigError(f"--steps {config.steps}: expected 1 to {DIFFUSION_STEPS}")
    labels = [_label(world) for world in config.worlds]
    if len(set(labels)) != len(labels):
        raise ConfigError(f"--world {','.join(config.worlds)}: two of them have the same name")
    for world in config.worlds:
        named_site(world, 0)


def _label(world: str) -> str:
    return Path(world).stem


def _pictures(config: QualityConfig, bundle: Bundle, world: str) -> Pictures:
    """Return the pictures of a world; kept in the folder, so an interrupted run goes on with the next world."""
    path, fingerprint = config.out / f"views_{_label(world)}.npz", _fingerprint(config, bundle, world)
    if path.exists():
        return _read_pictures(path, fingerprint)
    views = make_views(
        world, bundle.spec, count=config.images, seed=config.seed, jobs=config.jobs, prior=bundle.exo2ego.prior
    )
    pictures = Pictures(np.stack([view.ego for view in views]), _imagine(OnnxExo2Ego(bundle), views, world))
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    with partial.open("wb") as file:
        np.savez_compressed(file, fingerprint=fingerprint, true=pictures.true, imagined=pictures.imagined)
    partial.replace(path)
    return pictures


def _fingerprint(config: QualityConfig, bundle: Bundle, world: str) -> str:
    """Return what the pictures of a world depend on, hashed."""
    content = {
        "format": FORMAT,
        "bundle": file_sha256(config.bundle / MANIFEST),
        "steps": bundle.exo2ego.steps,
        "world": world if is_generated(world) else named_site(world, 0).file_sha256,
        "images": config.images,
        "seed": config.seed,
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _read_pictures(path: Path, fingerprint: str) -> Pictures:
    try:
        with np.load(path, allow_pickle=False) as kept:
            found, pictures = str(kept["fingerprint"]), Pictures(kept["true"], kept["imagined"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise FileError(f"{path}: no readable views: {error}; remove it to make them again") from error
    if found != fingerprint:
        raise ConfigError(f"{path}: of another bundle, world, seed, steps or number: name another folder or remove it")
    return pictures


def _imagine(exo2ego: OnnxExo2Ego, views: Sequence[View], world: str) -> Image32:
    """Return the ego depth (M, ego_px, ego_px) that the server would imagine."""
    parts = []
    with tqdm(total=len(views), desc=f"imagine {world}", unit=" views") as bar:
        for start in range(0, len(views), _BATCH):
            batch = views[start : start + _BATCH]
            parts.append(exo2ego.synthesise([EgoRequest("", 0, view.pose, view.crops, view.prior) for view in batch]))
            bar.update(len(batch))
    return np.concatenate(parts)
