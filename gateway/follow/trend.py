"""Check of the load in the feedforward: the torque residual regressed on the columns of the load.

    T = (u - J theta'') eta^(+-1)                                   measured torque behind the gear
    r = T - tau(arm + load) - friction                              residual of the feedforward model
    r = s Y_load phi_load + nuisance                                trend: the load is (1 + s) times as heavy as entered
    r = Y_load [dm, dh] + nuisance                                  trend with mass and first moment separate

Nuisance terms per axis: offset, Coulomb and viscous friction, one term proportional to the transmitted torque (error of
the gear losses), and one proportional to the axis' own acceleration. Friction changes sign with the direction of
motion; the load does not. A drive that interpolates linearly between targets changes its speed at each SYNC, and its
torque, sampled there, misses part of what accelerates the axis. So the load is identified by gravity.
Only rows in which an axis moves are used. Errors of neighbouring rows are correlated: the covariance is a
jackknife over blocks of time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.feedforward.load import FeedLoad
from gateway.follow.settings import FeedModel
from gateway.follow.track import Track
from gateway.identify.motion.prior import FRICTION, friction_columns
from gateway.identify.solve import ByGroup, Solution, determined, solve
from gateway.identify.spread import jackknife
from gateway.model.motion import SMOOTH_RAD_S
from gateway.model.regressor import regressor
from gateway.result.follow import FedTrend
from gateway.result.values import numbers

Floats = NDArray[np.float64]

#: Speed below which the direction of friction is uncertain [rad/s].
SLOW_RAD_S = 0.02
#: Number of time blocks of the jackknife.
BLOCKS = 24
LEAST_ROWS = 200
#: Relative size of a singular value below which the rows do not determine its direction.
TOLERANCE = 1e-3
#: Share of an undetermined direction in a parameter above which the parameter is not identifiable.
OPEN_SHARE = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """Load estimated from the torque of a pass, compared with the load in the feedforward.

    Attributes
    ----------
    values : FedTrend
        NaN where the path does not determine a value.
    load_nm, residual_nm : arrays of shape (n, 6)
        Torque of the load in the feedforward, and the residual without the nuisance terms; NaN if an axis does not
        move.
    """

    values: FedTrend
    load_nm: Floats
    residual_nm: Floats


def load_trend(track: Track, model: FeedModel, load: FeedLoad) -> Trend | None:
    """Regress the torque residual of a pass on the columns of the load.

    Parameters
    ----------
    track : Track
    model : FeedModel
    load : FeedLoad
        Load in the feedforward.

    Returns
    -------
    Trend or None
        None if too few rows move.
    """
    q, rate, acceleration = track.target_rad, track.velocity_rad_s, track.acceleration_rad_s2
    columns = regressor(model.robot, q, rate, acceleration, model.gravity_m_s2)
    to_gear = np.linalg.inv(model.coupling)
    arm, own = (rows @ to_gear for rows in (columns @ model.links, columns[:, :, 50:] @ load.parameters))
    rates, accelerations = rate @ model.coupling.T, acceleration @ model.coupling.T
    used = (np.abs(rates) > SLOW_RAD_S) & np.isfinite(track.torque_nm)
    used &= np.abs(np.gradient(np.sign(rates), axis=0)) == 0
    if used.sum() < LEAST_ROWS:
        return None
    measured = np.nan_to_num(track.torque_nm) * model.terms("torque_sign") * model.terms("ratio")
    fed = measured - model.terms("rotor_kg_m2") * accelerations
    behind = fed * model.terms("efficiency") ** np.sign(fed * rates)
    friction = model.friction_nm(arm + own, rates, np.sign(rates))
    residual = np.where(used, behind - friction - arm - own, 0.0)
    own_axis = np.eye(len(model.axes))
    lost = (np.sign(rates) * np.abs(arm + own))[:, :, None] * own_axis
    nuisance = np.concatenate([friction_columns(rates, accelerations, FRICTION, SMOOTH_RAD_S), lost], axis=2)
    moment = np.einsum("nij,ik->nkj", columns[:, :, 50:54], to_gear)
    # each axis is weighted by its residual without the load
    alone = _solved(residual, nuisance, used, np.ones(used.shape)).residual.reshape(used.shape)
    sigma_nm = np.sqrt((alone**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1))
    inverse = np.where(sigma_nm > 0, 1.0 / np.maximum(sigma_nm, 1e-9), 0.0)
    weight = np.broadcast_to(inverse, used.shape)
    scale, scale_std, left = _regressed(residual, own[:, :, None], nuisance, used, weight)
    change, stds, _ = _regressed(residual, moment, nuisance, used, weight)
    mass_kg = float(load.mass_kg + change[0])
    com_m = (load.mass_kg * load.com_m + change[1:]) / mass_kg
    return Trend(
        values=FedTrend(
            scale=float(scale[0]),
            scale_std=float(scale_std[0]),
            mass_kg=mass_kg,
            mass_std_kg=float(stds[0]),
            com_m=numbers(com_m),
            com_std_m=numbers(np.sqrt(stds[1:] ** 2 + (com_m * stds[0]) ** 2) / abs(mass_kg)),
            rms_nm=numbers(np.sqrt(np.sum(left**2, axis=0) / np.maximum(used.sum(axis=0), 1))),
        ),
        load_nm=np.where(used, own, np.nan),
        residual_nm=np.where(used, left + scale[0] * own, np.nan),
    )


def _solved(residual: Floats, columns: Floats, used: NDArray[np.bool_], weight: Floats) -> Solution:
    """Solve for `columns` (n, 6, k), whose rows are grouped by axis."""
    axis = np.tile(np.arange(used.shape[1]), len(used))
    design = ByGroup.of((columns * used[:, :, None]).reshape(axis.size, -1), axis)
    return solve(design, residual.ravel(), weight.ravel(), tolerance=TOLERANCE)


def _regressed(
    residual: Floats, columns: Floats, nuisance: Floats, used: NDArray[np.bool_], weight: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return values and standard deviations (k,) of `columns` (n, 6, k), and the residual (n, 6).

    A direction that the rows do not determine is NaN.
    """
    count, rows = columns.shape[2], len(columns)
    both = np.concatenate([columns, nuisance], axis=2)
    found = _solved(residual, both, used, weight)
    # change of the solution when each block of time is left out
    block = np.repeat(np.arange(rows) * BLOCKS // rows, used.shape[1])
    basis, left = found.basis.dense, found.residual * weight.ravel()
    parts = [(basis[block == number], left[block == number]) for number in range(BLOCKS)]
    changes = [np.linalg.lstsq(np.eye(found.rank) - own.T @ own, own.T @ rest)[0] for own, rest in parts]
    std = np.sqrt(np.diag(jackknife(np.array(changes) @ found.basis.inverse.T))[:count])
    known = np.where(determined(found, np.eye(count, both.shape[2]), OPEN_SHARE), 1.0, np.nan)
    return known * found.value[:count], known * std, found.residual.reshape(used.shape)
