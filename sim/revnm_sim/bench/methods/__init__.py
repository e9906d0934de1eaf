"""The methods that are compared: one file each, all behind the same controller."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType

from revnm_sim.bench.methods.bev import BevMethod, BevNoLidarMethod
from revnm_sim.bench.methods.expert import ExpertMethod
from revnm_sim.bench.methods.ibvs import IbvsMethod
from revnm_sim.bench.methods.ibvs_scale import IbvsScaleMethod
from revnm_sim.bench.methods.method import Method, MethodContext, Perception, RobotFeed
from revnm_sim.bench.methods.no_dagger import NoDaggerMethod
from revnm_sim.bench.methods.no_exo2ego import NoExo2EgoMethod
from revnm_sim.bench.methods.oracle_ego import OracleEgoMethod
from revnm_sim.bench.methods.revnm import RevnmMethod
from revnm_sim.bench.methods.straight import StraightMethod

METHODS: MappingProxyType[str, Callable[[MethodContext], Method]] = MappingProxyType(
    {
        "revnm": RevnmMethod,
        "no_exo2ego": NoExo2EgoMethod,
        "oracle_ego": OracleEgoMethod,
        "no_dagger": NoDaggerMethod,
        "bev": BevMethod,
        "bev_no_lidar": BevNoLidarMethod,
        "ibvs": IbvsMethod,
        "ibvs_scale": IbvsScaleMethod,
        "straight": StraightMethod,
        "expert": ExpertMethod,
    }
)

WITH_MODELS = frozenset({"revnm", "no_exo2ego", "oracle_ego", "no_dagger"})
"""The methods that load a model bundle."""

WITH_DEPTH_NETWORK = frozenset({"bev", "bev_no_lidar"})
"""The methods that need a bundle's depth network, and only with perception ``models``."""

WITH_OWN_BUNDLE = frozenset({"no_dagger"})
"""Those of them that the common bundle does not serve."""

__all__ = [
    "METHODS",
    "WITH_DEPTH_NETWORK",
    "WITH_MODELS",
    "WITH_OWN_BUNDLE",
    "Method",
    "MethodContext",
    "Perception",
    "RobotFeed",
]
