"""How good a bundle's depth network is: on pictures with random textures, light and noise, in worlds it has not seen.

Cameras and seeds are those of :mod:`revnm_training.quality.views`: the benchmark's, evaluation seeds only.
"""

from __future__ import annotations

import functools
from pathlib import Path

import joblib
import numpy as np
from tqdm import tqdm

from revnm_client.errors import ContractError
from revnm_server.frame import Frame
from revnm_server.networks.bundle import load_depth_bundle
from revnm_server.stages.depth import OnnxDepth
from revnm_sim.generation.placement import sample_camera
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth
from revnm_sim.shade import shade
from revnm_sim.world import primitive_arrays
from revnm_sim.worlds import named_site
from revnm_training.depth_metrics import DepthErrors, depth_errors
from revnm_training.quality.views import HFOV_RAD, SIZE_PX, evaluation_seed

_ATTEMPTS = 50
_PART = 3  # of the seed sequence: views take (seed, block, attempt)


def measure_depth(bundle: Path, world: str, *, pictures: int, seed: int, jobs: int) -> DepthErrors:
    """Return the mean errors of a bundle's depth network over pictures of a world.

    Args:
        bundle: Folder of the bundle.
        world: Name or path, see :func:`revnm_sim.worlds.named_site`; a family gives another world each picture.
        pictures: How many.
        seed: Of everything random.
        jobs: Processes.

    Raises:
        ContractError: The world has no place for a camera.
    """
    tasks = (joblib.delayed(_errors)(bundle, world, seed, number) for number in range(pictures))
    running = joblib.Parallel(n_jobs=jobs, return_as="generator")(tasks)
    found = list(tqdm(running, total=pictures, desc=f"depth {world}", unit=" pictures"))
    return DepthErrors(*np.mean(found, axis=0))


def _errors(bundle: Path, world: str, seed: int, number: int) -> DepthErrors:
    for attempt in range(_ATTEMPTS):
        sequence = np.random.SeedSequence([seed, _PART, number, attempt])
        site, rng = named_site(world, evaluation_seed(sequence)), np.random.default_rng(sequence)
        width, height = SIZE_PX
        try:
            camera = sample_camera(site.world, rng, width_px=width, height_px=height, hfov_rad=HFOV_RAD)
        except ContractError:
            continue
        network, grid_hw = _network(bundle)
        picture = shade(site.world, camera, (grid_hw[1], grid_hw[0]), rng)
        true = disparity_from_depth(cast_depth(primitive_arrays(site.world.primitives), camera, grid_hw))
        return depth_errors(network.disparity(Frame(picture, 0, 0)), true)
    raise ContractError(f"world {world!r}: no place for a camera in {_ATTEMPTS} draws")


@functools.cache
def _network(bundle: Path) -> tuple[OnnxDepth, tuple[int, int]]:
    """Return a bundle's depth network and the size of what it sees; loaded once a process."""
    loaded = load_depth_bundle(bundle, threads=1)
    return OnnxDepth(loaded), loaded.spec.disparity_hw
