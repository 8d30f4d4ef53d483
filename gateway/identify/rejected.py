"""Outliers of rest visits that no fit uses, and their entries and findings in the result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.identify.outliers import find_outliers, outlier_findings, set_aside
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import Visits
from gateway.result.result import Finding, SetAside


@dataclass(frozen=True, slots=True, eq=False)
class RejectedTorques:
    """Rejected torques of rest visits: mask (n, N), entries of the result, and findings."""

    mask: NDArray[np.bool_]
    entries: tuple[SetAside, ...] = ()
    findings: tuple[Finding, ...] = ()

    def among(self, first: int) -> tuple[SetAside, ...]:
        """Return the rejected torques of the visits from `first` on."""
        visits = np.argwhere(self.mask)[:, 0]
        return tuple(entry for entry, visit in zip(self.entries, visits, strict=True) if visit >= first)


def rejected_torques(visits: Visits, robot: Robot, gravity_m_s2: ArrayLike) -> RejectedTorques:
    """Find the outliers of rest visits from the visits alone."""
    found = find_outliers(visits, gravity_regressor(robot, visits.q_rad, gravity_m_s2))
    entries = set_aside(found, visits.run.tolist(), visits.load.tolist(), visits.pose.tolist())
    return RejectedTorques(found.mask(visits.sum_nm.shape), entries, outlier_findings(found, entries))


def without_outliers(visits: Visits, robot: Robot, gravity_m_s2: ArrayLike) -> tuple[Visits, RejectedTorques]:
    """Return the visits with outliers marked as not measured, and the outliers."""
    rejected = rejected_torques(visits, robot, gravity_m_s2)
    return visits.unmeasured(rejected.mask), rejected
