"""Prior knowledge of an arm and its loads in numbers, as the cell file and the options of a command state it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.identify.links import LINK_STD, default_link_std
from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.model.robot import Robot
from gateway.result.result import Bare

Floats = NDArray[np.float64]

#: Relative standard deviation [-] of what is stated as exact, and of a centre as a length [m]: below the effect on any
#: torque.
EXACT = 1e-4
_EXACT_M = 1e-5


@dataclass(frozen=True, slots=True)
class WeighedLoad:
    """Statement on a load that the rows estimate: mass and centre of gravity with independent normal errors.

    Attributes
    ----------
    mass_kg, mass_std_kg : mass and its standard deviation; 0 = exact
    com_m : centre of gravity in the last link; None = not known
    com_std_m : standard deviation of each of its coordinates; 0 = exact
    """

    mass_kg: float
    mass_std_kg: float = 0.0
    com_m: tuple[float, float, float] | None = None
    com_std_m: float = 0.0

    @property
    def is_exact(self) -> bool:
        """Return whether neither mass nor centre has an error, where they are stated."""
        return self.mass_std_kg == 0.0 and self.com_std_m == 0.0

    def rows(self) -> tuple[Floats, Floats]:
        """Return rows (k, 4) and right side (k,) with unit standard deviation that [m, hx, hy, hz] satisfies.

        A centre is the linear condition `h - c m = 0` with the standard deviation of `m c` at the stated mass.
        """
        mass_std = max(self.mass_std_kg, EXACT * self.mass_kg)
        mass = np.array([[1.0, 0.0, 0.0, 0.0]]) / mass_std
        if self.com_m is None:
            return mass, np.array([self.mass_kg / mass_std])
        centre = np.column_stack([-np.array(self.com_m), np.eye(3)]) / (self.mass_kg * max(self.com_std_m, _EXACT_M))
        return np.vstack([mass, centre]), np.array([self.mass_kg / mass_std, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """Prior knowledge besides the measured rows, of fits at rest and in motion.

    Attributes
    ----------
    link_std : float or None
        Relative standard deviation of every link's mass in the robot model, and that of its first moment as a fraction
        of mass x link length: 0 = exact, infinite = ignored. None = not stated: the default at rest, chosen from the
        rows by a diagnosis in motion.
    known : label -> (mass [kg], x, y, z [m] in the last link) of loads that are known exactly
    weighed : label -> statement on a load that is not exact in all: it is estimated with that prior
    parts : label of a part -> labels of the gripper with the part and of the gripper alone
    bare : stored bare identification, or None
    gravity_m_s2 : base frame
    gain_std : (N,) relative standard deviation of the torque constants; None = as of a table that states none
    measured_gain : axes (N,) whose torque was calibrated on this arm, uneven losses included; empty = none
    change : factor on the standard deviation of changes of gain between runs and while the arm warms up
    efficiency : (N,) gear efficiencies not yet applied to the table's torque, or one for all; None = lossless
    coupling : (N, N) how gear outputs act on the joints, as of `Gears`; None = one to one
    gear_ratio : (N,), NaN where unknown; None = all unknown
    """

    link_std: float | None = None
    known: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)
    weighed: Mapping[str, WeighedLoad] = field(default_factory=dict)
    parts: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    bare: Bare | None = None
    gravity_m_s2: tuple[float, float, float] = STANDARD_GRAVITY_M_S2
    gain_std: tuple[float, ...] | None = None
    measured_gain: tuple[bool, ...] = ()
    change: float = 1.0
    efficiency: ArrayLike | None = None
    coupling: Floats | None = None
    gear_ratio: Floats | None = None

    @property
    def trust(self) -> float:
        """Relative standard deviation of the link masses in a fit: as stated, else the default."""
        return LINK_STD if self.link_std is None else self.link_std

    @property
    def stated_loads(self) -> dict[str, WeighedLoad]:
        """Statements on loads, by label: those that are known exactly, then the others."""
        exact = {label: WeighedLoad(mass, com_m=(x, y, z)) for label, (mass, x, y, z) in self.known.items()}
        return exact | dict(self.weighed)

    def of_robot(self, robot: Robot) -> Knowledge:
        """Return a copy with the default of the robot model where no standard deviation of the links is stated."""
        return replace(self, link_std=default_link_std(robot)) if self.link_std is None else self

    def without_load(self, label: str) -> Knowledge:
        """Return a copy with one known load as unknown."""
        return self.of_loads(name for name in self.stated_loads if name != label)

    def of_loads(self, labels: Iterable[str]) -> Knowledge:
        """Return a copy without the known loads of other labels."""
        there = set(map(str, labels))
        return replace(
            self,
            known={label: load for label, load in self.known.items() if label in there},
            weighed={label: load for label, load in self.weighed.items() if label in there},
        )

    def gear_ratios(self, axes: int) -> tuple[float, ...]:
        """Gear ratio of each axis; NaN where unknown."""
        return (np.nan,) * axes if self.gear_ratio is None else tuple(float(ratio) for ratio in self.gear_ratio)
