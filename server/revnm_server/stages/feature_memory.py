"""Keeps what a policy's encoder made of each image, so that none is encoded twice.

Of a history of N images, N − 1 were in earlier histories. Features are found by the image's own bytes: whatever
histories do (a robot appears late, a film begins anew, frames are lost), an image's features are its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import TYPE_CHECKING

import cv2
import numpy as np

from revnm_server.observation import Image32, ObservationSpec

if TYPE_CHECKING:
    from revnm_server.networks.inference import OnnxModel
    from revnm_server.ports import PlanRequest

_NS_PER_S = 1e9


@dataclass(frozen=True, slots=True)
class _Kept:
    features: Image32  # (T, d)
    stamp_ns: int  # of the picture that first needed it


class FeatureMemory:
    """The features of one camera's pictures and of its robots' ego depth; used by one thread."""

    def __init__(self, encoder: OnnxModel, spec: ObservationSpec) -> None:
        """Begin with nothing.

        Args:
            encoder: ``images`` (K, 1, e, e) → ``features`` (K, T, d).
            spec: How long histories are; ego depth is enlarged to the size of its ``exo_hw``.
        """
        self._encoder = encoder
        self._hw = spec.exo_hw
        self._keep_ns = round(spec.history * spec.history_interval_s * _NS_PER_S)
        self._kept: dict[bytes, _Kept] = {}

    def recall(self, requests: Sequence[PlanRequest]) -> tuple[Image32, Image32]:
        """Return the features of the requests' histories, exo and ego, each (R, N, T, d).

        What is new is encoded in one batch over all of them.

        Args:
            requests: At least one, all of one picture.
        """
        now_ns = requests[0].stamp_ns
        self._kept = {key: kept for key, kept in self._kept.items() if abs(now_ns - kept.stamp_ns) <= self._keep_ns}
        exo_keys = [_key(image) for image in requests[0].exo]  # robots share the picture's history
        ego_keys = [[_key(image) for image in request.ego] for request in requests]
        seen = dict(zip(exo_keys, requests[0].exo, strict=True))
        for keys, request in zip(ego_keys, requests, strict=True):
            seen |= zip(keys, request.ego, strict=True)
        self._encode({key: image for key, image in seen.items() if key not in self._kept}, now_ns)
        exo = self._stack(exo_keys)  # (N, T, d)
        return np.stack([exo] * len(requests)), np.stack([self._stack(keys) for keys in ego_keys])

    def _stack(self, keys: Sequence[bytes]) -> Image32:
        return np.stack([self._kept[key].features for key in keys])

    def _encode(self, images: dict[bytes, Image32], stamp_ns: int) -> None:
        if not images:
            return
        batch = np.stack([self._enlarged(image) for image in images.values()])
        features = self._encoder.run(images=batch[:, None])["features"]  # (K, T, d)
        self._kept |= {key: _Kept(each, stamp_ns) for key, each in zip(images, features, strict=True)}

    def _enlarged(self, image: Image32) -> Image32:
        """Return the image at the encoder's size, as training enlarges it: bilinear, pixel centres at halves."""
        if image.shape == self._hw:
            return image
        height, width = self._hw
        return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _key(image: Image32) -> bytes:
    return blake2b(np.ascontiguousarray(image).data, digest_size=16).digest()
