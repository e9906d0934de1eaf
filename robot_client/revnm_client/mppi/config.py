"""Settings of the controller; the defaults are tuned for the Megarover (0.5 m/s, 0.7 rad/s)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from revnm_client.errors import ConfigError

_OVERHANG_M = 0.04
_LARGEST_M = 3.0


@dataclass(frozen=True, slots=True)
class Footprint:
    """The robot's rectangle, and the row of circles along its middle that covers it.

    The circles overhang its sides by at most some centimetres, since the sides decide which gaps the robot fits
    through: the longer the robot, the more of them.

    Attributes:
        length_m: Along x.
        width_m: Along y.
        center_x_m: The rectangle's middle lies so far ahead of the robot's frame, about which it turns.
    """

    length_m: float = 0.43
    width_m: float = 0.36
    center_x_m: float = 0.0

    def __post_init__(self) -> None:
        if not (0.0 < self.length_m <= _LARGEST_M and 0.0 < self.width_m <= _LARGEST_M):
            raise ConfigError(
                f"footprint of {self.length_m} m × {self.width_m} m: expected lengths over 0, up to {_LARGEST_M} m"
            )
        if not abs(self.center_x_m) <= self.length_m / 2.0:
            raise ConfigError(
                f"the footprint's middle lies {self.center_x_m} m ahead of the robot's frame: expected the frame "
                f"within its {self.length_m} m"
            )

    @property
    def circle_radius_m(self) -> float:
        """Radius of the covering circles, rounded up to centimetres."""
        return math.ceil(100.0 * self._exact_radius_m(len(self.circles_x_m)) - 1e-9) / 100.0

    @property
    def circles_x_m(self) -> tuple[float, ...]:
        """Where the middles of the covering circles lie ahead of the robot's frame."""
        count = 1
        while self._exact_radius_m(count) > self.width_m / 2.0 + _OVERHANG_M:
            count += 1
        return tuple(self.center_x_m + self.length_m * ((i + 0.5) / count - 0.5) for i in range(count))

    @property
    def front_x_m(self) -> float:
        """Where its front lies ahead of the robot's frame."""
        return self.center_x_m + self.length_m / 2.0

    @property
    def rear_x_m(self) -> float:
        """Where its rear lies ahead of the robot's frame; negative."""
        return self.center_x_m - self.length_m / 2.0

    @property
    def circumscribed_m(self) -> float:
        """Radius of the circle about the robot's frame that the body stays in when it turns."""
        return math.hypot(self.length_m / 2.0 + abs(self.center_x_m), self.width_m / 2.0)

    def _exact_radius_m(self, count: int) -> float:
        """Return the radius of circles that each cover one piece of the rectangle cut across."""
        return math.hypot(self.length_m / (2.0 * count), self.width_m / 2.0)


@dataclass(frozen=True, slots=True)
class CriticWeights:
    """Weights of the critics; costs are compared on the scale of ``MppiConfig.temperature``.

    Attributes:
        collision: Added once to a rollout that collides.
        critical: Per step and metre of missing ``critical_margin_m``.
        critical_margin_m: Clearance of the covering circles below which ``critical`` counts.
        repulsion: Mean over the steps, per metre of missing ``repulsion_margin_m``.
        repulsion_margin_m: Clearance below which ``repulsion`` counts.
        follow: Per metre between rollout and target point, half for its end, half for its mean.
        align: Per metre of mean distance to the path.
        heading: Times the mean of 1 − cos(angle to the target point).
        turning: Times the mean squared turning rate, s²/rad².
    """

    collision: float = 1.0e4
    critical: float = 20.0
    critical_margin_m: float = 0.10
    repulsion: float = 4.0
    repulsion_margin_m: float = 0.35
    follow: float = 10.0
    align: float = 10.0
    heading: float = 2.0
    turning: float = 0.3


@dataclass(frozen=True, slots=True)
class MppiConfig:
    """Size, limits and noise of the controller.

    Attributes:
        samples: K, rollouts a tick.
        steps: T, steps of a rollout.
        dt_s: Duration of a step.
        period_s: Time between two ticks; at most ``dt_s``.
        max_v_mps: Top speed; the controller never drives backwards.
        max_w_radps: Top turning rate.
        max_a_mps2: Acceleration and braking.
        max_alpha_radps2: Angular acceleration and braking.
        sigma_v_mps: Spread of the sampled speeds.
        sigma_w_radps: Spread of the sampled turning rates.
        knots: Independent noise values along a rollout; straight lines between them, so samples are smooth.
        temperature: λ of the softmax over costs.
        turn_first_rad: Turn on the spot while the path ahead bears more than this...
        turned_rad: ...until it bears less than this.
        field_half_m: Half the side of the square of obstacles around the robot.
        field_resolution_m: Cell of the distance field.
        field_reach_m: Distances are truncated to this.
        footprint: The robot's outline.
        weights: Of the critics.
    """

    samples: int = 1000
    steps: int = 30
    dt_s: float = 0.1
    period_s: float = 0.05
    max_v_mps: float = 0.5
    max_w_radps: float = 0.7
    max_a_mps2: float = 1.0
    max_alpha_radps2: float = 2.0
    sigma_v_mps: float = 0.2
    sigma_w_radps: float = 0.4
    knots: int = 7
    temperature: float = 0.3
    turn_first_rad: float = 1.05
    turned_rad: float = 0.35
    field_half_m: float = 2.4
    field_resolution_m: float = 0.04
    field_reach_m: float = 0.68
    footprint: Footprint = field(default_factory=Footprint)
    weights: CriticWeights = field(default_factory=CriticWeights)

    def __post_init__(self) -> None:
        if self.samples < 20 or self.steps < 9 or not 2 <= self.knots <= self.steps:
            raise ConfigError(
                f"MPPI of {self.samples} samples, {self.steps} steps, {self.knots} knots: expected at least "
                "20 samples, 9 steps and 2 knots, and no more knots than steps"
            )
        if not 0.0 < self.period_s <= self.dt_s:
            raise ConfigError(f"control period {self.period_s} s: expected in (0, {self.dt_s}], one step at most")
        least_m = max(self.footprint.circle_radius_m + self.weights.critical_margin_m, self.footprint.circumscribed_m)
        if self.field_reach_m < least_m + self.field_resolution_m:
            raise ConfigError(
                f"the distance field reaches {self.field_reach_m} m: expected at least "
                f"{least_m + self.field_resolution_m:.2f} m for this footprint"
            )

    @property
    def horizon_m(self) -> float:
        """The way at top speed over all steps."""
        return self.max_v_mps * self.steps * self.dt_s
