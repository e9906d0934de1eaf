from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray
from revnm_server.frame import Frame, RobotSighting
from revnm_server.networks.bundle import load_bundle
from revnm_server.observation import Image32, ObservationSpec
from revnm_server.ports import EgoRequest, PlanRequest
from revnm_server.stages.depth import OnnxDepth
from revnm_server.stages.exo2ego import OnnxExo2Ego
from revnm_server.stages.policy import OnnxPolicy
from revnm_server.tag import TagDetector
from revnm_server.tick.pipeline import Pipeline

from .tag_scene import draw_tag, frame_of, picture_from_tag
from .tiny_bundle import DISPARITY_HW, EGO_PX, EXO_HW, SPACING_M, WAYPOINTS, write_tiny_bundle

MS = 1_000_000
SIZE = (640, 480)
UP = (0.0, -1.0)


@dataclass(frozen=True)
class Click:
    id: str
    normalised: tuple[float, float]


def _spec(history: int = 1) -> ObservationSpec:
    return ObservationSpec(
        history, 0.2, DISPARITY_HW, EXO_HW, EGO_PX, 0.4, True, EGO_PX, 1.5, 0.3, 5.0, WAYPOINTS, SPACING_M
    )


def _frame(stamp_ns: int) -> Frame:
    return Frame(np.zeros((SIZE[1], SIZE[0], 3), np.uint8), stamp_ns, stamp_ns)


class Truth:
    """Every port at once, as a simulator would be: what it gives can be told from the stamp, and it remembers."""

    def __init__(self) -> None:
        self.robots: dict[str, tuple[float, float]] = {}
        self.ego_batches: list[list[EgoRequest]] = []
        self.plan_batches: list[list[PlanRequest]] = []

    def disparity(self, frame: Frame) -> Image32:
        # A ramp to the right, above it a bright row whose number is the stamp in tenths of seconds.
        ramp = np.tile(np.linspace(2.0, 3.0, DISPARITY_HW[1], dtype=np.float32), (DISPARITY_HW[0], 1))
        ramp[frame.stamp_ns // (100 * MS) % DISPARITY_HW[0]] = 3.0
        return ramp

    def sightings(self, frame: Frame, expected: Mapping[str, FloatArray] | None = None) -> list[RobotSighting]:
        return [
            RobotSighting(name, frame.stamp_ns, np.array(pixel), np.array(UP), np.zeros((4, 2)))
            for name, pixel in self.robots.items()
        ]

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        self.ego_batches.append(list(requests))
        levels = [request.stamp_ns / (10_000 * MS) for request in requests]
        return np.array(levels, np.float32)[:, None, None] * np.ones((1, EGO_PX, EGO_PX), np.float32)

    def waypoints(self, requests: Sequence[PlanRequest]) -> FloatArray:
        self.plan_batches.append(list(requests))
        ahead = np.column_stack([SPACING_M * np.arange(1, WAYPOINTS + 1), np.zeros(WAYPOINTS)])
        return np.tile(ahead, (len(requests), 1, 1))


def _pipeline(truth: Truth, *, history: int = 1, max_age_s: float = 1.0) -> Pipeline:
    return Pipeline(
        _spec(history),
        depth=truth,
        tags=truth,
        exo2ego=truth,
        planner=truth,
        max_sighting_age_s=max_age_s,
    )


@pytest.mark.parametrize("history", [1, 5])
def test_real_models_from_picture_to_plan(tmp_path: Path, history: int) -> None:
    bundle = load_bundle(write_tiny_bundle(tmp_path / "b", steer="goal", history=history))
    pipeline = Pipeline(
        bundle.spec,
        depth=OnnxDepth(bundle),
        tags=TagDetector({3: "rover"}),
        exo2ego=OnnxExo2Ego(bundle),
        planner=OnnxPolicy(bundle),
    )
    # The robot is in the middle and faces right; the goal lies straight above it in the picture: to its left.
    homography = picture_from_tag(centre=(320, 240), side_px=40, turn_rad=math.pi / 2)
    gray = draw_tag(np.full((480, 640), 90, np.uint8), 3, homography)
    for k in range(4):
        stamp = (1_000 + 100 * k) * MS
        result = pipeline.step(frame_of(gray, stamp_ns=stamp), {"rover": Click("g1", (0.5, 0.1))})
        (plan,) = result.plans
        assert (plan.robot, plan.stamp_ns, plan.goal_id) == ("rover", stamp, "g1")
        expected = np.column_stack([np.zeros(5), SPACING_M * np.arange(1, 6)])
        np.testing.assert_allclose(plan.waypoints_m, expected, atol=0.05)
        assert result.disparity.shape == DISPARITY_HW
        assert (result.disparity.min(), result.disparity.max()) == (0.0, 1.0)
        assert result.ego_depths["rover"].shape == (EGO_PX, EGO_PX)
        assert [sighting.robot for sighting in result.sightings] == ["rover"]
        assert result.timings_ms.keys() == {"depth", "tag", "exo2ego", "policy", "tick"}
        stages = sum(result.timings_ms[stage] for stage in ("depth", "tag", "exo2ego", "policy"))
        assert stages <= result.timings_ms["tick"]


def test_what_the_ports_are_asked() -> None:
    truth = Truth()
    truth.robots = {"rover": (160.0, 360.0)}
    _pipeline(truth).step(_frame(500 * MS), {"rover": Click("g7", (0.9, 0.2))})
    (ego,) = truth.ego_batches[0]
    assert (ego.robot, ego.stamp_ns) == ("rover", 500 * MS)
    np.testing.assert_allclose(ego.pose.p_rob, [0.25, 0.75])  # 160 / 640, 360 / 480
    np.testing.assert_array_equal(ego.pose.q_rel, UP)
    assert ego.crops.shape == (1, EGO_PX, EGO_PX)
    # The ramp runs from 0 to 1 over the picture: 0.25 where the robot is, scale and shift undone.
    assert ego.crops[0, 16, 15:17].mean() == pytest.approx(0.25, abs=0.03)
    (plan,) = truth.plan_batches[0]
    assert (plan.robot, plan.stamp_ns, plan.goal_id) == ("rover", 500 * MS, "g7")
    np.testing.assert_allclose(plan.goal, [0.9, 0.2])
    assert plan.exo.shape == (1, *EXO_HW)
    assert plan.ego.shape == (1, EGO_PX, EGO_PX)
    assert plan.sighting.robot == "rover"


@pytest.mark.parametrize("count", [0, 1, 16])
def test_all_robots_go_in_one_batch(count: int) -> None:
    truth = Truth()
    truth.robots = {f"r{i}": (20.0 + 30 * i, 200.0) for i in range(count)}
    result = _pipeline(truth).step(_frame(0), {name: Click(f"to_{name}", (0.5, 0.5)) for name in truth.robots})
    assert [len(batch) for batch in truth.ego_batches] == [count]
    assert [len(batch) for batch in truth.plan_batches] == [count]
    assert [(plan.robot, plan.goal_id) for plan in result.plans] == [(r, f"to_{r}") for r in truth.robots]


@pytest.mark.parametrize("count", [0, 2])
def test_real_models_take_any_number_of_robots(tiny_bundle: Path, count: int) -> None:
    bundle = load_bundle(tiny_bundle)
    truth = Truth()
    truth.robots = {f"r{i}": (320.0, 240.0) for i in range(count)}
    pipeline = Pipeline(bundle.spec, depth=truth, tags=truth, exo2ego=OnnxExo2Ego(bundle), planner=OnnxPolicy(bundle))
    result = pipeline.step(_frame(0), {name: Click("g", (0.5, 0.1)) for name in truth.robots})
    assert len(result.plans) == count


def test_only_a_robot_with_a_goal_and_a_sighting_gets_a_plan() -> None:
    truth = Truth()
    truth.robots = {"seen": (10.0, 10.0), "driven": (320.0, 240.0)}
    goals = {"driven": Click("g", (0.1, 0.1)), "hidden": Click("h", (0.2, 0.2))}
    result = _pipeline(truth).step(_frame(0), goals)
    assert [plan.robot for plan in result.plans] == ["driven"]
    assert result.ego_depths.keys() == {"driven"}
    assert {sighting.robot for sighting in result.sightings} == {"seen", "driven"}


@pytest.mark.parametrize(
    ("max_age_s", "age_ms", "planned"),
    [(1.0, 100, True), (1.0, 1000, True), (1.0, 1001, False), (math.inf, 60_000, True)],
)
def test_a_hidden_robot_keeps_its_last_sighting_for_a_while(max_age_s: float, age_ms: int, planned: bool) -> None:
    truth = Truth()
    truth.robots = {"rover": (320.0, 240.0)}
    pipeline = _pipeline(truth, max_age_s=max_age_s)
    goals = {"rover": Click("g", (0.1, 0.1))}
    pipeline.step(_frame(5_000 * MS), goals)
    truth.robots = {}
    plans = pipeline.step(_frame((5_000 + age_ms) * MS), goals).plans
    # The waypoints belong to the robot's frame at the time of the sighting, and the stamp says so.
    assert [plan.stamp_ns for plan in plans] == [5_000 * MS] * planned


def test_a_sighting_from_the_future_is_forgotten() -> None:
    truth = Truth()
    truth.robots = {"rover": (320.0, 240.0)}
    pipeline = _pipeline(truth, max_age_s=math.inf)
    pipeline.step(_frame(5_000 * MS), {})
    truth.robots = {}
    assert pipeline.step(_frame(1_000 * MS), {}).sightings == ()


def test_history_of_exo_and_ego() -> None:
    truth = Truth()
    truth.robots = {"rover": (320.0, 240.0)}
    pipeline = _pipeline(truth, history=3)
    goals = {"rover": Click("g", (0.1, 0.1))}
    for k in range(8):  # every 100 ms; the interval of the history is 200 ms
        pipeline.step(_frame(100 * k * MS), goals)
    (plan,) = truth.plan_batches[-1]
    np.testing.assert_allclose(plan.ego[:, 0, 0], [0.03, 0.05, 0.07], atol=1e-6)  # at 300, 500 and 700 ms
    (ego,) = truth.ego_batches[-1]
    assert ego.crops.shape == (3, EGO_PX, EGO_PX)
    # The bright row, at the left edge where the ramp is 0: row 3, 5, 7 of 24 is row 1, 2, 3 of 12.
    assert plan.exo[:, :, 0].argmax(axis=1).tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("port", "array", "message"),
    [
        ("disparity", np.zeros((3, 3), np.float32), r"disparity: shape expected \(24, 32\), got \(3, 3\)"),
        ("disparity", np.full(DISPARITY_HW, np.inf, np.float32), "disparity: values that are not finite"),
        ("synthesise", np.zeros((2, EGO_PX, EGO_PX), np.float32), r"ego depth: shape expected \(1, 32, 32\)"),
        ("waypoints", np.zeros((1, 4, 2)), r"waypoints: shape expected \(1, 5, 2\), got \(1, 4, 2\)"),
        ("waypoints", np.full((1, 5, 2), np.nan), "waypoints: values that are not finite"),
    ],
)
def test_a_stage_that_breaks_its_contract_is_named(port: str, array: np.ndarray, message: str) -> None:
    answer: Callable[[object, object], np.ndarray] = lambda self, asked: array  # noqa: E731
    truth = type("Broken", (Truth,), {port: answer})()
    truth.robots = {"rover": (320.0, 240.0)}
    with pytest.raises(ContractError, match=message):
        _pipeline(truth).step(_frame(0), {"rover": Click("g", (0.1, 0.1))})


def test_depth_does_not_care_for_the_size_of_the_picture(tiny_bundle: Path) -> None:
    depth = OnnxDepth(load_bundle(tiny_bundle))
    ramp = np.tile(np.linspace(0, 255, 1280).astype(np.uint8)[None, :, None], (720, 1, 3))
    disparity = depth.disparity(Frame(ramp, 0, 0))
    assert disparity.shape == DISPARITY_HW
    # Means of 40 columns each, as a share of 255.
    expected = ramp[0, :, 0].reshape(32, 40).mean(axis=1) / 255
    np.testing.assert_allclose(disparity[0], expected, atol=0.01)
