"""The JSON messages of our own: plan attachment, stop, time and state.

Decoding is total and strict: one flat JSON object of at most 4096 bytes, keys known and unique, integers that
are integers, no NaN; anything else is :class:`MessageError`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from revnm_client import json_payload, validate
from revnm_client.errors import MessageError
from revnm_client.json_payload import Scalar
from revnm_client.messages import Plan

MAX_STATE_FIELDS = 40
_MAX_REASON_LENGTH = 256
_LARGEST_INT = 2**63


@dataclass(frozen=True, slots=True)
class PlanTicket:
    """What a plan carries beside its waypoints: see :class:`revnm_client.messages.Plan`."""

    epoch: int
    seq: int
    goal_id: str
    server: str


@dataclass(frozen=True, slots=True)
class StopRequest:
    """Server → robot: stop until told to go on, or go on.

    Attributes:
        action: ``"stop"`` latches, ``"resume"`` releases.
        epoch: Plans of an older epoch are refused from now on.
    """

    action: Literal["stop", "resume"]
    epoch: int


@dataclass(frozen=True, slots=True)
class StopReply:
    """Robot → server: the acknowledgement.

    Attributes:
        stopped: Whether the stop is latched now.
        epoch: The robot's epoch now.
    """

    stopped: bool
    epoch: int


@dataclass(frozen=True, slots=True)
class TimeRequest:
    """Robot → server: when it was sent, robot's wall clock, ns."""

    t1_ns: int


@dataclass(frozen=True, slots=True)
class TimeReply:
    """Server → robot: the request's time, when it came and was answered, server's wall clock, ns; the server's name."""

    t1_ns: int
    t2_ns: int
    t3_ns: int
    server: str


def encode_attachment(plan: Plan) -> bytes:
    """Return the plan's epoch, seq, goal id and server as JSON ``{"epoch", "seq", "goal", "server"}``."""
    return json_payload.encode_object(
        {"epoch": plan.epoch, "seq": plan.seq, "goal": plan.goal_id, "server": plan.server}
    )


def decode_attachment(payload: bytes) -> PlanTicket:
    """Return the checked attachment of a plan.

    Raises:
        MessageError: It is malformed.
    """
    fields = json_payload.decode_object(payload, what="plan attachment")
    json_payload.only(fields, {"epoch", "seq", "goal", "server"}, what="plan attachment")
    return PlanTicket(
        epoch=json_payload.count(fields["epoch"], what="epoch"),
        seq=json_payload.count(fields["seq"], what="seq"),
        goal_id=json_payload.text(fields["goal"], what="goal"),
        server=json_payload.text(fields["server"], what="server"),
    )


def encode_stop_request(request: StopRequest) -> bytes:
    """Return the request as JSON ``{"action", "epoch"}``."""
    return json_payload.encode_object({"action": request.action, "epoch": request.epoch})


def decode_stop_request(payload: bytes) -> StopRequest:
    """Return the checked request.

    Raises:
        MessageError: It is malformed or the action is neither ``"stop"`` nor ``"resume"``.
    """
    fields = json_payload.decode_object(payload, what="stop request")
    json_payload.only(fields, {"action", "epoch"}, what="stop request")
    action = fields["action"]
    if action not in ("stop", "resume"):
        raise MessageError(f"action is {action!r:.80}: expected 'stop' or 'resume'")
    return StopRequest(action, json_payload.count(fields["epoch"], what="epoch"))


def encode_stop_reply(reply: StopReply) -> bytes:
    """Return the acknowledgement as JSON ``{"stopped", "epoch"}``."""
    return json_payload.encode_object({"stopped": reply.stopped, "epoch": reply.epoch})


def decode_stop_reply(payload: bytes) -> StopReply:
    """Return the checked acknowledgement.

    Raises:
        MessageError: It is malformed.
    """
    fields = json_payload.decode_object(payload, what="stop reply")
    json_payload.only(fields, {"stopped", "epoch"}, what="stop reply")
    stopped = json_payload.flag(fields["stopped"], what="stopped")
    return StopReply(stopped, json_payload.count(fields["epoch"], what="epoch"))


def encode_time_request(request: TimeRequest) -> bytes:
    """Return the request as JSON ``{"t1"}``."""
    return json_payload.encode_object({"t1": request.t1_ns})


def decode_time_request(payload: bytes) -> TimeRequest:
    """Return the checked request.

    Raises:
        MessageError: It is malformed.
    """
    fields = json_payload.decode_object(payload, what="time request")
    json_payload.only(fields, {"t1"}, what="time request")
    return TimeRequest(json_payload.count(fields["t1"], what="t1"))


def encode_time_reply(reply: TimeReply) -> bytes:
    """Return the reply as JSON ``{"t1", "t2", "t3", "server"}``."""
    return json_payload.encode_object({"t1": reply.t1_ns, "t2": reply.t2_ns, "t3": reply.t3_ns, "server": reply.server})


def decode_time_reply(payload: bytes) -> TimeReply:
    """Return the checked reply.

    Raises:
        MessageError: It is malformed or was sent before the request came.
    """
    fields = json_payload.decode_object(payload, what="time reply")
    json_payload.only(fields, {"t1", "t2", "t3", "server"}, what="time reply")
    t1, t2, t3 = (json_payload.count(fields[key], what=key) for key in ("t1", "t2", "t3"))
    if t3 < t2:
        raise MessageError(f"time reply was sent {t2 - t3} ns before its request came")
    return TimeReply(t1, t2, t3, json_payload.text(fields["server"], what="server"))


def encode_state(state: Mapping[str, Scalar]) -> bytes:
    """Return the state of a robot as JSON; numbers must be finite."""
    return json_payload.encode_object(state)


def _check_state_field(key: str, value: Any) -> None:
    validate.name(key, what="key of robot state")
    if isinstance(value, str):
        validate.name(value, what=key, max_length=_MAX_REASON_LENGTH)
    elif value is not None and not isinstance(value, int | float):
        raise MessageError(f"{key} is {value!r:.80}: expected text, a number, true, false or null")
    elif isinstance(value, int) and abs(value) > _LARGEST_INT:  # it can have more digits than a float can hold
        raise MessageError(f"{key}: expected an integer of 64 bits")


def decode_state(payload: bytes) -> dict[str, Scalar]:
    """Return the checked state of a robot: a flat object with at least these keys.

    ``robot`` text, ``moving`` and ``stopped`` true or false, ``epoch`` an integer, ``reason`` text or null.
    The others are for display: any scalar may stand there.

    Raises:
        MessageError: It is malformed.
    """
    fields = json_payload.decode_object(payload, what="robot state")
    missing = {"robot", "moving", "stopped", "epoch", "reason"} - fields.keys()
    if missing or len(fields) > MAX_STATE_FIELDS:
        raise MessageError(f"robot state has {len(fields)} keys and lacks {sorted(missing)}")
    for key, value in fields.items():
        _check_state_field(key, value)
    json_payload.text(fields["robot"], what="robot")
    json_payload.flag(fields["moving"], what="moving")
    json_payload.flag(fields["stopped"], what="stopped")
    json_payload.count(fields["epoch"], what="epoch")
    if fields["reason"] is not None:
        json_payload.text(fields["reason"], what="reason", max_length=_MAX_REASON_LENGTH)
    return fields
