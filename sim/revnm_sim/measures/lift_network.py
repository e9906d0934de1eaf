"""The views of a drive as the shipped depth network sees them, in rendered pictures."""

from __future__ import annotations

import dataclasses

from revnm_client.errors import ContractError
from revnm_server.frame import Frame
from revnm_server.networks.bundle import default_bundle_path, load_bundle
from revnm_server.stages.depth import OnnxDepth
from revnm_sim.bench.protocol import Setting
from revnm_sim.measures.lift_trial import HW, View
from revnm_sim.render import CameraRenderer
from revnm_sim.robot import RobotSpec


class DepthNetwork:
    """The server's default bundle's."""

    def __init__(self) -> None:
        """Load it.

        Raises:
            FileError: The bundle is missing or damaged.
            ContractError: Its disparities have another size than the views.
        """
        bundle = load_bundle(default_bundle_path(), threads=1)
        if bundle.spec.disparity_hw != HW:
            raise ContractError(f"the depth network gives {bundle.spec.disparity_hw}: expected {HW}")
        self._depth = OnnxDepth(bundle)

    def see(self, setting: Setting, places: list[View]) -> list[View]:
        """Return the views with the network's disparities instead of exact ones."""
        found = []
        with CameraRenderer(setting.site.world, setting.cameras[0], RobotSpec(), tag_id=0) as renderer:
            for number, place in enumerate(places):
                frame = Frame(renderer.picture(place.pose), number, number)
                found.append(dataclasses.replace(place, disparity=self._depth.disparity(frame)))
        return found
