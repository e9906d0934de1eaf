"""The fixed encoder whose features FDD and KID compare.

It was trained on true ego depth alone, by ``revnm-train quality-encoder``, and never changes: numbers made with
another one are not comparable, so its hash is checked. Imports no torch.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from revnm_client.errors import FileError
from revnm_client.geometry import FloatArray
from revnm_server.networks.checked_file import file_sha256
from revnm_server.networks.inference import OnnxModel
from revnm_server.observation import Image32

ENCODER_PX = 32
FEATURES = 128
ENCODER_SHA256 = "80cee1c5a55238fde1bd7a031e92d1e0d72229d6ca98033d9e672a718ed9ac4c"
_BATCH = 64


def encoder_path() -> Path:
    """Return the file of the encoder that comes with the package."""
    return Path(__file__).parent / "depth_encoder.onnx"


class DepthEncoder:
    """Ego depth → 128 features."""

    def __init__(self, path: Path, *, threads: int = 1) -> None:
        """Load the encoder.

        Args:
            path: The file; see :func:`encoder_path`.
            threads: Threads that one call may use.

        Raises:
            FileError: The file is missing or is not the one that every number so far was made with.
        """
        if not path.is_file():
            raise FileError(f"{path}: missing; expected the depth encoder")
        got = file_sha256(path)
        if got != ENCODER_SHA256:
            raise FileError(f"{path}: altered: sha256 expected {ENCODER_SHA256}, got {got}")
        self._model = OnnxModel(path, threads=threads)

    def features(self, ego: Image32) -> FloatArray:
        """Return features (M, 128) of ego depth (M, 32, 32) in [−1, 1].

        Over the views that the encoder was trained on, each feature has mean 0 and variance 1.
        """
        parts = [
            self._model.run(depth=ego[start : start + _BATCH, None].astype(np.float32))["features"]
            for start in range(0, len(ego), _BATCH)
        ]
        return np.concatenate(parts)
