"""What an estimation is told beside the data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gateway.identify.links import parse_inertials
from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.result.result import Bare

Four = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One axis and a known lever: joint (from 1), column of the lever [m], gear, rated motor torque [Nm]."""

    joint: int
    lever: str
    gear_ratio: float
    gear_efficiency: float
    rated_torque_nm: float | None = None


@dataclass(frozen=True, slots=True)
class EstimateOptions:
    """How to estimate.

    Attributes
    ----------
    inertials : "exact", "ignore" or "prior:S"
        How far the robot model's inertials are trusted: S is the relative standard deviation of every link's mass, and
        that of its first moment as a fraction of mass x link length.
    known : label -> (mass [kg], x, y, z [m] in the last link)
        Loads that are known.
    masses : label -> mass [kg]
        Loads whose mass is known and whose centre is to be estimated, from rows at rest.
    bare : Bare or None
        Stored bare identification.
    gravity_m_s2 : base frame
    gain_std : (N,) relative standard deviation of the torque constants; None = as of a table that states none
    measured_gain : axes (N,) whose torque was calibrated on this arm; empty = none
    change : factor on the usual change of the torque readings between runs and while the arm warms up
    efficiency : gear efficiency of every axis, or one for all
        1 where the torque already stands behind the gear.
    coupling : (N, N) how gear outputs act on the joints, as of `Gears`; None = one to one
    coefficient : Coefficient or None
        Needed by that method alone.
    hull_radius_m : float or None
        A centre of mass further from the last link is reported; 0.4 of the arm's length if not given.
    pose_choice : (k, N) poses that may be asked for; None = any within the robot's joint limits
    """

    inertials: str = "ignore"
    known: Mapping[str, Four] = field(default_factory=dict)
    masses: Mapping[str, float] = field(default_factory=dict)
    bare: Bare | None = None
    gravity_m_s2: tuple[float, float, float] = STANDARD_GRAVITY_M_S2
    gain_std: tuple[float, ...] | None = None
    measured_gain: tuple[bool, ...] = ()
    change: float = 1.0
    efficiency: tuple[float, ...] = (1.0,)
    coupling: NDArray[np.float64] | None = field(default=None, compare=False)
    coefficient: Coefficient | None = None
    hull_radius_m: float | None = None
    pose_choice: NDArray[np.float64] | None = field(default=None, compare=False)

    def of_loads(self, labels: Iterable[str]) -> EstimateOptions:
        """The options without known loads that are not among these labels."""
        there = set(map(str, labels))
        return replace(
            self,
            known={label: load for label, load in self.known.items() if label in there},
            masses={label: mass_kg for label, mass_kg in self.masses.items() if label in there},
        )

    @property
    def trust(self) -> float:
        """Relative standard deviation of the inertials: 0 exact, infinite ignored."""
        return parse_inertials(self.inertials)
