"""Turns the settings into what the parts of the client are given."""

from __future__ import annotations

from revnm_client.agent import AgentConfig
from revnm_client.braking import BrakingConfig
from revnm_client.mppi import Footprint, MppiConfig
from revnm_client.runner import RunnerSettings
from revnm_client.safety import SafetyConfig
from revnm_client.settings.root import Limits, RobotSettings

_BEYOND_MARGIN_M = 0.12  # the distance field reaches farther than any cost
_FIELD_MARGIN_M = 0.22


def runner_settings(settings: RobotSettings) -> RunnerSettings:
    """Return the settings of the control loop.

    Raises:
        FileError: The robot's password cannot be read.
    """
    return RunnerSettings(
        robot=settings.robot,
        connect=settings.server,
        credentials=settings.security.credentials(settings.robot),
        driver=settings.driver.kind,
        driver_options=settings.driver.options,
    )


def agent_config(settings: RobotSettings) -> AgentConfig:
    """Return the settings of the robot's brain."""
    outline = settings.footprint
    footprint = Footprint(length_m=outline.length_m, width_m=outline.width_m, center_x_m=outline.center_x_m)
    braking, safety = settings.braking, settings.safety
    return AgentConfig(
        robot=settings.robot,
        lidar=settings.lidar.mounting,
        mppi=_mppi(settings.limits, footprint),
        safety=SafetyConfig(
            max_plan_age_s=safety.max_plan_age_s,
            max_scan_age_s=safety.max_scan_age_s,
            max_odometry_age_s=safety.max_odometry_age_s,
            braking=BrakingConfig(
                delay_s=braking.delay_s,
                braking_mps2=braking.braking_mps2,
                braking_radps2=braking.braking_radps2,
                margin_m=braking.margin_m,
                footprint=footprint,
            ),
        ),
    )


def _mppi(limits: Limits, footprint: Footprint) -> MppiConfig:
    """Return the controller, its noise and its field of obstacles in the Megarover's proportions to speed and size."""
    usual = MppiConfig()
    reach_m = max(footprint.circle_radius_m + usual.weights.repulsion_margin_m, footprint.circumscribed_m)
    reach_m += _BEYOND_MARGIN_M
    return MppiConfig(
        max_v_mps=limits.max_v_mps,
        max_w_radps=limits.max_w_radps,
        max_a_mps2=limits.max_a_mps2,
        max_alpha_radps2=limits.max_alpha_radps2,
        sigma_v_mps=round(limits.max_v_mps * 2.0 / 5.0, 6),
        sigma_w_radps=round(limits.max_w_radps * 4.0 / 7.0, 6),
        field_half_m=round(limits.max_v_mps * usual.steps * usual.dt_s + reach_m + _FIELD_MARGIN_M, 6),
        field_reach_m=round(reach_m, 6),
        footprint=footprint,
    )
