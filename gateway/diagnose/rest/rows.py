"""Rest rows of a measured table as visits: both sides of a visit become half their sum and half their difference."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.identify.deviations import RestHalves
from gateway.identify.gross import find_gross, gross_findings, set_aside
from gateway.model.regressor import gravity_regressor
from gateway.model.rest import RestRows
from gateway.model.robot import Robot
from gateway.model.visits import pair_visits
from gateway.result.result import Finding, SetAside

Floats = NDArray[np.float64]


def rest_rows(table: Table, given: Floats | None) -> RestRows:
    """Visits of the rest rows of a table, at the angles of the secondary encoders where there are some.

    Parameters
    ----------
    table : Table
    given : array of shape (N,) or None
        Gear efficiencies; None where the table's torque already stands behind the gear.
    """
    efficiency = np.ones(table.tau_nm.shape[1]) if given is None else np.asarray(given, dtype=float)
    visits = pair_visits(table, efficiency)
    time_s = visits.time_s
    if np.isnan(time_s).any():
        time_s = np.arange(len(visits), dtype=float)
    seen = np.isfinite(visits.q_link_rad).all(axis=0)
    return RestRows(
        load=visits.load,
        pose=visits.pose,
        run=visits.run,
        time_s=time_s,
        q_rad=np.where(seen, visits.q_link_rad, visits.q_rad),
        sum_nm=visits.tau_nm,
        difference_nm=visits.band_nm,
        side=visits.direction.astype(float),
        two_sided=visits.two_sided,
        sample_std_nm=visits.tau_std_nm,
        temperature_c=visits.temperature_c,
        wind_up_rad=np.where(seen, visits.q_link_rad - visits.q_rad, np.nan),
        efficiency=efficiency,
    )


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

    def sound(self, rows: RestRows) -> RestRows:
        """The rows with these torques unmeasured."""
        if not self.mask.any():
            return rows
        return replace(
            rows,
            sum_nm=np.where(self.mask, np.nan, rows.sum_nm),
            difference_nm=np.where(self.mask, np.nan, rows.difference_nm),
        )


def set_gross_aside(rows: RestRows, robot: Robot, gravity_m_s2: Floats) -> Aside:
    """Gross torques of rest visits, from the visits alone."""
    halves = RestHalves(
        regressor=gravity_regressor(robot, rows.q_rad, gravity_m_s2),
        load=rows.load,
        time_s=rows.time_s,
        q_rad=rows.q_rad,
        sum_nm=rows.sum_nm,
        difference_nm=rows.difference_nm,
        side=rows.side,
        floor_nm=rows.sample_std_nm,
    )
    gross = find_gross(halves)
    entries = set_aside(gross, rows.run.tolist(), rows.load.tolist(), rows.pose.tolist())
    return Aside(gross.mask(rows.sum_nm.shape), entries, gross_findings(gross, entries))


def joined(parts: list[RestRows]) -> RestRows:
    """Visits of several tables as one, in the order given."""
    names = [name for name in RestRows.__slots__ if name not in ("efficiency", "__weakref__")]
    merged = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return RestRows(efficiency=parts[0].efficiency, **merged)
