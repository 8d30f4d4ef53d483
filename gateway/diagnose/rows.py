"""Rest rows of a measured table as visits: both sides of a visit become half their sum and half their difference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.data.table import Table
from gateway.model.terms.reading import RestRows, through_gear

Floats = NDArray[np.float64]
_SAME_RAD = 2e-3


def rest_rows(table: Table, efficiency: Floats) -> RestRows:
    """Visits of the rest rows of a table.

    Rows of one run, load and pose that stand at the same joint angles and were approached from opposite sides make one
    two-sided visit, in the order of time; each side goes through the gear by its own direction first.

    Parameters
    ----------
    table : Table
    efficiency : array of shape (6,)
        Gear efficiencies; 1 where the table's torque already stands behind the gear.
    """
    rest = np.flatnonzero(~table.moving)
    pairs: list[tuple[int, int | None]] = []
    groups: dict[tuple[str, str, int], list[int]] = {}
    for row in rest:
        groups.setdefault((str(table.run[row]), str(table.load[row]), int(table.pose[row])), []).append(int(row))
    for members in groups.values():
        pairs.extend(_pairs(table, members))
    pairs.sort(key=lambda pair: pair[0])
    return _visits(table, pairs, efficiency)


def _pairs(table: Table, members: list[int]) -> list[tuple[int, int | None]]:
    """Rows of one pose and load as (up, down) pairs, left-overs as (row, None)."""
    open_rows = sorted(members, key=lambda row: (np.nan_to_num(table.time_s[row]), row))
    if len(open_rows) == 2 and _facing(table, *open_rows):
        return [(open_rows[0], open_rows[1])]
    out: list[tuple[int, int | None]] = []
    while open_rows:
        row = open_rows.pop(0)
        partner = next((other for other in open_rows if _facing(table, row, other)), None)
        out.append((row, partner))
        if partner is not None:
            open_rows.remove(partner)
    return out


def _facing(table: Table, row: int, other: int) -> bool:
    """Whether two rows stand at one pose, approached from opposite sides."""
    facing = table.direction[row]
    if not facing.any() or (table.direction[other] != -facing).any():
        return False
    return bool(np.abs(table.q_rad[other] - table.q_rad[row]).max() < _SAME_RAD)


def _visits(table: Table, pairs: list[tuple[int, int | None]], efficiency: Floats) -> RestRows:
    first = np.array([pair[0] for pair in pairs], dtype=int)
    second = np.array([pair[0] if pair[1] is None else pair[1] for pair in pairs], dtype=int)
    two = first != second
    facing = table.direction.astype(float)
    torque = through_gear(table.tau_nm, facing, efficiency)
    one, other = torque[first], torque[second]
    # an axis that did not move on the approach of a two-sided visit has no side: its difference tells nothing
    sign = facing[first]
    difference = np.where(two[:, None] & (sign != 0), sign * (one - other) / 2.0, np.nan)
    std = table.tau_std_nm / np.sqrt(np.maximum(table.count, 1))[:, None]
    mean_std = np.where(two[:, None], np.hypot(std[first], std[second]) / 2.0, std[first])
    time = (table.time_s[first] + table.time_s[second]) / 2.0
    if np.isnan(time).any():
        time = np.arange(len(first), dtype=float)
    motor = (table.q_rad[first] + table.q_rad[second]) / 2.0
    link = (table.q2nd_rad[first] + table.q2nd_rad[second]) / 2.0
    seen = np.isfinite(link).all(axis=0)
    return RestRows(
        load=np.asarray(table.load)[first].astype(str),
        pose=table.pose[first],
        run=np.asarray(table.run)[first].astype(str),
        time_s=time,
        q_rad=np.where(seen, link, motor),
        sum_nm=(one + other) / 2.0,
        difference_nm=difference,
        side=np.where(two[:, None], 0.0, sign),
        two_sided=two,
        sample_std_nm=mean_std,
        temperature_c=(table.temperature_c[first] + table.temperature_c[second]) / 2.0,
        wind_up_rad=np.where(seen, link - motor, np.nan),
        efficiency=np.asarray(efficiency, dtype=float),
    )


def joined(parts: list[RestRows]) -> RestRows:
    """Visits of several tables as one, in the order given."""
    names = [name for name in RestRows.__slots__ if name not in ("efficiency", "__weakref__")]
    merged = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return RestRows(efficiency=parts[0].efficiency, **merged)
