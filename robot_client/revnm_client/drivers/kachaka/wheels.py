"""Sends velocities in a thread of its own, and minds whether the robot obeys."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import grpc

from revnm_client.drivers.kachaka.api import NOT_IN_MANUAL_MODE, KachakaApi
from revnm_client.messages import STANDSTILL, Velocity

_log = logging.getLogger(__name__)

MAX_V_MPS = 0.3  # a velocity goes over the wire as a part of these
MAX_W_RADPS = 1.57
_DEADLINE_S = 0.3
_SILENCE_S = 0.25
_RETRY_S = 1.0  # also what manual control may need to come about
_LAST_TRIES = 3


class Wheels:
    """The newest velocity wins; where none comes for 0.25 s, standstill is sent, and at the very beginning.

    Manual control is asked for when the robot shall move for the first time. If a person or an app takes it away
    afterwards, it is theirs: nothing more is sent until the client is started anew.
    """

    def __init__(self, api: KachakaApi) -> None:
        self._api = api
        self._wanted = STANDSTILL
        self._came = threading.Event()
        self._closing = False
        self._asked = self._taken = False  # manual control: wanted; taken away
        self._manual = self._may_hold = False  # granted; granted or unknown
        self._retry_s = 0.0
        self._trouble: str | None = None
        self._thread = threading.Thread(target=self._run, name="kachaka wheels")
        self._thread.start()

    def drive(self, velocity: Velocity) -> None:
        """Have a velocity sent; never waits."""
        self._wanted = velocity
        self._came.set()

    def trouble(self) -> str | None:
        """Return why the wheels would not obey; None where all is well."""
        return self._trouble

    def close(self) -> None:
        """Send standstill and give manual control back; takes two or three seconds at most."""
        self._closing = True
        self._came.set()
        self._thread.join()

    def _run(self) -> None:
        self._try(self._send, STANDSTILL)  # a client before this one may have ended while it drove
        while not self._closing:
            came = self._came.wait(_SILENCE_S)
            self._came.clear()
            self._try(self._obey, self._wanted if came else STANDSTILL)
        if self._may_hold:
            self._give_back()

    def _try(self, send: Callable[[Velocity], object], velocity: Velocity) -> None:
        try:
            send(velocity)
        except grpc.RpcError as error:
            self._trouble = f"the robot does not take velocities: {error.code().name}"
        except Exception as error:  # the outermost loop of this thread: the robot stands, and it goes on
            self._trouble = f"the driver failed: {error!r:.200}"
            _log.exception("cannot send a velocity")

    def _obey(self, velocity: Velocity) -> None:
        self._asked = self._asked or velocity != STANDSTILL
        if self._taken or not self._asked or not (self._manual or self._take_control()):
            return
        result = self._send(velocity)
        if result.success:
            self._trouble = None
        elif result.error_code == NOT_IN_MANUAL_MODE and time.monotonic() > self._retry_s:
            self._taken, self._may_hold = True, False
            self._trouble = "somebody took manual control of the robot: start the client anew to go on"
            _log.warning("%s", self._trouble)
        elif result.error_code != NOT_IN_MANUAL_MODE:
            self._trouble = f"the robot refuses velocities: error {result.error_code}"

    def _take_control(self) -> bool:
        if time.monotonic() < self._retry_s:
            return False
        self._retry_s = time.monotonic() + _RETRY_S
        self._may_hold = True
        result = self._api.set("SetManualControlEnabled", enable=True, timeout_s=_DEADLINE_S)
        self._manual = self._may_hold = result.success
        if not self._manual:
            self._trouble = f"the robot refuses manual control: error {result.error_code}"
        return self._manual

    def _send(self, velocity: Velocity) -> Any:
        return self._api.set(
            "SetRobotVelocity",
            linear=_part(velocity.v_mps, MAX_V_MPS),
            angular=_part(velocity.w_radps, MAX_W_RADPS),
            timeout_s=_DEADLINE_S,
        )

    def _give_back(self) -> None:
        for _ in range(_LAST_TRIES):
            try:
                self._send(STANDSTILL)
                self._api.set("SetManualControlEnabled", enable=False, timeout_s=_DEADLINE_S)
            except grpc.RpcError as error:
                _log.warning("cannot give the robot back: %s", error.code().name)
            else:
                return


def _part(value: float, limit: float) -> float:
    return min(max(value / limit, -1.0), 1.0)
