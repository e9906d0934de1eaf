"""The robot as PyBullet sees it: a URDF made from :class:`revnm_sim.robot.RobotSpec`.

Imports no simulator. Collision shapes are chosen for cheap and exact contacts, not for looks: driven wheels
are spheres, which touch the floor in one point, so that the track is exactly known; casters are frictionless
spheres; both lie within the footprint, so that only the body can meet an obstacle.
"""

from __future__ import annotations

from revnm_sim.robot import RobotSpec

WHEEL_RADIUS_M = 0.05
CASTER_RADIUS_M = 0.02
BODY_BOTTOM_M = 0.03
PLATE_M = 0.004
BODY_KG = 10.0
LEFT_JOINT, RIGHT_JOINT, PLATE_JOINT = "left_wheel", "right_wheel", "tag_plate"


def wheel_track_m(spec: RobotSpec) -> float:
    """Return the distance between the two wheels' points of contact."""
    return spec.width_m - 0.06


def robot_urdf(spec: RobotSpec) -> str:
    """Return the URDF of the robot; the base link's origin is the robot frame's, on the floor.

    The top of the tag's plate, where the camera sees the tag, lies at ``spec.top_m``.
    """
    half_track = wheel_track_m(spec) / 2.0
    caster_x = spec.length_m / 2.0 - 0.04
    casters = "".join(_caster(f"caster_{name}", sign * caster_x) for name, sign in (("front", 1.0), ("rear", -1.0)))
    return (
        '<?xml version="1.0"?><robot name="megarover">'
        + _body(spec)
        + _wheel(LEFT_JOINT, half_track)
        + _wheel(RIGHT_JOINT, -half_track)
        + casters
        + _plate(spec)
        + "</robot>"
    )


def _inertial(mass_kg: float, inertia: float, z_m: float = 0.0) -> str:
    return (
        f'<inertial><origin xyz="0 0 {z_m}"/><mass value="{mass_kg}"/>'
        f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def _body(spec: RobotSpec) -> str:
    top = spec.top_m - PLATE_M
    height, middle = top - BODY_BOTTOM_M, (top + BODY_BOTTOM_M) / 2.0
    inertia = BODY_KG * (spec.length_m**2 + spec.width_m**2) / 12.0
    box = f'<geometry><box size="{spec.length_m} {spec.width_m} {height}"/></geometry>'
    # The mass sits low, at the axle, so that speeding up and braking do not pitch the body.
    return (
        f'<link name="base">{_inertial(BODY_KG, inertia, WHEEL_RADIUS_M)}'
        f'<visual><origin xyz="0 0 {middle}"/>{box}'
        '<material name="body"><color rgba="0.25 0.27 0.30 1"/></material></visual>'
        f'<collision><origin xyz="0 0 {middle}"/>{box}</collision></link>'
    )


def _wheel(name: str, y_m: float) -> str:
    ball = f'<geometry><sphere radius="{WHEEL_RADIUS_M}"/></geometry>'
    disc = f'<geometry><cylinder radius="{WHEEL_RADIUS_M}" length="0.03"/></geometry>'
    return (
        f'<link name="{name}_link">{_inertial(0.5, 6e-4)}'
        f'<visual><origin rpy="1.5707963 0 0"/>{disc}'
        '<material name="tyre"><color rgba="0.08 0.08 0.08 1"/></material></visual>'
        f"<collision>{ball}</collision></link>"
        f'<joint name="{name}" type="continuous"><parent link="base"/><child link="{name}_link"/>'
        f'<origin xyz="0 {y_m} {WHEEL_RADIUS_M}"/><axis xyz="0 1 0"/></joint>'
    )


def _caster(name: str, x_m: float) -> str:
    ball = f'<geometry><sphere radius="{CASTER_RADIUS_M}"/></geometry>'
    return (
        f'<link name="{name}_link">{_inertial(0.1, 4e-5)}<collision>{ball}</collision></link>'
        f'<joint name="{name}" type="fixed"><parent link="base"/><child link="{name}_link"/>'
        f'<origin xyz="{x_m} 0 {CASTER_RADIUS_M}"/></joint>'
    )


def _plate(spec: RobotSpec) -> str:
    box = f'<geometry><box size="{spec.length_m} {spec.width_m} {PLATE_M}"/></geometry>'
    return (
        f'<link name="{PLATE_JOINT}_link">{_inertial(0.05, 1e-3)}<visual>{box}'
        '<material name="plate"><color rgba="1 1 1 1"/></material></visual></link>'
        f'<joint name="{PLATE_JOINT}" type="fixed"><parent link="base"/><child link="{PLATE_JOINT}_link"/>'
        f'<origin xyz="0 0 {spec.top_m - PLATE_M / 2.0}"/></joint>'
    )
