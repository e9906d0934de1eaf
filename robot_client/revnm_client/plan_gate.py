"""Which plans the robot takes, and the stop that an operator can rely on."""

from __future__ import annotations

from collections import Counter

from revnm_client.messages import Plan

FUTURE_NS = 200_000_000


class PlanGate:
    """Epochs, sequence numbers and the latched stop.

    Attributes:
        epoch: Plans of an older one are refused; raised by a stop, a resume and a plan of a newer one.
        seq: Of the last accepted plan in this epoch; None before the first.
        stopped: The stop is latched.
        refused: How many plans were refused, by kind of reason.
        last_refusal: The last reason in words; empty before the first.
    """

    def __init__(self) -> None:
        self.epoch = 0
        self.seq: int | None = None
        self.stopped = False
        self.refused: Counter[str] = Counter()
        self.last_refusal = ""

    def stop(self, epoch: int) -> None:
        """Latch the stop and raise the epoch to ``epoch``; a smaller one latches too, but lowers nothing."""
        self.stopped = True
        self._raise(epoch)

    def resume(self, epoch: int) -> None:
        """Unlatch the stop and raise the epoch to ``epoch``; a smaller one lowers nothing."""
        self.stopped = False
        self._raise(epoch)

    def accepts(
        self, plan: Plan, *, received_ns: int, offset_ns: int | None, server: str | None, has_pose: bool
    ) -> bool:
        """Take a plan, or refuse it and count why.

        Args:
            plan: A plan that is sound in itself.
            received_ns: Robot's clock.
            offset_ns: Server's clock minus the robot's; None while unknown.
            server: The one that the robot follows, whose clock that is; None for any.
            has_pose: Odometry knows where the robot was at the plan's capture.
        """
        if offset_ns is None:
            return self._refuse("clock", "the clock offset to the server is unknown")
        if server is not None and plan.server != server:
            return self._refuse("server", f"plan of server {plan.server}: this robot follows {server}")
        ahead_ns = plan.stamp_ns - offset_ns - received_ns
        if ahead_ns > FUTURE_NS:
            return self._refuse("future", f"plan is stamped {ahead_ns * 1e-9:.1f} s in the future")
        if plan.epoch < self.epoch:
            return self._refuse("epoch", f"plan of epoch {plan.epoch} is older than epoch {self.epoch}")
        if plan.epoch == self.epoch and self.seq is not None and plan.seq <= self.seq:
            return self._refuse("seq", f"plan {plan.seq} is not newer than plan {self.seq}")
        if not has_pose:
            return self._refuse("odometry", "no odometry at the time of the plan's picture")
        self._raise(plan.epoch)
        self.seq = plan.seq
        return True

    def _raise(self, epoch: int) -> None:
        if epoch > self.epoch:
            self.epoch = epoch
            self.seq = None

    def _refuse(self, kind: str, reason: str) -> bool:
        self.refused[kind] += 1
        self.last_refusal = reason
        return False
