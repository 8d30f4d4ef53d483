"""Six classes of arms as cells: round numbers of their kind in masses, lengths and torques, of no certain product."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

X, Y, Z = "1 0 0", "0 1 0", "0 0 1"


@dataclass(frozen=True, slots=True)
class ArmClass:
    """An arm stretched upwards at zero.

    Attributes
    ----------
    axes : axis of each joint
    steps_m : height of each joint over the one before
    masses_kg : of the links, spread over their length
    thick_m : thickness of the links
    torques_nm : limits of the joints
    speed_rad_s : limit of all joints
    """

    axes: tuple[str, ...]
    steps_m: tuple[float, ...]
    masses_kg: tuple[float, ...]
    thick_m: float
    torques_nm: tuple[float, ...]
    speed_rad_s: float = 1.0


CLASSES = {
    # seven axes, 8 kg, a light wrist with small motors
    "seven light": ArmClass(
        (Z, Y, Z, Y, Z, Y, Z),
        (0.28, 0.13, 0.21, 0.21, 0.21, 0.11, 0.11),
        (1.38, 1.16, 1.16, 0.93, 0.68, 0.68, 0.36),
        0.08,
        (39, 39, 39, 39, 9, 9, 9),
    ),
    # seven axes, 12 kg, a last link that weighs next to nothing
    "seven with a thin flange": ArmClass(
        (Z, Y, Z, Y, Z, Y, Z),
        (0.27, 0.0, 0.29, 0.05, 0.34, 0.08, 0.10),
        (2.4, 1.9, 1.7, 1.7, 1.3, 1.3, 0.17),
        0.08,
        (50, 50, 30, 30, 30, 20, 20),
    ),
    # six axes, links of 10 g as an exporter left them, strong joints
    "six without mass": ArmClass(
        (Z, Y, Y, Z, Y, Z),
        (0.20, 0.0, 0.35, 0.0, 0.31, 0.0),
        (0.01, 0.01, 0.01, 0.01, 0.01, 0.01),
        0.05,
        (370, 370, 176, 176, 41, 20),
    ),
    # six axes, 20 kg, of a cobot
    "cobot": ArmClass(
        (Z, Y, Y, Y, Z, Y),
        (0.09, 0.13, 0.43, 0.39, 0.11, 0.09),
        (3.7, 8.4, 2.3, 1.2, 1.2, 0.25),
        0.1,
        (150, 150, 150, 28, 28, 28),
    ),
    # six axes, 0.7 t, of a foundry
    "heavy": ArmClass(
        (Z, Y, Y, Z, Y, Z),
        (0.35, 0.3, 1.1, 0.25, 1.1, 0.25),
        (250, 180, 160, 60, 30, 8),
        0.3,
        (6000, 8000, 5000, 1200, 1000, 600),
    ),
    # five axes, 1 kg, of a desk
    "desk": ArmClass(
        (Z, Y, Y, Y, Z), (0.07, 0.05, 0.12, 0.12, 0.08), (0.3, 0.3, 0.2, 0.15, 0.05), 0.04, (6, 6, 5, 3, 2)
    ),
}


def urdf_of_class(kind: ArmClass) -> str:
    """URDF text; every link is a cylinder from its joint to the next one."""
    parts = ['<robot name="arm">', '<link name="base_link"/>']
    steps = (*kind.steps_m[1:], kind.steps_m[-1])
    for i, (axis, mass, effort) in enumerate(zip(kind.axes, kind.masses_kg, kind.torques_nm, strict=True), start=1):
        length, wide = max(steps[i - 1], kind.thick_m), kind.thick_m
        across, along = mass * (3 * (wide / 2) ** 2 + length**2) / 12, mass * (wide / 2) ** 2 / 2
        parts += [
            f'<link name="link_{i}"><inertial><origin xyz="0 0 {length / 2}"/><mass value="{mass}"/>'
            f'<inertia ixx="{across}" ixy="0" ixz="0" iyy="{across}" iyz="0" izz="{along}"/></inertial></link>',
            f'<joint name="joint_{i}" type="revolute"><parent link="{f"link_{i - 1}" if i > 1 else "base_link"}"/>'
            f'<child link="link_{i}"/><origin xyz="0 0 {kind.steps_m[i - 1]}"/><axis xyz="{axis}"/>'
            f'<limit lower="-2.5" upper="2.5" effort="{effort}" velocity="2"/></joint>',
        ]
    return "\n".join([*parts, "</robot>"])


def cell_of_class(kind: ArmClass, bus: str) -> str:
    """Text of a cell file; `bus` is the body of its table [bus.a]."""
    axes = [
        f"""[[arm.axis]]
node_id = {number}
profile = "generic-cia402"
torque_constant_nm_per_a = {{ value = 0.1, source = "datasheet" }}
gear_ratio = {{ value = 100, source = "datasheet" }}
gear_efficiency = {{ value = 0.8, source = "datasheet" }}
position_limit_rad = [-1.0, 1.0]
speed_limit_rad_s = {kind.speed_rad_s}
torque_limit_nm = {torque}
"""
        for number, torque in enumerate(kind.torques_nm, start=1)
    ]
    head = f"""name = "class"
[bus.a]
{bus}
[[arm]]
name = "main"
bus = "a"
robot = "robot.urdf"
inertials = "prior:0.05"
floor_m = false
column_radius_m = false
link_radius_m = 0.01
load_radius_m = 0.01
"""
    return "\n".join([head, *axes, "[poses]\ncount = 2\nvalidation = 0\nsamples = 10\napproach_speed_rad_s = 0.2\n"])


def write_class(kind: ArmClass, folder: Path, bus: str) -> Path:
    """Cell file and URDF in a folder."""
    (folder / "robot.urdf").write_text(urdf_of_class(kind), encoding="utf-8")
    (folder / "cell.toml").write_text(cell_of_class(kind, bus), encoding="utf-8")
    return folder / "cell.toml"
