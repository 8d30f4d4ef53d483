"""Assumptions about an arm before it was measured: torque noise, and a reference load for planning."""

from __future__ import annotations

import numpy as np

from gateway.model.regressor import load_regressor
from gateway.motion.workspace import BAND_SHARE, Workspace

#: Remaining share of the friction band after a two-sided approach, until a recording has measured it.
LEFT_SHARE = 0.2
#: Share of the heaviest possible load that the expected uncertainty refers to, if the cell names none.
REFERENCE_SHARE = 0.5
NOISE_SOURCE = f"assumed: {LEFT_SHARE:.0%} of the friction band, which is {BAND_SHARE:.1%} of each torque limit"


def assumed_noise_nm(workspace: Workspace) -> np.ndarray:
    """Return the assumed standard deviation (N,) [Nm] of a joint torque after friction compensation.

    It is a share of the torque limit, the same for both approach directions at rest and for motion.
    """
    return BAND_SHARE * LEFT_SHARE * workspace.torque_nm


def reference_load(workspace: Workspace, q_rad: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the heaviest load of the cell file, else half of what the free torque can carry."""
    if workspace.max_load is not None:
        return float(workspace.max_load[0]), workspace.max_load[1:] / workspace.max_load[0]
    com_m = workspace.points_m[0]
    per_kg = np.abs(load_regressor(workspace.robot, q_rad, workspace.gravity_m_s2) @ np.append(1.0, com_m))
    free_nm = (1.0 - workspace.rest_share) * workspace.torque_nm
    largest = np.maximum(per_kg.max(axis=0), 1e-9 * per_kg.max())
    return float(REFERENCE_SHARE * (free_nm / largest).min()), com_m
