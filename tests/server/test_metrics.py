from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import zenoh
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families

from revnm_server.camera import open_camera
from revnm_server.robots.mission import Mission
from revnm_server.service import NavigationService
from revnm_server.views.metrics import metrics_registry

from .service_parts import CameraFeed, FakePipeline, RobotEnd
from .waiting import eventually

Samples = dict[tuple[str, frozenset[tuple[str, str]]], float]


@pytest.fixture
def pipeline() -> FakePipeline:
    return FakePipeline()


@pytest.fixture
def service(router: zenoh.Session, pipeline: FakePipeline) -> Iterator[NavigationService]:
    camera = open_camera("zenoh://camera", router)
    running = NavigationService(router, camera=camera, pipeline=pipeline, mission=Mission(["rover"]), tick_hz=50)
    running.start()
    yield running
    running.close()
    camera.close()


def scraped(service: NavigationService) -> Samples:
    """What an independent reader makes of the text."""
    text = generate_latest(metrics_registry(service)).decode()
    families = text_string_to_metric_families(text)
    return {(s.name, frozenset(s.labels.items())): s.value for family in families for s in family.samples}


def value(samples: Samples, name: str, **labels: str) -> Any:
    return samples.get((name, frozenset(labels.items())))


def test_a_server_without_a_picture_says_so(service: NavigationService) -> None:
    samples = scraped(service)
    assert value(samples, "revnm_ready") == 0
    assert value(samples, "revnm_camera_state", state="init") == 1
    assert value(samples, "revnm_camera_state", state="running") == 0
    assert value(samples, "revnm_camera_frame_age_seconds") is None
    assert value(samples, "revnm_robot_state_age_seconds", robot="rover") is None
    assert value(samples, "process_resident_memory_bytes") > 1e6


def test_ticks_plans_and_robots_are_counted(
    service: NavigationService, router: zenoh.Session, pipeline: FakePipeline
) -> None:
    with CameraFeed(router), RobotEnd(router) as robot:
        eventually(lambda: robot.say(clock_offset_ms=-12.5) or service.view().ready)
        service.mission.set_goal("rover", 200, 200, size_px=(320, 240))
        samples = eventually(lambda: value(found := scraped(service), "revnm_plans_total", robot="rover") and found)
        assert value(samples, "revnm_ready") == 1
        assert value(samples, "revnm_camera_state", state="running") == 1
        assert value(samples, "revnm_robot_status", robot="rover", status="driving") == 1
        assert value(samples, "revnm_robot_status", robot="rover", status="stopped") == 0
        assert value(samples, "revnm_robot_clock_offset_seconds", robot="rover") == -0.0125
        assert value(samples, "revnm_robot_tag_pixels", robot="rover") == 30.0  # as service_parts draws it
        ticks = value(samples, "revnm_stage_seconds_count", stage="tick")
        assert value(samples, "revnm_stage_seconds_sum", stage="tick") == pytest.approx(0.004 * ticks)
        assert value(samples, "revnm_tick_failures_total") == 0
        pipeline.broken = "no such luck"
        eventually(lambda: value(scraped(service), "revnm_tick_failures_total") >= 2)


def test_malformed_payloads_are_counted_by_key(service: NavigationService, router: zenoh.Session) -> None:
    with CameraFeed(router):
        router.put("rover/revnm/state", b"{")
        eventually(lambda: value(scraped(service), "revnm_rejected_total", key="rover/revnm/state") == 1)


def test_two_servers_in_one_process_do_not_mix(service: NavigationService, router: zenoh.Session) -> None:
    camera = open_camera("zenoh://other", router)
    other = NavigationService(router, camera=camera, pipeline=FakePipeline(), mission=Mission(["crawler"]))
    try:
        assert value(scraped(other), "revnm_robot_status", robot="crawler", status="no_goal") == 1
        assert value(scraped(service), "revnm_robot_status", robot="crawler", status="no_goal") is None
    finally:
        other.close()
        camera.close()
