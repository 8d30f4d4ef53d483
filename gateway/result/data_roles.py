"""Which measured data a result used, and for what: training data must not pass as validation.

A result stores its visits (rest) and a sample of its moving rows by role and load label, as rounded joint angles and
torques. Roles: `fit`; `chosen on` (held out, but the result changed because of it); `validation` (judged the result
alone). File names, labels, pose numbers, times and order are not compared. Two visits of one pose differ by the noise
of their torque, which is above a thousandth of it.

The numbers are compared with a tolerance instead of a hash. After an export with fewer decimals, a value at a rounding
boundary has another hash. A corrected constant changes every torque. Rows whose torques differ by one factor per
axis are therefore the same rows, if two visits agree on the factors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gateway.data.table import Table
from gateway.errors import DataUnusable
from gateway.result.values import Matrix, matrix

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Role -> load label -> `q_rad`, `tau_nm` of visits and `moving_q_rad`, `moving_tau_nm` of moving rows, (k, N) each.
Roles = Mapping[str, Mapping[str, Mapping[str, Matrix]]]

FIT: Final = "fit"
CHOSEN_ON: Final = "chosen on"
VALIDATION: Final = "validation"
#: Key of the provenance under which a diagnosis states the role of the rows that were held out.
HELD_ROLE: Final = "held_out_role"
#: Equal rows differ by less [rad], [Nm] and as a share of the torque: what four decimals leave.
ANGLE_RAD: Final = 1e-4
TORQUE_NM: Final = 1e-4
TORQUE_SHARE: Final = 1e-4
#: Decimals that are stored, finer than the tolerances.
DECIMALS: Final = 6
#: Moving rows of each load that are stored [-]: a few ten kilobytes.
MOVING_KEPT: Final = 256
#: Cell of the joint space [rad] by which moving rows are selected.
CELL_RAD: Final = 1e-3
#: Equal factors of two visits differ by less, as a share [-]: what six digits leave.
FACTOR_SHARE: Final = 1e-5
#: Pairs of visits of one posture [-] of which each states factors: those of a corrected torque constant.
FACTORS_TRIED: Final = 500


def torque_of(table: Table) -> Floats:
    """Return the torque (n, N) [Nm] of a table: joint side, else motor side; NaN where not measured."""
    return np.where(np.isnan(table.tau_nm), table.motor_torque_nm, table.tau_nm)


def roles_of(
    fitted: Table,
    held: Table | None = None,
    held_role: str | None = None,
    earlier: Roles | None = None,
    most_moving: int = MOVING_KEPT,
) -> Roles:
    """Return the data roles of a result.

    Parameters
    ----------
    fitted : Table
        Rows of the fit.
    held : Table, optional
        Rows held out of it.
    held_role : str, optional
        Role of these, instead of `validation`.
    earlier : Roles, optional
        Of a stored result of the unloaded arm that the fit used: what it was fitted to or chosen on counts as fitted.
    most_moving : int
        Moving rows of each load to store.
    """
    roles: dict[str, dict[str, dict[str, Matrix]]] = {}
    # moving rows with the smallest hashes of their cells of the joint space: a part of a run keeps those of the run
    factors = np.random.default_rng(1).integers(1, 2**62, fitted.axes)
    tables = [(FIT, fitted), *([] if held is None else [(held_role or VALIDATION, held)])]
    for role, table in tables:
        for label in np.unique(table.load).tolist():
            moving = table.take((table.load == label) & table.moving)
            if len(moving) > most_moving:
                hashes = np.round(moving.q_rad / CELL_RAD).astype(np.int64) @ factors
                moving = moving.take(np.unique(hashes, return_index=True)[1][:most_moving])
            entry = roles.setdefault(role, {}).setdefault(label, {})
            for kind, rows in (("", table.take((table.load == label) & ~table.moving)), ("moving_", moving)):
                for name, values in (("q_rad", rows.q_rad), ("tau_nm", torque_of(rows))):
                    if len(values):
                        entry[kind + name] = entry.get(kind + name, ()) + matrix(values.round(DECIMALS))
    for role in (FIT, CHOSEN_ON):
        for label, known in (earlier or {}).get(role, {}).items():
            entry = roles.setdefault(FIT, {}).setdefault(label, {})
            entry |= {name: entry.get(name, ()) + values for name, values in known.items()}
    return roles


def rows_in(roles: Roles, names: Sequence[str], kind: str, axes: int) -> tuple[Floats, Floats]:
    """Return the stored angles [rad] and torques [Nm], (k, N) each, of these roles; `kind`: "" or "moving_"."""
    entries = [entry for name in names for entry in roles.get(name, {}).values()]
    rows = [[row for entry in entries for row in entry.get(kind + key, ())] for key in ("q_rad", "tau_nm")]
    q_rad, tau_nm = (np.array([row for row in each if len(row) == axes], dtype=float) for each in rows)
    return q_rad.reshape(len(q_rad), axes), tau_nm.reshape(len(tau_nm), axes)


def same_rows(kind: str, q_rad: Floats, tau_nm: Floats, known_rad: Floats, known_nm: Floats) -> Mask:
    """Return a mask (n,) of the rows (n, N) that are among the known ones (k, N), by angle and torque.

    Only axes that are measured in all rows of both are compared; without any, no row is known. Visits (`kind` "") may
    have other constants.
    """
    axis = np.isfinite(tau_nm).all(axis=0) & np.isfinite(known_nm).all(axis=0)
    if not (len(q_rad) and len(known_rad) and axis.any()):
        return np.zeros(len(q_rad), dtype=bool)
    ours, theirs = tau_nm[:, axis], known_nm[:, axis]
    # a difference of 1 is the tolerance sqrt(TORQUE_NM^2 + (TORQUE_SHARE tau)^2)
    scaled = [
        np.hstack([angle / ANGLE_RAD, np.arcsinh(torque * (TORQUE_SHARE / TORQUE_NM)) / TORQUE_SHARE])
        for angle, torque in ((q_rad, ours), (known_rad, theirs))
    ]
    distance, _ = KDTree(scaled[1]).query(scaled[0], p=np.inf, distance_upper_bound=1.0)
    same = np.isfinite(distance)
    if kind:
        return same
    # visits whose torques are those of known ones times one factor per axis, on which another pair of visits agrees
    near = KDTree(known_rad).query_ball_point(q_rad, ANGLE_RAD, p=np.inf)
    pairs = np.array([(row, other) for row, others in enumerate(near) for other in others], dtype=int).reshape(-1, 2)
    one, two = ours[pairs[:, 0]], theirs[pairs[:, 1]]
    for row, other in pairs[:: len(pairs) // FACTORS_TRIED + 1]:
        crossed = one * theirs[other]
        size = np.abs(one) + np.abs(two) + np.abs(ours[row]) + np.abs(theirs[other]) + np.abs(crossed)
        agree = (np.abs(crossed - ours[row] * two) <= FACTOR_SHARE * size).all(axis=1)
        agree &= (pairs[:, 0] != row) & (pairs[:, 1] != other)
        same[pairs[agree, 0]] = True
        same[row] |= agree.any()
    return same


def used_rows(table: Table, roles: Roles, names: Sequence[str]) -> Mask:
    """Return a mask (n,) of the rows of a table that a result used in one of these roles."""
    used = np.zeros(len(table), dtype=bool)
    for kind, rows in (("", np.flatnonzero(~table.moving)), ("moving_", np.flatnonzero(table.moving))):
        known = rows_in(roles, names, kind, table.axes)
        used[rows] = same_rows(kind, table.q_rad[rows], torque_of(table)[rows], *known)
    return used


def refuse_used(table: Table, used: Mask, what: str) -> None:
    """Refuse validation rows that a fit has used.

    Parameters
    ----------
    table : Table
    used : bool array of shape (n,)
    what : str
        What used them, for the message.

    Raises
    ------
    DataUnusable
        With file and line of the first of them, and their number.
    """
    if used.any():
        kind, where = "samples in motion" if table.moving[used].all() else "visits", table.where(int(np.argmax(used)))
        raise DataUnusable(
            f"{where}: the first of {int(used.sum())} {kind} that were used by {what}, if under another label or pose"
            " number; they cannot validate it: leave them out, or measure again"
        )


def shared_rows(before: Roles, after: Roles) -> dict[str, Any]:
    """Return how many stored rows of `before` are in `after` too.

    `visits` and `moving_samples`: number by load label of `before`; `all`: no row of either is missing in the other.
    """
    shared: dict[str, Any] = {"visits": {}, "moving_samples": {}, "all": bool(before and after)}
    for one, other in ((before, after), (after, before)):
        for label, entry in [item for by_label in one.values() for item in by_label.items()]:
            for kind, key in (("", "visits"), ("moving_", "moving_samples")):
                axes = len(entry.get(kind + "q_rad", [()])[0])
                mine, theirs = (rows_in(each, list(each), kind, axes) for each in ({FIT: {label: entry}}, other))
                same = same_rows(kind, *mine, *theirs)
                shared["all"] &= bool(same.all())
                if one is before and same.any():
                    shared[key][label] = shared[key].get(label, 0) + int(same.sum())
    return shared
