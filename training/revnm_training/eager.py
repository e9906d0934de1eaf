"""A bundle's networks in PyTorch eager, as a reader of the paper would run them: what the server is compared with.

One robot after the other, the whole history encoded anew for each. The weights are random: speed does not depend on
them. ``revnm-server bench`` finds this by its entry point.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from torch import Tensor

from revnm_client.errors import FileError
from revnm_client.geometry import FloatArray
from revnm_server.frame import Frame
from revnm_server.networks.bundle import Bundle
from revnm_server.networks.manifest import MANIFEST
from revnm_server.observation import Image32
from revnm_server.ports import BeliefRequest, EgoRequest, PlanRequest
from revnm_server.speed.baseline import Networks
from revnm_server.stages.exo2ego import ddim_sample, ddim_schedule, start_image
from revnm_training.networks.depth_net import DepthNet
from revnm_training.networks.dit import Denoiser
from revnm_training.networks.map_policy import MapPolicy
from revnm_training.preset import Preset, preset_from
from revnm_training.train_policy import policy_network


def eager_networks(bundle: Bundle) -> Networks:
    """Build the networks of a bundle by the preset that its manifest tells.

    Raises:
        FileError: The manifest does not say how the networks are built.
    """
    where = str(bundle.folder / MANIFEST)
    preset = preset_from(bundle.manifest["recipe"].get("preset"), f"{where}: recipe.preset")
    network = policy_network(preset).eval()
    policy = EagerFloorPolicy(network) if isinstance(network, MapPolicy) else EagerPolicy(network)
    note = f"PyTorch {torch.__version__} eager, {torch.get_num_threads()} threads"
    return Networks(note, EagerDepth(preset, where), EagerExo2Ego(preset), policy)


class EagerDepth:
    """See :class:`revnm_server.stages.depth.OnnxDepth`."""

    def __init__(self, preset: Preset, where: str) -> None:
        """Build the network."""
        if preset.depth is None:
            raise FileError(f"{where}: recipe.preset.depth: null, so that nobody knows what depth network it is")
        self._network, self._hw = DepthNet(preset.depth).eval(), preset.observation.disparity_hw
        self._mean, self._std = torch.tensor(preset.depth.mean), torch.tensor(preset.depth.std)

    @torch.inference_mode()
    def disparity(self, frame: Frame) -> Image32:
        """Return the disparity (h, w)."""
        small = cv2.resize(frame.image, self._hw[::-1], interpolation=cv2.INTER_AREA)
        image = (torch.from_numpy(small).float() / 255.0 - self._mean) / self._std
        return np.asarray(self._network(image.permute(2, 0, 1)[None])[0].numpy())


class EagerExo2Ego:
    """See :class:`revnm_server.stages.exo2ego.OnnxExo2Ego`."""

    def __init__(self, preset: Preset) -> None:
        """Build the denoiser."""
        self._network = Denoiser(preset.exo2ego, preset.observation).eval()
        self._schedule = ddim_schedule(preset.exo2ego.steps)
        self._start = start_image(preset.observation.ego_px, noise=preset.exo2ego.noise)[None, None]

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        """Return ego depth (R, ego_px, ego_px), one robot after the other."""
        return np.concatenate([self._sample(request) for request in requests])

    @torch.inference_mode()
    def _sample(self, request: EgoRequest) -> Image32:
        crop, robot, heading = (_batch(each) for each in (request.crops, request.pose.p_rob, request.pose.q_rel))
        prior = None if request.prior is None else _batch(request.prior)

        def denoise(noisy: Image32, step: int) -> Image32:
            clean = self._network(torch.from_numpy(noisy), crop, torch.tensor([step]), robot, heading, prior)
            return np.asarray(clean.numpy())

        return ddim_sample(denoise, self._start, self._schedule)[:, 0]


class EagerPolicy:
    """See :class:`revnm_server.stages.policy.OnnxPolicy`."""

    def __init__(self, network: torch.nn.Module) -> None:
        """Take the network."""
        self._network = network

    @torch.inference_mode()
    def waypoints(self, requests: Sequence[PlanRequest]) -> FloatArray:
        """Return (R, H, 2), one robot after the other."""
        return np.concatenate(
            [
                self._network(
                    _batch(each.exo[:, None]),
                    _batch(each.ego[:, None]),
                    _batch(each.pose.p_rob),
                    _batch(each.pose.q_rel),
                    _batch(each.goal),
                ).waypoints.numpy()
                for each in requests
            ]
        ).astype(np.float64)


class EagerFloorPolicy:
    """See :class:`revnm_server.stages.policy.OnnxFloorPolicy`."""

    def __init__(self, network: MapPolicy) -> None:
        """Take the network."""
        self._network = network

    @torch.inference_mode()
    def believe(self, requests: Sequence[BeliefRequest]) -> Image32:
        """Return the probabilities (R, side, side), one robot after the other."""
        return np.concatenate(
            [
                self._network(_batch(each.window), _batch(each.way), _batch(each.goal), _batch(each.ego[None]))
                .occupied.sigmoid()
                .numpy()
                for each in requests
            ]
        )


def _batch(array: FloatArray | Image32) -> Tensor:
    """Return (1, …) float32."""
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))[None]
