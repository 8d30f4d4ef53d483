"""Options and prior knowledge of a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.estimate.options import EstimateOptions
from gateway.identify.links import default_inertials
from gateway.model.effects import LIBRARY
from gateway.model.robot import Robot
from gateway.result.result import Bare, HoldoutKind

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DiagnoseOptions:
    """Options of a diagnosis.

    Attributes
    ----------
    inertials : "exact", "prior:S", "ignore"; None = prior:0.05 at rest if the robot model has inertials; in moving runs
        the value with the highest evidence
    known : label -> (mass [kg], x, y, z [m] in link 6) of loads that were weighed
    masses : label -> mass [kg] of weighed loads whose centre is to be estimated from rows at rest
    bare : stored bare identification
    holdout : rows to keep out of every fit
    holdout_kind : "given" (by the user) or "fresh" (measured afterwards)
    only, without : names of the only effects to try; of effects not to try
    gravity_m_s2 : gravity in the frame of the base
    gain_std : (N,) relative standard deviation of the torque constants; None = as of a table that states none
    measured_gain : axes (N,) whose torque was calibrated on this arm; empty = none
    change : factor on the usual change of the torque readings between runs and while the arm warms up
    efficiency : (N,) gear efficiencies not yet applied to the table's torque; None = lossless
    coupling : (N, N) how gear outputs act on the joints, as of `Gears`; None = one to one
    gear_ratio : (N,), NaN where unknown; None = all unknown
    pose_choice : (k, N) poses that may be recommended, or a function that returns them on demand;
        None = between the joint angles that were visited
    """

    inertials: str | None = None
    known: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)
    masses: Mapping[str, float] = field(default_factory=dict)
    bare: Bare | None = None
    holdout: Table | None = None
    holdout_kind: HoldoutKind = "given"
    only: frozenset[str] = frozenset()
    without: frozenset[str] = frozenset()
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, -9.80665)
    gain_std: tuple[float, ...] | None = None
    measured_gain: tuple[bool, ...] = ()
    change: float = 1.0
    efficiency: Floats | None = None
    coupling: Floats | None = None
    gear_ratio: Floats | None = None
    pose_choice: Floats | Callable[[], Floats | None] | None = None

    def as_estimate(self, robot: Robot) -> EstimateOptions:
        """Return the options of an estimate of the same rows."""
        efficiency = np.ones(1) if self.efficiency is None else np.asarray(self.efficiency, dtype=float)
        return EstimateOptions(
            inertials=default_inertials(robot) if self.inertials is None else self.inertials,
            known=self.known,
            masses=self.masses,
            bare=self.bare,
            gravity_m_s2=self.gravity_m_s2,
            gain_std=self.gain_std,
            measured_gain=self.measured_gain,
            change=self.change,
            efficiency=tuple(efficiency.tolist()),
            coupling=self.coupling,
        )

    @property
    def allowed(self) -> frozenset[str]:
        """Names of the effects that may be tried."""
        return (self.only or frozenset(LIBRARY)) - self.without

    def gear_ratios(self, axes: int) -> tuple[float, ...]:
        """Gear ratio of each axis; NaN where unknown."""
        return (np.nan,) * axes if self.gear_ratio is None else tuple(float(ratio) for ratio in self.gear_ratio)
