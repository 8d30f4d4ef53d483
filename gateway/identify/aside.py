"""Rest visits without those that were found gross, and what the reader is told of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gateway.identify.deviations import RestHalves
from gateway.identify.gross import find_gross, gross_findings, set_aside
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import Visits
from gateway.result.result import Finding, SetAside


def without_gross(
    visits: Visits, robot: Robot, gravity_m_s2: ArrayLike
) -> tuple[Visits, tuple[SetAside, ...], tuple[Finding, ...]]:
    """The visits with gross torques unmeasured, the list of them, and the findings that name them."""
    halves = RestHalves(
        regressor=gravity_regressor(robot, visits.q_rad, gravity_m_s2),
        load=visits.load,
        time_s=visits.time_s,
        q_rad=visits.q_rad,
        sum_nm=visits.tau_nm,
        difference_nm=visits.band_nm,
        side=visits.direction.astype(float),
        floor_nm=visits.tau_std_nm,
    )
    gross = find_gross(halves)
    aside = set_aside(gross, visits.run.tolist(), visits.load.tolist(), visits.pose.tolist())
    mask = gross.mask(visits.tau_nm.shape)
    sound = replace(
        visits, tau_nm=np.where(mask, np.nan, visits.tau_nm), band_nm=np.where(mask, np.nan, visits.band_nm)
    )
    return sound, aside, gross_findings(gross, aside)
