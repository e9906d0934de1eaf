"""Two servers claim one robot: it follows the one that it followed first until that is gone, and both say so."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.server.waiting import eventually

from .hall import ROBOT, SCENARIO
from .network import give_address, require_namespaces
from .network_stage import NetworkStage, network_stage
from .server import Server
from .site import SERVER_HOSTS
from .speed_gauge import SpeedGauge

pytestmark = pytest.mark.slow

BEHIND_M = (-2.0, 1.2)
ASK_EVERY_S = 0.1


@contextmanager
def rival_of(system: NetworkStage) -> Iterator[Server]:
    """Start a second server, with the same camera, for the same robot, whose own router finds it, too."""
    edge, subnets, host = system.site.edge, system.site.subnets, SERVER_HOSTS[1]
    give_address(system.site.interface, f"{subnets[0]}.{host}/24", inside=edge)
    folder = system.folder / "rival"
    folder.mkdir()
    rival = Server(
        folder,
        listen=system.site.endpoint(host),
        http=f"{subnets[1]}.2:8001",
        camera=system.server.camera,
        options=["--insecure-http", "--insecure-zenoh"],
        prefix=edge.prefix,
    )
    try:
        rival.start()
        yield rival
    finally:
        rival.close()


def test_of_two_servers_the_robot_follows_the_first_until_that_is_gone(tmp_path: Path) -> None:
    require_namespaces()
    with network_stage(tmp_path, by_own_router=True) as system, rival_of(system) as rival:
        first, gauge = system.server, SpeedGauge(system.simulation)
        for server in (first, rival):
            eventually(server.ready, within_s=30.0, every_s=ASK_EVERY_S)
        for order in ("stop", "resume"):  # the rival, which has not heard of it, must catch up with the epoch
            assert first.call("POST", f"/api/v1/robots/{ROBOT}/{order}").status_code == 200
        goal = first.set_goal().json()["goal"]
        gauge.wait_faster(0.2, within_s=15.0)
        assert rival.set_goal(BEHIND_M).status_code == 200

        def arrived() -> bool:
            own = first.rover()["robot_state"]
            assert own["goal_id"] == goal["id"], own
            return system.arrived()

        followed = first.rover()["robot_state"]["server"]
        unheeded = f"the robot follows another server, {followed}: take it out of the settings of one of the two"
        eventually(lambda: rival.rover()["reason"] == unheeded, every_s=ASK_EVERY_S)
        assert rival.rover()["status"] == "waiting"
        eventually(arrived, within_s=30.0, every_s=ASK_EVERY_S)
        told = first.rover()["robot_state"]["last_refusal"]
        assert told.startswith("plan of server ")
        assert told.endswith(f": this robot follows {followed}")
        assert math.dist((system.simulation.true_pose.x_m, system.simulation.true_pose.y_m), SCENARIO.goal_m) < 0.5

        first.process.signal(signal.SIGKILL)
        eventually(lambda: rival.rover()["status"] == "arrived", within_s=30.0, every_s=ASK_EVERY_S)
        assert math.dist((system.simulation.true_pose.x_m, system.simulation.true_pose.y_m), BEHIND_M) < 0.5
        assert not system.simulation.had_contact
