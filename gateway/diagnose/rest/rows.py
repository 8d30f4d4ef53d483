"""Rest rows of a measured table as visits: both sides of a visit become half their sum and half their difference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.identify.aside import Aside, gross_aside
from gateway.identify.deviations import RestHalves
from gateway.model.regressor import gravity_regressor
from gateway.model.rest import OF_VISITS, RestRows
from gateway.model.robot import Robot
from gateway.model.visits import pair_visits

Floats = NDArray[np.float64]


def rest_rows(table: Table, given: Floats | None, coupling: Floats | None = None) -> RestRows:
    """Visits of the rest rows of a table, at the angles of the secondary encoders where there are some.

    Parameters
    ----------
    table : Table
    given : array of shape (N,) or None
        Gear efficiencies; None where the table's torque already stands behind the gear.
    coupling : array of shape (N, N) or None
        How gear outputs act on the joints, as of `gateway.model.visits.Gears`.
    """
    efficiency = np.ones(table.tau_nm.shape[1]) if given is None else np.asarray(given, dtype=float)
    visits = pair_visits(table, efficiency, coupling)
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
        coupling=coupling,
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
    return gross_aside(halves, rows.run, rows.pose)


def sound(rows: RestRows, aside: Aside) -> RestRows:
    """The visits with what was set aside unmeasured."""
    if not aside.mask.any():
        return rows
    return replace(rows, sum_nm=aside.sound(rows.sum_nm), difference_nm=aside.sound(rows.difference_nm))


def joined(parts: list[RestRows]) -> RestRows:
    """Visits of several tables as one, in the order given."""
    merged = {name: np.concatenate([getattr(part, name) for part in parts]) for name in OF_VISITS}
    return RestRows(efficiency=parts[0].efficiency, coupling=parts[0].coupling, **merged)
