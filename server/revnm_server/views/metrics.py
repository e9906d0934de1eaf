"""What Prometheus asks for: the server's view and counts in its terms, seconds and totals.

Every scrape is made anew from the view, so that nothing is counted twice and two servers in one process do not mix.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import get_args

from prometheus_client import CollectorRegistry, Metric, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, SummaryMetricFamily
from prometheus_client.registry import Collector

from revnm_server.camera import CameraState
from revnm_server.service import NavigationService
from revnm_server.views.view import CameraView, RobotView, Status

_MS_PER_S = 1e3


def metrics_registry(service: NavigationService) -> CollectorRegistry:
    """Return the metrics of a server and its process."""
    registry = CollectorRegistry()
    registry.register(ServerCollector(service))
    ProcessCollector(registry=registry)
    return registry


class ServerCollector(Collector):
    """Metrics of one server.

    Args:
        service: The server.
    """

    def __init__(self, service: NavigationService) -> None:
        self._service = service

    def describe(self) -> list[Metric]:
        """Return nothing: to describe them, a registry would else collect them before the server runs."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics as of now."""
        view, tally = self._service.view(), self._service.tally()
        yield GaugeMetricFamily("revnm_ready", "1 if a goal would be driven to now.", float(view.ready))
        yield from _camera(view.camera)
        yield from _robots(view.robots)
        yield _stages(tally.stages_ms)
        yield CounterMetricFamily("revnm_tick_failures", "Pictures that no plan was made of.", tally.failures)
        plans = CounterMetricFamily("revnm_plans", "Plans sent.", labels=["robot"])
        for robot, count in tally.plans.items():
            plans.add_metric([robot], count)
        yield plans
        rejected = CounterMetricFamily("revnm_rejected", "Malformed payloads, by Zenoh key.", labels=["key"])
        for key, count in view.rejected.items():
            rejected.add_metric([key], count)
        yield rejected


def _camera(camera: CameraView) -> Iterator[Metric]:
    states = GaugeMetricFamily("revnm_camera_state", "1 for the state that the camera is in.", labels=["state"])
    for state in CameraState:
        states.add_metric([state.value], float(camera.state == state.value))
    yield states
    if camera.fps is not None:
        yield GaugeMetricFamily("revnm_camera_fps", "Pictures a second lately.", camera.fps)
    if camera.frame_age_s is not None:
        yield GaugeMetricFamily("revnm_camera_frame_age_seconds", "Age of the newest picture.", camera.frame_age_s)


def _robots(robots: list[RobotView]) -> Iterator[Metric]:
    status = GaugeMetricFamily("revnm_robot_status", "1 for what the robot is doing.", labels=["robot", "status"])
    for robot in robots:
        for each in get_args(Status):
            status.add_metric([robot.name, each], float(robot.status == each))
    yield status
    gauges: dict[str, tuple[str, Callable[[RobotView], float | None]]] = {
        "state_age_seconds": ("Time since the robot was heard.", lambda r: r.robot_state_age_s),
        "sighting_age_seconds": ("Time since the camera saw the robot's tag.", lambda r: r.sighting_age_s),
        "tag_pixels": ("Shortest side of the robot's tag when it was seen last.", lambda r: r.tag_px),
        "clock_offset_seconds": ("By how much the server's clock is ahead, as the robot says.", _clock_offset_s),
    }
    for name, (text, read) in gauges.items():
        family = GaugeMetricFamily(f"revnm_robot_{name}", text, labels=["robot"])
        for robot in robots:
            value = read(robot)
            if value is not None:
                family.add_metric([robot.name], value)
        yield family


def _clock_offset_s(robot: RobotView) -> float | None:
    return robot.clock_offset_ms / _MS_PER_S if robot.clock_offset_ms is not None else None


def _stages(stages_ms: dict[str, tuple[int, float]]) -> Metric:
    family = SummaryMetricFamily("revnm_stage_seconds", "How long the stages of a tick took.", labels=["stage"])
    for stage, (count, sum_ms) in stages_ms.items():
        family.add_metric([stage], count_value=count, sum_value=sum_ms / _MS_PER_S)
    return family
