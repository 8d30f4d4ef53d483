"""What the caller of a diagnosis knows and wants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.result.result import Bare, HoldoutKind

Floats = NDArray[np.float64]

EFFECTS = frozenset(
    {"static_friction", "load_dependent_friction", "velocity_friction", "base_tilt", "joint_zero_offset"}
    | {"torque_constant_scale", "torque_offset", "thermal_drift", "balancer_spring", "cable_torque"}
    | {"joint_elasticity", "torque_ripple", "axis_coupling", "link_mass", "payload_shift"}
    | {"sign_reversed", "axes_swapped", "current_rms_peak"}
)


def _ones() -> Floats:
    return np.ones(6)


def _unknown() -> Floats:
    return np.full(6, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class DiagnoseOptions:
    """Options of a diagnosis.

    Attributes
    ----------
    inertials : "exact", "prior:S", "ignore"; None = at rest prior:0.05 where the robot has inertials, in moving runs
        the trust that the data themselves support
    known : label -> (mass [kg], x, y, z [m] in link 6) of loads that were weighed
    bare : stored bare identification
    holdout : rows that no fit may see
    holdout_kind : "given" (by the user) or "fresh" (measured afterwards)
    only, without : names of effects that alone are tried, that are not tried
    gravity_m_s2 : gravity in the frame of the base
    efficiency : (6,) gear efficiencies that the table's torque still has to go through
    gear_ratio : (6,), NaN where unknown
    pose_choice : (k, 6) poses that may be asked for; None = between the joint angles that were visited
    """

    inertials: str | None = None
    known: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)
    bare: Bare | None = None
    holdout: Table | None = None
    holdout_kind: HoldoutKind = "given"
    only: frozenset[str] = frozenset()
    without: frozenset[str] = frozenset()
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, -9.80665)
    efficiency: Floats = field(default_factory=_ones)
    gear_ratio: Floats = field(default_factory=_unknown)
    pose_choice: Floats | None = None

    @property
    def allowed(self) -> frozenset[str]:
        """Names of the effects that may be tried."""
        return (self.only or EFFECTS) - self.without
