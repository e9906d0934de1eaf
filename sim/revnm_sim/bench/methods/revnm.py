"""ReVNM: the server's own way from picture to waypoints with the models of a bundle, and the base of its ablations.

A bundle whose policy sees the picture runs as in the paper (:mod:`revnm_sim.bench.methods.picture`). One whose policy
sees the map runs as ``bev`` does, from nothing known of the camera, but plans on what the policy makes of the map.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from revnm_client.geometry import FloatArray
from revnm_server.networks.bundle import Bundle, load_bundle
from revnm_server.ports import EgoDepth
from revnm_server.stages.exo2ego import OnnxExo2Ego
from revnm_server.stages.policy import OnnxFloorPolicy
from revnm_server.tick.map_beliefs import MapBeliefs
from revnm_sim.bench.methods.bev import BevMethod
from revnm_sim.bench.methods.method import Method, MethodContext
from revnm_sim.bench.methods.picture import PictureMethod

EgoSource = Callable[[Bundle, MethodContext], EgoDepth]


class RevnmMethod:
    """The bundle's way to drive."""

    def __init__(self, context: MethodContext, ego: EgoSource = lambda bundle, _: OnnxExo2Ego(bundle)) -> None:
        """Load the bundle.

        Args:
            context: The trial.
            ego: What gives the robot's view; the bundle's exo2ego, unless an ablation has another.

        Raises:
            FileError: The bundle does not fit.
        """
        bundle = load_bundle(Path(context.bundle), threads=1)
        self._method: Method
        if bundle.sees == "picture":
            self._method = PictureMethod(context, bundle, ego(bundle, context))
        else:
            tag_m, policy = context.scenario.robot.top_m, OnnxFloorPolicy(bundle)
            beliefs = MapBeliefs(bundle.spec, exo2ego=ego(bundle, context), policy=policy, tag_height_m=tag_m)
            self._method = BevMethod(context, beliefs)

    def look(self) -> None:
        """Take the picture, where depth comes from it."""
        self._method.look()

    def waypoints(self) -> FloatArray | None:
        """Return the waypoints; None where there is no plan."""
        return self._method.waypoints()
