"""ReVNM without exo2ego: the policy gets an ego depth that shows nothing near.

An ablation at run time: the bundle's policy was trained with imagined ego depth. The paper's ablation trains a policy
without it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from revnm_server.networks.bundle import Bundle
from revnm_server.observation import Image32
from revnm_server.ports import EgoRequest
from revnm_sim.bench.methods.method import MethodContext
from revnm_sim.bench.methods.revnm import RevnmMethod


class BlankEgo:
    """Ego depth in which everything is as far as can be told."""

    def __init__(self, bundle: Bundle, _: MethodContext) -> None:
        self._px = bundle.spec.ego_px

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        """Return (R, ego_px, ego_px) float32, all 1."""
        return np.ones((len(requests), self._px, self._px), dtype=np.float32)


class NoExo2EgoMethod(RevnmMethod):
    """The pipeline with :class:`BlankEgo`."""

    def __init__(self, context: MethodContext) -> None:
        super().__init__(context, BlankEgo)
