"""Robots over HTTP: goals, stop, resume."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, HTTPException, Path
from pydantic import BaseModel, ConfigDict, Field

from revnm_server.api.problems import responses
from revnm_server.service import NavigationService
from revnm_server.views.view import GoalView, RobotView

Pixel = Annotated[float, Field(strict=True, allow_inf_nan=False)]
RobotName = Annotated[str, Path(description="A robot's name, as in the server's settings.")]

_UNKNOWN = {404: "There is no robot of that name."}
_NO_GOAL = _UNKNOWN | {
    400: "The body cannot be read.",
    409: "The robot is stopped, or the camera has not given a picture yet.",
    422: "The body is malformed, or the pixel lies outside the picture.",
}


class GoalRequest(BaseModel):
    """Where to go.

    Attributes:
        u: Pixels of the camera's picture, from its left.
        v: The same, from its top.
    """

    model_config = ConfigDict(extra="forbid", json_schema_extra={"example": {"u": 412.0, "v": 296.5}})

    u: Pixel
    v: Pixel


class GoalReply(BaseModel):
    """The goal that was set.

    Attributes:
        robot: Whose.
        goal: Where it is.
    """

    robot: str
    goal: GoalView


class OrderReply(BaseModel):
    """What was ordered.

    Attributes:
        robot: Of whom.
        stopped: Whether it is to stand.
        acknowledged: Whether the robot itself has confirmed that by now.
        epoch: Raised by every stop: the robot takes no plan of an older one.
    """

    robot: str
    stopped: bool
    acknowledged: bool
    epoch: int


def robots_router(service: NavigationService) -> APIRouter:
    """Return the routes under ``/api/v1/robots``.

    They are plain functions, which FastAPI runs in threads: they may wait for a disk or a robot.
    """
    router = APIRouter(prefix="/api/v1/robots", tags=["robots"])

    @router.get("")
    def robots() -> list[RobotView]:
        """List the robots and what they are doing."""
        return service.view().robots

    @router.put("/{robot}/goal", responses=responses(_NO_GOAL))
    def set_goal(robot: RobotName, request: GoalRequest) -> GoalReply:
        """Send a robot to a pixel."""
        service.mission.of(robot)
        frame = service.camera.latest()
        if frame is None:
            raise HTTPException(409, "the camera has not given a picture yet")
        goal = service.set_goal(robot, request.u, request.v, size_px=frame.size_px)
        return GoalReply(robot=robot, goal=GoalView(*goal.pixel_uv, goal.id))

    @router.delete("/{robot}/goal", status_code=204, responses=responses(_UNKNOWN))
    def drop_goal(robot: RobotName) -> None:
        """Forget a robot's goal: it gets no more plans and stands within a second."""
        service.mission.drop_goal(robot)

    @router.post("/{robot}/stop", responses=responses(_UNKNOWN))
    def stop(robot: RobotName) -> OrderReply:
        """Stop a robot until it is resumed; its goal is dropped. Repeated until it confirms."""
        acknowledged = service.stop(robot)
        return _order_reply(robot, acknowledged=acknowledged)

    @router.post("/{robot}/resume", responses=responses(_UNKNOWN))
    def resume(robot: RobotName) -> OrderReply:
        """Release a robot's stop."""
        acknowledged = service.resume(robot)
        return _order_reply(robot, acknowledged=acknowledged)

    def _order_reply(robot: str, *, acknowledged: bool) -> OrderReply:
        wanted = service.mission.of(robot)
        return OrderReply(robot=robot, stopped=wanted.stopped, acknowledged=acknowledged, epoch=wanted.epoch)

    return router
