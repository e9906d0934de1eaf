"""What is known of some robots: limits, outline, LiDAR and brakes, each with its source.

The middle of the outline is given by ``center_x_m``, metres ahead of the point that the robot turns about, which lies
between its drive wheels.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple


class Profile(NamedTuple):
    """A kind of robot.

    Attributes:
        values: Sections of the settings with their values.
        source: Where the values come from.
    """

    values: Mapping[str, Mapping[str, Any]]
    source: str


PROFILES: dict[str, Profile] = {
    "megarover": Profile(
        {
            "limits": {"max_v_mps": 0.5, "max_w_radps": 0.7, "max_a_mps2": 1.0, "max_alpha_radps2": 2.0},
            "footprint": {"length_m": 0.43, "width_m": 0.36},
            "braking": {"delay_s": 0.15, "braking_mps2": 1.0, "braking_radps2": 2.0, "margin_m": 0.03},
        },
        "the paper's speeds; 0.43 m × 0.36 m from vstoneofficial/megarover3_ros2's Nav2 footprint, centred as on "
        "the simulated robot: where base_link is the axle, 0.13 m from the front, set footprint.center_x_m: -0.085",
    ),
    "kachaka": Profile(
        {
            "limits": {"max_v_mps": 0.3, "max_w_radps": 1.57, "max_a_mps2": 0.5, "max_alpha_radps2": 2.0},
            "footprint": {"length_m": 0.387, "width_m": 0.24, "center_x_m": 0.0435},
            "lidar": {"x_m": 0.156, "yaw_rad": 1.5708},
            "braking": {"delay_s": 0.3, "braking_mps2": 0.5, "braking_radps2": 2.0, "margin_m": 0.03},
        },
        "pf-robotics/kachaka-api: velocities on the wire are parts of 0.3 m/s and 1.57 rad/s; _kachaka.urdf.xacro: "
        "body 0.387 m × 0.240 m, its middle 0.0435 m and its LiDAR 0.156 m before base_link, turned by 90°. "
        "Acceleration, brakes and delay are cautious guesses",
    ),
    "turtlebot3": Profile(
        {
            "limits": {"max_v_mps": 0.22, "max_w_radps": 1.82, "max_a_mps2": 1.0, "max_alpha_radps2": 4.0},
            "footprint": {"length_m": 0.281, "width_m": 0.306, "center_x_m": -0.064},
            "lidar": {"x_m": -0.048},
            "braking": {"delay_s": 0.2, "braking_mps2": 0.5, "braking_radps2": 2.0, "margin_m": 0.03},
        },
        "fits Burger and Waffle: the smaller speeds and the Waffle's outline, in which the Burger's lies, "
        "and the middle between their LiDARs",
    ),
    "turtlebot3_burger": Profile(
        {
            "limits": {"max_v_mps": 0.22, "max_w_radps": 2.84, "max_a_mps2": 1.0, "max_alpha_radps2": 4.0},
            "footprint": {"length_m": 0.138, "width_m": 0.178, "center_x_m": -0.032},
            "lidar": {"x_m": -0.032},
            "braking": {"delay_s": 0.2, "braking_mps2": 0.5, "braking_radps2": 2.0, "margin_m": 0.03},
        },
        "ROBOTIS e-Manual: 0.22 m/s, 2.84 rad/s, 138 mm × 178 mm; turtlebot3_burger.urdf: body and LiDAR 32 mm "
        "behind the axle. Acceleration, brakes and delay are cautious guesses",
    ),
    "turtlebot3_waffle": Profile(
        {
            "limits": {"max_v_mps": 0.26, "max_w_radps": 1.82, "max_a_mps2": 1.0, "max_alpha_radps2": 4.0},
            "footprint": {"length_m": 0.281, "width_m": 0.306, "center_x_m": -0.064},
            "lidar": {"x_m": -0.064},
            "braking": {"delay_s": 0.2, "braking_mps2": 0.5, "braking_radps2": 2.0, "margin_m": 0.03},
        },
        "ROBOTIS e-Manual: 0.26 m/s, 1.82 rad/s, 281 mm × 306 mm; turtlebot3_waffle_pi.urdf: body and LiDAR 64 mm "
        "behind the axle. Acceleration, brakes and delay are cautious guesses",
    ),
}

CAUTIOUS = {
    "limits": {"max_a_mps2": 0.5, "max_alpha_radps2": 1.0},
    "braking": {"delay_s": 0.3, "braking_mps2": 0.5, "braking_radps2": 1.0, "margin_m": 0.05},
}
"""What a custom robot has of what it does not say."""
