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


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """Prior knowledge besides the measured rows, of fits at rest and in motion.

    Attributes
    ----------
    link_std : float or None
        Relative standard deviation of every link's mass in the robot model, and that of its first moment as a fraction
        of mass x link length: 0 = exact, infinite = ignored. None = not stated: the default at rest, chosen from the
        rows by a diagnosis in motion.
    known : label -> (mass [kg], x, y, z [m] in the last link) of loads that are known
    masses : label -> mass [kg] of loads whose mass is known and whose centre is to be estimated, from rows at rest
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
    masses: Mapping[str, float] = field(default_factory=dict)
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
    def weighed(self) -> tuple[str, ...]:
        """Labels of the loads with known mass."""
        return (*self.known, *self.masses)

    def of_robot(self, robot: Robot) -> Knowledge:
        """Return a copy with the default of the robot model where no standard deviation of the links is stated."""
        return replace(self, link_std=default_link_std(robot)) if self.link_std is None else self

    def without_load(self, label: str) -> Knowledge:
        """Return a copy with one known load as unknown."""
        return self.of_loads(name for name in self.weighed if name != label)

    def of_loads(self, labels: Iterable[str]) -> Knowledge:
        """Return a copy without the known loads of other labels."""
        there = set(map(str, labels))
        return replace(
            self,
            known={label: load for label, load in self.known.items() if label in there},
            masses={label: mass_kg for label, mass_kg in self.masses.items() if label in there},
        )

    def gear_ratios(self, axes: int) -> tuple[float, ...]:
        """Gear ratio of each axis; NaN where unknown."""
        return (np.nan,) * axes if self.gear_ratio is None else tuple(float(ratio) for ratio in self.gear_ratio)
