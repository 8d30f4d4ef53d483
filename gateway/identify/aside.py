"""Gross torques of rest visits set aside, and what the reader is told of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.identify.deviations import RestHalves
from gateway.identify.gross import find_gross, gross_findings, set_aside
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import Visits
from gateway.result.result import Finding, SetAside

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Aside:
    """Gross torques that are in no fit: where they stand (n, N), as the result lists them, and what to say of them."""

    mask: NDArray[np.bool_]
    entries: tuple[SetAside, ...] = ()
    findings: tuple[Finding, ...] = ()

    def among(self, first: int) -> tuple[SetAside, ...]:
        """The entries of visits from the `first` on."""
        visits = np.argwhere(self.mask)[:, 0]
        return tuple(entry for entry, visit in zip(self.entries, visits, strict=True) if visit >= first)

    def sound(self, torque_nm: Floats) -> Floats:
        """The torques (n, N), these as NaN: not measured."""
        return np.where(self.mask, np.nan, torque_nm)


def gross_aside(halves: RestHalves, run: NDArray[np.str_], pose: NDArray[np.int_]) -> Aside:
    """Gross torques of rest visits, from the visits alone; run and pose (n,) name them."""
    gross = find_gross(halves)
    entries = set_aside(gross, run.tolist(), halves.load.tolist(), pose.tolist())
    return Aside(gross.mask(halves.sum_nm.shape), entries, gross_findings(gross, entries))


def without_gross(visits: Visits, robot: Robot, gravity_m_s2: ArrayLike) -> tuple[Visits, Aside]:
    """The visits with gross torques unmeasured, and what was set aside."""
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
    aside = gross_aside(halves, visits.run, visits.pose)
    return replace(visits, tau_nm=aside.sound(visits.tau_nm), band_nm=aside.sound(visits.band_nm)), aside
