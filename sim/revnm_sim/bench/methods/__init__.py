"""The methods that are compared: one file each, all behind the same controller."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType

from revnm_sim.bench.methods.expert import ExpertMethod
from revnm_sim.bench.methods.ibvs import IbvsMethod
from revnm_sim.bench.methods.ibvs_scale import IbvsScaleMethod
from revnm_sim.bench.methods.method import Method, MethodContext, Perception
from revnm_sim.bench.methods.revnm import RevnmMethod
from revnm_sim.bench.methods.straight import StraightMethod

METHODS: MappingProxyType[str, Callable[[MethodContext], Method]] = MappingProxyType(
    {
        "revnm": RevnmMethod,
        "ibvs": IbvsMethod,
        "ibvs_scale": IbvsScaleMethod,
        "straight": StraightMethod,
        "expert": ExpertMethod,
    }
)

WITH_MODELS = frozenset({"revnm"})
"""The methods that load a model bundle."""

__all__ = ["METHODS", "WITH_MODELS", "Method", "MethodContext", "Perception"]
