"""Cells drawn at random: arm, collision geometry, mounting, floor, boxes and payload, as URDF and cell file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

Vector = tuple[float, float, float]
MOUNTINGS = ("upright", "tilted", "wall", "ceiling")
MOUNTING_SHARES = (0.5, 0.25, 0.15, 0.1)
#: Share of links (never base and wrist) whose collision geometry is left out, in every fifth cell.
WITHOUT_GEOMETRY = 0.4


@dataclass(frozen=True, slots=True)
class DrawnCell:
    """A cell on disk and what an independent checker has to know of it.

    Attributes
    ----------
    file, urdf : Path
        The robot's URDF holds arm and payload, the payload as a link of its own that is fixed to the last.
    upward, outward : tuples of 3 floats
        Unit vectors against gravity and along axis 1, base frame.
    floor_m : float or None
        As the cell states it; None = the cell says nothing.
    pedestal_m : float or None
        Radius of the column below the base.
    boxes_m : tuple of (lower, upper) corners
    axes : int
    mounting : str
    """

    file: Path
    urdf: Path
    upward: Vector
    outward: Vector
    floor_m: float | None
    pedestal_m: float | None
    boxes_m: tuple[tuple[Vector, Vector], ...]
    axes: int
    mounting: str


@dataclass(frozen=True, slots=True)
class _Joint:
    axis: str
    origin: Vector
    half_range: float


def draw(seed: int, folder: Path, poses: int) -> DrawnCell:
    """Write cell number `seed` into a folder of its own."""
    random = np.random.default_rng([20, seed])
    folder.mkdir(parents=True, exist_ok=True)
    reach = float(random.uniform(0.7, 2.8))
    joints, flange, flange_rpy = _chain(random, reach)
    links = _links(random, reach, joints, flange, folder, holes=seed % 5 == 4)
    load, load_key = _payload(random, reach)
    mounting = str(random.choice(MOUNTINGS, p=MOUNTING_SHARES))
    upward = _upward(random, mounting)
    floor = _floor(random, mounting, reach)
    pedestal = round(0.12 * reach, 4) if mounting in MOUNTINGS[:2] and floor is not None and floor < 0 else None
    boxes = _boxes(random, reach)
    urdf = folder / "with_payload.urdf"
    (folder / "robot.urdf").write_text(_urdf(joints, links, ""))
    urdf.write_text(_urdf(joints, links, _payload_link(len(joints), load, flange, flange_rpy)))
    file = folder / "cell.toml"
    keys = [f"flange_xyz_m = {json.dumps(flange)}", f"flange_rpy_rad = {json.dumps(flange_rpy)}", load_key]
    keys += [f"gravity_m_s2 = {json.dumps([-9.80665 * value for value in upward])}"]
    keys += [] if floor is None else [f"floor_m = {floor}"]
    keys += [] if pedestal is None else [f"column_radius_m = {pedestal}"]
    listed = ", ".join(f"{{ min_m = {json.dumps(low)}, max_m = {json.dumps(high)} }}" for low, high in boxes)
    file.write_text(_toml(seed, [*keys, f"keep_out = [{listed}]"], joints, poses))
    return DrawnCell(file, urdf, upward, (0.0, 0.0, 1.0), floor, pedestal, boxes, len(joints), mounting)


def _chain(random: np.random.Generator, reach: float) -> tuple[list[_Joint], Vector, Vector]:
    """Joints of an elbow arm with a hand of three axes, an arm with level axes side by side, or one of seven axes."""
    kind = random.choice(["elbow", "level", "seven"], p=[0.55, 0.3, 0.15])
    high, upper = float(random.uniform(0.12, 0.2)) * reach, float(random.uniform(0.4, 0.5)) * reach
    low, offset_m = reach - upper, float(random.uniform(0.0, 0.12)) * reach
    up = 0.12 * reach
    if kind == "elbow":
        lift = float(random.uniform(0.0, 0.06)) * reach
        turns = [("z", (0, 0, high), 2.9), ("y", (offset_m, 0, up), 1.9), ("y", (0, 0, upper), 2.0)]
        turns += [("x", (0.5 * low, 0, lift), 3.1), ("y", (0.5 * low, 0, 0), 2.1), ("x", (0.06 * reach, 0, 0), 3.1)]
        end = ((0.04 * reach, 0.0, 0.0), (0.0, np.pi / 2, 0.0))
    elif kind == "level":
        side = 0.12 * reach
        turns = [("z", (0, 0, high), 3.0), ("y", (0, side, up), 2.4), ("y", (0, -0.9 * side, upper), 2.6)]
        turns += [("y", (0, 0, low), 2.8), ("z", (0, 0.8 * side, 0), 3.0), ("y", (0, 0, 0.09 * reach), 3.0)]
        end = ((0.0, 0.07 * reach, 0.0), (-np.pi / 2, 0.0, 0.0))
    else:
        turns = [("z", (0, 0, high), 2.9), ("y", (0, 0, up), 2.0), ("z", (0, 0, upper / 2), 2.9)]
        turns += [("y", (0, 0, upper / 2), 2.0), ("z", (0, 0, low / 2), 2.9), ("y", (0, 0, low / 2), 2.0)]
        turns += [("z", (0, 0, 0.07 * reach), 3.0)]
        end = ((0.0, 0.0, 0.03 * reach), (0.0, 0.0, 0.0))
    joints = [_Joint(axis, _rounded(origin), half) for axis, origin, half in turns]
    return joints, _rounded(end[0]), (float(end[1][0]), float(end[1][1]), float(end[1][2]))


def _rounded(point: tuple[float, ...]) -> Vector:
    x, y, z = (round(float(value), 5) for value in point)
    return x, y, z


def _links(
    random: np.random.Generator, reach: float, joints: list[_Joint], flange: Vector, folder: Path, *, holes: bool
) -> list[str]:
    """`<collision>` elements of base and links: along the path to the next joint, and about the joint itself."""
    ends = [*(np.array(joint.origin) for joint in joints), np.array(flange)]
    thick = np.linspace(0.085, 0.035, len(ends)) * reach * float(random.uniform(0.8, 1.1))
    found = []
    for number, end in enumerate(ends):
        if holes and 1 < number < len(ends) - 3 and random.random() < WITHOUT_GEOMETRY:
            found.append("")
            continue
        radius = float(thick[number])
        length = float(np.linalg.norm(end))
        text = ""
        if length > 1e-6:
            along = end / length
            # short of the next joint by what lets the link after it turn
            used = max(length - (0.3 * radius if number else 0.0), 0.5 * length)
            text += _collision(used / 2 * along, along, _shape(random, radius, used, folder, number))
        if 0 < number < len(ends) - 1:
            axis = np.eye(3)["xyz".index(joints[number - 1].axis)]
            text += _collision(
                np.zeros(3), axis, f'<cylinder radius="{0.9 * radius:.5f}" length="{1.6 * radius:.5f}"/>'
            )
        found.append(text)
    return found


def _shape(random: np.random.Generator, radius: float, length: float, folder: Path, number: int) -> str:
    """A shape along z of about that radius and length."""
    kind = random.choice(["cylinder", "box", "mesh", "sphere"], p=[0.4, 0.3, 0.2, 0.1])
    if kind == "sphere":
        return (
            f'<sphere radius="{max(0.5 * length, 0.5 * radius):.5f}"/>'
            if length < 3 * radius
            else _cylinder(radius, length)
        )
    if kind == "box":
        sides = 1.6 * radius * random.uniform(0.8, 1.1, 2)
        return f'<box size="{sides[0]:.5f} {sides[1]:.5f} {length:.5f}"/>'
    if kind == "mesh":
        points = random.normal(size=(60, 3))
        points /= np.linalg.norm(points, axis=1)[:, None]
        points *= [1.1 * radius, 1.1 * radius, length / 2]
        name = f"link{number}.obj"
        hull = ConvexHull(points)
        rows = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
        rows += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in hull.simplices]
        (folder / name).write_text("\n".join(rows) + "\n")
        return f'<mesh filename="{name}"/>'
    return _cylinder(radius, length)


def _cylinder(radius: float, length: float) -> str:
    return f'<cylinder radius="{radius:.5f}" length="{length:.5f}"/>'


def _collision(middle: np.ndarray, along: np.ndarray, shape: str) -> str:
    """Return an element whose z axis is along a unit vector."""
    pitch = float(np.arccos(np.clip(along[2], -1, 1)))
    yaw = float(np.arctan2(along[1], along[0])) if abs(along[2]) < 1 - 1e-12 else 0.0
    place = " ".join(f"{value:.6f}" for value in middle)
    return f'<collision><origin xyz="{place}" rpy="0 {pitch:.9f} {yaw:.9f}"/><geometry>{shape}</geometry></collision>'


def _payload(random: np.random.Generator, reach: float) -> tuple[list[tuple[np.ndarray, str]], str]:
    """Shapes in the flange (middle, element), and the key of the cell that says so."""
    size = [round(float(value), 4) for value in reach * random.uniform(0.05, 0.22, 3)]
    box = '<box size="{} {} {}"/>'.format(*size)
    return [(np.array([0.0, 0.0, size[2] / 2]), box)], f"load_size_m = {size}"


def _payload_link(axes: int, load: list[tuple[np.ndarray, str]], flange: Vector, rpy: Vector) -> str:
    shapes = "".join(_collision(middle, np.array([0.0, 0.0, 1.0]), shape) for middle, shape in load)
    place, turn = (" ".join(f"{value:.9f}" for value in each) for each in (flange, rpy))
    return (
        f'<link name="payload"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        f'</inertial>{shapes}</link><joint name="rod" type="fixed"><parent link="link_{axes}"/><child link="payload"/>'
        f'<origin xyz="{place}" rpy="{turn}"/></joint>'
    )


def _upward(random: np.random.Generator, mounting: str) -> Vector:
    lean = {"upright": 0.0, "tilted": random.uniform(0.1, 0.7), "wall": np.pi / 2, "ceiling": np.pi}[mounting]
    towards = random.uniform(0, 2 * np.pi)
    x, y, z = np.sin(lean) * np.cos(towards), np.sin(lean) * np.sin(towards), np.cos(lean)
    return float(x), float(y), float(z)


def _floor(random: np.random.Generator, mounting: str, reach: float) -> float | None:
    """Half of the upright arms state no height; others are on a base, or inverted at a reach or more."""
    if mounting in ("wall", "ceiling"):
        return -round(float(random.uniform(0.8, 1.4)) * reach, 3)
    return None if random.random() < 0.5 else -round(float(random.uniform(0.0, 0.3)) * reach, 3)


def _boxes(random: np.random.Generator, reach: float) -> tuple[tuple[Vector, Vector], ...]:
    """Up to four boxes beside the arm, none of which reaches into fixed bodies."""
    found = []
    for _ in range(int(random.integers(0, 5))):
        size = reach * random.uniform(0.1, 0.5, 3)
        angle, away = random.uniform(0, 2 * np.pi), reach * random.uniform(0.5, 1.0)
        low = np.array([away * np.cos(angle), away * np.sin(angle), reach * random.uniform(-0.4, 0.8)]) - size / 2
        high = low + size
        nearest = np.clip(0.0, low[:2], high[:2])
        if np.linalg.norm(nearest) > 0.3 * reach:
            found.append((_rounded(tuple(low)), _rounded(tuple(high))))
    return tuple(found)


def _urdf(joints: list[_Joint], links: list[str], more: str) -> str:
    inertial = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    parts = [f'<link name="base_link">{inertial}{links[0]}</link>']
    for number, joint in enumerate(joints, start=1):
        axis = " ".join("1" if joint.axis == name else "0" for name in "xyz")
        place = " ".join(f"{value:.6f}" for value in joint.origin)
        parent = "base_link" if number == 1 else f"link_{number - 1}"
        parts.append(f'<link name="link_{number}">{inertial}{links[number]}</link>')
        parts.append(
            f'<joint name="joint_{number}" type="revolute"><parent link="{parent}"/><child link="link_{number}"/>'
            f'<origin xyz="{place}"/><axis xyz="{axis}"/>'
            f'<limit lower="{-joint.half_range}" upper="{joint.half_range}" effort="100" velocity="2"/></joint>'
        )
    return '<robot name="drawn">\n' + "\n".join(parts) + more + "\n</robot>\n"


def _toml(seed: int, keys: list[str], joints: list[_Joint], poses: int) -> str:
    axes = "".join(
        f"""
[[arm.axis]]
node_id = {number}
profile = "generic-cia402"
torque_constant_nm_per_a = {{ value = 0.5, source = "assumed" }}
gear_ratio = {{ value = 100, source = "assumed" }}
gear_efficiency = {{ value = 0.8, source = "assumed" }}
position_limit_rad = [{-joint.half_range}, {joint.half_range}]
speed_limit_rad_s = 0.8
torque_limit_nm = 400
"""
        for number, joint in enumerate(joints, start=1)
    )
    head = f'name = "space-{seed}"\n[bus.a]\ninterface = "virtual"\nchannel = "space"\n\n[[arm]]\nname = "main"\n'
    return head + 'bus = "a"\nrobot = "robot.urdf"\n' + "\n".join(keys) + "\n" + axes + f"\n[poses]\ncount = {poses}\n"
