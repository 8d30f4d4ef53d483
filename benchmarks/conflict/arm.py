"""Random six-axis arms: geometry, links as they are and as the URDF states them, torque at rest by pinocchio."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray

Floats = NDArray[np.float64]

AXES = 6
GRAVITY_M_S2 = 9.80665
#: Relative standard deviation of a link's mass, and of its first moment over mass times length, about the URDF's.
LINK_STD = 0.05
#: Axis directions of the two families: ABB-like with a wrist of three crossing axes, UR-like with an offset wrist.
FAMILIES = (("z", "y", "y", "x", "y", "x"), ("z", "y", "y", "y", "z", "y"))
#: Shares of the arm's mass and of its reach, link by link.
MASS_SHARE = np.array([0.27, 0.31, 0.22, 0.11, 0.06, 0.03])
#: Rotations of the base frame against the world (roll, pitch, yaw) [rad].
MOUNTING = {"floor": (0.0, 0.0, 0.0), "wall": (0.0, np.pi / 2, 0.0), "ceiling": (np.pi, 0.0, 0.0)}


@dataclass(slots=True)
class LinkMasses:
    """Mass [kg] (6,) and centre of mass [m] (6, 3) of the links, each in its own frame."""

    mass_kg: Floats
    com_m: Floats

    def copy(self) -> LinkMasses:
        """The same links in arrays of their own."""
        return LinkMasses(self.mass_kg.copy(), self.com_m.copy())


@dataclass(frozen=True, slots=True)
class DrawnGeometry:
    """Joint origins [m] (6, 3), axes (letters), length of each link [m] (6,), mounting [rad] and limits [rad] (6,)."""

    origin_m: Floats
    axes: tuple[str, ...]
    length_m: Floats
    base_rpy_rad: tuple[float, float, float]
    limit_rad: Floats

    def urdf(self, links: LinkMasses, length_unit: float = 1.0) -> str:
        """URDF text with these links; `length_unit` = 1000 writes lengths in millimetres."""
        parts, parent = ['<robot name="drawn">', '<link name="base_link"/>'], "base_link"
        for i in range(AXES):
            size = 0.2 * self.length_m[i] * length_unit
            inertia = max(links.mass_kg[i], 0.0) * size**2
            letter = " ".join(str(int(axis == self.axes[i])) for axis in "xyz")
            turn = self.base_rpy_rad if i == 0 else (0.0, 0.0, 0.0)
            parts.append(
                f'<link name="link_{i + 1}"><inertial><origin xyz="{_text(length_unit * links.com_m[i])}" rpy="0 0 0"/>'
                f'<mass value="{links.mass_kg[i]:.17g}"/><inertia ixx="{inertia:.9g}" ixy="0" ixz="0"'
                f' iyy="{inertia:.9g}" iyz="0" izz="{inertia:.9g}"/></inertial></link>'
                f'<joint name="joint_{i + 1}" type="revolute"><parent link="{parent}"/><child link="link_{i + 1}"/>'
                f'<origin xyz="{_text(length_unit * self.origin_m[i])}" rpy="{_text(np.array(turn))}"/>'
                f'<axis xyz="{letter}"/><limit lower="{-self.limit_rad[i]:.6g}" upper="{self.limit_rad[i]:.6g}"'
                ' effort="100000" velocity="2"/></joint>'
            )
            parent = f"link_{i + 1}"
        return "".join([*parts, "</robot>"])


@dataclass(frozen=True, slots=True)
class RatedArm:
    """A drawn arm: rated load [kg], geometry, the links as they are and as its URDF states them."""

    rated_kg: float
    geometry: DrawnGeometry
    true: LinkMasses
    stated: LinkMasses


def draw_arm(rng: np.random.Generator, mounting: str = "floor") -> RatedArm:
    """Draw an arm of 3 to 200 kg rated load whose size, mass and links follow from it with scatter."""
    rated = float(np.exp(rng.uniform(np.log(3.0), np.log(200.0))))
    reach = 0.45 * rated**0.34 * rng.uniform(0.85, 1.2)
    crossing = rng.uniform() < 0.7
    upper, fore = reach * rng.uniform(0.38, 0.48), reach * rng.uniform(0.33, 0.43)
    wrist, side = reach * rng.uniform(0.07, 0.11), reach * rng.uniform(0.05, 0.09)
    base, shoulder, elbow = reach * rng.uniform(0.15, 0.35), reach * rng.uniform(0.0, 0.14), reach * rng.uniform(0, 0.1)
    if crossing:
        origin = [(0, 0, base), (shoulder, 0, 0.1 * reach), (0, 0, upper)]
        origin += [(0.4 * fore, 0, elbow), (0.6 * fore, 0, 0), (wrist, 0, 0)]
    else:
        origin = [(0, 0, base), (0, side, 0.1 * reach), (0, 0, upper), (fore, 0, 0), (0, side, 0), (0, 0, -wrist)]
    origin_m = np.array(origin, dtype=float)
    along = np.vstack([origin_m[1:], [(wrist, 0, 0) if crossing else (0, wrist, 0)]])
    length = np.maximum(np.linalg.norm(along, axis=1), 0.05 * reach)
    mass = rated * rng.uniform(3.5, 8.0) * MASS_SHARE * np.exp(0.2 * rng.standard_normal(AXES))
    com = along * rng.uniform(0.25, 0.6, (AXES, 1)) + 0.08 * length[:, None] * rng.standard_normal((AXES, 3))
    limit = np.radians([170.0, 75.0, 110.0, 170.0, 115.0, 175.0])
    geometry = DrawnGeometry(origin_m, FAMILIES[0 if crossing else 1], length, MOUNTING[mounting], limit)
    stated = LinkMasses(mass, com)
    return RatedArm(rated, geometry, scattered(rng, geometry, stated, LINK_STD), stated)


def scattered(rng: np.random.Generator, geometry: DrawnGeometry, links: LinkMasses, std: float) -> LinkMasses:
    """Links whose masses, and first moments over mass times length, scatter with a relative standard deviation."""
    size = links.mass_kg[:, None]
    mass = links.mass_kg * np.maximum(1.0 + std * rng.standard_normal(AXES), 0.1)
    moment = size * (links.com_m + std * geometry.length_m[:, None] * rng.standard_normal((AXES, 3)))
    return LinkMasses(mass, moment / mass[:, None])


def gravity_torque(
    geometry: DrawnGeometry, links: LinkMasses, q_rad: Floats, load: Floats | None, up: float = 1.0
) -> Floats:
    """Torque [Nm] (n, 6) that the actuators give at rest, by pinocchio.

    Parameters
    ----------
    geometry, links : the arm
    q_rad : array of shape (n, 6)
    load : array of shape (4,) or None
        Mass [kg] and centre [m] in the last link.
    up : float
        -1 where gravity points along the world's z axis.
    """
    model = pinocchio.buildModelFromXML(geometry.urdf(links))
    model.gravity.linear = np.array([0.0, 0.0, -up * GRAVITY_M_S2])
    if load is not None:
        body = pinocchio.Inertia(float(load[0]), np.array(load[1:]), np.zeros((3, 3)))
        model.inertias[AXES] = model.inertias[AXES] + body
    data = model.createData()
    return np.array([pinocchio.computeGeneralizedGravity(model, data, q) for q in q_rad])


def _text(values: Floats) -> str:
    return " ".join(f"{value:.17g}" for value in values)
