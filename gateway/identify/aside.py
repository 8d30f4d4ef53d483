"""Outliers of rest visits that no fit uses, and their entries and findings in the result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.identify.gross import find_gross, gross_findings, set_aside
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import Visits
from gateway.result.result import Finding, SetAside


@dataclass(frozen=True, slots=True, eq=False)
class Aside:
    """Rejected torques of rest visits: mask (n, N), entries of the result, and findings."""

    mask: NDArray[np.bool_]
    entries: tuple[SetAside, ...] = ()
    findings: tuple[Finding, ...] = ()

    def among(self, first: int) -> tuple[SetAside, ...]:
        """Return the rejected torques of the visits from `first` on."""
        visits = np.argwhere(self.mask)[:, 0]
        return tuple(entry for entry, visit in zip(self.entries, visits, strict=True) if visit >= first)


def gross_aside(visits: Visits, robot: Robot, gravity_m_s2: ArrayLike) -> Aside:
    """Find the outliers of rest visits from the visits alone."""
    gross = find_gross(visits, gravity_regressor(robot, visits.q_rad, gravity_m_s2))
    entries = set_aside(gross, visits.run.tolist(), visits.load.tolist(), visits.pose.tolist())
    return Aside(gross.mask(visits.sum_nm.shape), entries, gross_findings(gross, entries))


def without_gross(visits: Visits, robot: Robot, gravity_m_s2: ArrayLike) -> tuple[Visits, Aside]:
    """Return the visits with outliers marked as not measured, and the outliers."""
    aside = gross_aside(visits, robot, gravity_m_s2)
    return visits.unmeasured(aside.mask), aside
