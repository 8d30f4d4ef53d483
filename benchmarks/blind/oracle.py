"""How well a load can be determined at all: the Bayesian linear model that is given everything but the numbers.

Half-sums are linear in the links, the load, the errors of the torque constants, the bias by direction, what efficiency
leaves, and the cogging. They are also linear in an amplitude of each true effect's torque curve. All of these have the
priors of the cell, the load and the amplitudes none. The noise of every row is known, outlier visits are known and
left out. The model is evaluated at the truth; `load_std` is the standard deviation of mass and centre.

`log_likelihood_ratios` is the evidence for each true effect. Half-differences take part in it: a constant, the loss per
transmitted torque and both courses of warm-up of each axis are their nuisances, and the only ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.arm import NatureArm
from benchmarks.nature.effect import Mechanism, TableRows, rows_of
from benchmarks.nature.levels import levels_of
from benchmarks.nature.measuring import OutlierVisit, equilibrium, quiet, reported_nm
from benchmarks.nature.nature_cell import NatureCell
from benchmarks.nature.strength import added, efficiency_slopes, halves
from sim.offline import PlannedVisit, gravity_columns

Floats = NDArray[np.float64]

STEP_RAD = 1e-5
#: A curve below this share of the floor is none.
NO_CURVE = 1e-6


def load_std(cell: NatureCell, visits: Sequence[PlannedVisit], outliers: Sequence[OutlierVisit]) -> Floats:
    """Standard deviation of mass [kg] and centre x, y, z [m] (4,) that these visits of a cell allow."""
    arm, rows = cell.arm, rows_of(visits)
    still = np.zeros_like(rows.q_rad)
    tau = equilibrium(arm, rows, cell.effects, still)[0][0::2]
    design, precision = design_of(arm, rows, cell.effects, tau)
    weight = weights_of(arm, rows, cell.effects, tau)
    for wrong in outliers:
        weight[wrong.visit] = without_axis(weight[wrong.visit], wrong.joint - 1)
    covariance = posterior(design, weight, precision)
    return centre_std(covariance[:4, :4], arm.load)


def log_likelihood_ratios(
    cell: NatureCell, visits: Sequence[PlannedVisit], outliers: Sequence[OutlierVisit]
) -> list[float]:
    """Log likelihood of the data at the true size of each effect over that without it, in expectation.

    Links, load, nuisances and the sizes of the other effects are estimated with their priors. Infinite for a mistake of
    wiring.
    """
    arm, rows = cell.arm, rows_of(visits)
    tau = equilibrium(arm, rows, cell.effects, np.zeros_like(rows.q_rad))[0][0::2]
    weight = np.concatenate([weights_of(arm, rows, cell.effects, tau), np.linalg.inv(_scatter(arm, rows, tau))])
    for wrong in outliers:
        for visit in (wrong.visit, wrong.visit + len(tau)):
            weight[visit] = without_axis(weight[visit], wrong.joint - 1)
    design, precision = design_of(arm, rows, (), tau)
    lost, std = _lost(cell, rows, tau)
    below, above = ((0, len(tau)), (0, 0), (0, 0)), ((len(tau), 0), (0, 0), (0, 0))
    design = np.concatenate([np.pad(design, below), np.pad(lost, above)], axis=2)
    precision = np.concatenate([precision, std**-2.0])
    curves = {number: _curve(arm, rows, effect) for number, effect in enumerate(cell.effects) if effect.wired is None}
    ratios = [float("inf")] * len(cell.effects)
    for number, curve in curves.items():
        others = [other[:, :, None] for place, other in curves.items() if place != number]
        columns = np.concatenate([design, *others], axis=2)
        covariance = posterior(columns, weight, np.concatenate([precision, np.zeros(len(others))]))
        score = np.einsum("vap,vab,vb->p", columns, weight, curve)
        size = np.einsum("va,vab,vb->", curve, weight, curve)
        ratios[number] = 0.5 * float(size - score @ covariance @ score)
    return ratios


def _curve(arm: NatureArm, rows: TableRows, effect: Mechanism) -> Floats:
    """What an effect adds to the half-sums and then to the half-differences (2 visits, 6) [Nm].

    The half-sums have the torque that it adds to the joints. Both have what the drives then report beyond an arm
    without the effect whose joints carry the same torque: losses that follow a torque do not depend on its cause.
    """
    stops, eta = quiet(arm, rows), arm.friction.declared_efficiency
    seen, carried = reported_nm(arm, rows, (effect,), stops)
    own = equilibrium(arm, rows, (), stops.angle_rad)[0]
    equal = Mechanism("", (), 0.0, on_joint=lambda _, tau: tau - carried)
    with_, without = halves(seen, eta), halves(reported_nm(arm, rows, (equal,), stops)[0], eta)
    half_sum = with_.half_sum_nm - without.half_sum_nm + (carried - own)[0::2]
    return np.concatenate([half_sum, with_.half_difference_nm - without.half_difference_nm])


def posterior(design: Floats, weight: Floats, precision: Floats) -> Floats:
    """Covariance (p, p) of parameters with columns (v, N, p), inverse noise covariances (v, N, N) and priors (p,)."""
    scale = np.sqrt(np.einsum("vap,vab,vbp->p", design, weight, design) + precision)
    scaled = design / scale
    information = np.einsum("vap,vab,vbq->pq", scaled, weight, scaled) + np.diag(precision / scale**2)
    return np.linalg.pinv(information, rcond=1e-13, hermitian=True) / np.outer(scale, scale)


def centre_std(covariance: Floats, load: Floats) -> Floats:
    """Standard deviation (4,) of [m, x, y, z] for a covariance (4, 4) of [m, hx, hy, hz], to first order."""
    mass, centre = load[0], load[1:] / load[0]
    jacobian = np.eye(4) / mass
    jacobian[0, 0] = 1.0
    jacobian[1:, 0] = -centre / mass
    return np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))


def design_of(arm: NatureArm, rows: TableRows, effects: Sequence[Mechanism], tau: Floats) -> tuple[Floats, Floats]:
    """Columns (visits, 6, p), the load's four first, and the prior precision (p,) of each, 0 where there is none."""
    q, time_s, loaded = rows.q_rad[0::2], rows.time_s[0::2], rows.loaded[0::2]
    each = np.eye(6)
    links = gravity_columns(arm.chain, q, arm.gravity_m_s2)
    band = arm.friction.band_nm(tau, time_s)
    common, split = efficiency_slopes(arm, rows)
    turn = arm.gear_ratio * q
    waves = [np.sin(turn), np.cos(turn), np.sin(2.0 * turn), np.cos(2.0 * turn)]
    parts = [
        (links[:, :, 20:] * loaded[:, None, None], np.full(4, np.inf)),
        (links, arm.links_std),
        (each * tau[:, :, None], arm.gain_std),
        (each * common[:, :, None], np.full(6, arm.friction.efficiency_std)),
        (each * split[:, :, None], np.full(6, arm.friction.split_std)),
        (each * band[:, :, None], np.full(6, arm.friction.bias_std)),
        *((each * wave[:, :, None], arm.cogging_std_nm) for wave in waves),
    ]
    for effect in effects:
        curve = added(arm, rows, effect).half_sum_nm if effect.wired is None else np.zeros_like(tau)
        if np.abs(curve / arm.floor_nm).max() > NO_CURVE:
            parts.append((curve[:, :, None], np.full(1, np.inf)))
    return np.concatenate([part for part, _ in parts], axis=2), np.concatenate([std for _, std in parts]) ** -2.0


def weights_of(arm: NatureArm, rows: TableRows, effects: Sequence[Mechanism], tau: Floats) -> Floats:
    """Inverse covariance (visits, 6, 6) of the half-sums: friction, noise, rounding, and the pose that is not met."""
    covariance = _scatter(arm, rows, tau)
    for axis in range(6):
        step = np.zeros_like(rows.q_rad)
        step[:, axis] = STEP_RAD
        more, less = (equilibrium(arm, rows, effects, step_)[0][0::2] for step_ in (step, -step))
        slope = (more - less) / (2.0 * STEP_RAD) * arm.repeat_rad[axis]
        covariance = covariance + slope[:, :, None] * slope[:, None, :]
    return np.linalg.inv(covariance)


def _scatter(arm: NatureArm, rows: TableRows, tau: Floats) -> Floats:
    """Covariance (visits, 6, 6) of the half-sums at an exact pose, and of the half-differences: friction and noise."""
    time_s = rows.time_s[0::2]
    cold = arm.friction.coulomb_nm * arm.friction.cold(time_s)
    noise = arm.noise_nm / np.sqrt(2.0 * arm.samples)
    rounding = np.where(arm.noise_nm > 0.5 * arm.resolution_nm, 0.0, arm.resolution_nm / np.sqrt(24.0))
    spread = arm.friction.half_sum_std_nm(arm.friction.band_nm(tau, time_s), cold)
    return np.eye(6) * (spread**2 + noise**2 + rounding**2)[:, :, None]


def _lost(cell: NatureCell, rows: TableRows, tau: Floats) -> tuple[Floats, Floats]:
    """Columns (visits, 6, q) of the half-differences alone, and their prior (q,): losses and warm-up."""
    friction, levels, each = cell.arm.friction, levels_of(cell.condition), np.eye(6)
    fading = np.exp(-rows.time_s[0::2, None] / friction.warm_s)
    loss = friction.mean_left * np.abs(tau)
    spread = np.ptp(levels.load_loss) / np.sqrt(12.0) + friction.efficiency_std
    parts = [
        (each * friction.coulomb_nm, np.inf),
        (each * loss[:, :, None], spread),
        *((each * friction.coulomb_nm * course[:, None, None], np.ptp(levels.warm_share)) for course in fading.T),
    ]
    columns = np.concatenate([np.broadcast_to(part, (len(tau), 6, 6)) for part, _ in parts], axis=2)
    return columns, np.repeat([std for _, std in parts], 6)


def without_axis(weight: Floats, axis: int) -> Floats:
    """Inverse covariance (6, 6) when the row of one axis is not there: its information conditioned away."""
    out = weight - np.outer(weight[:, axis], weight[axis]) / weight[axis, axis]
    out[axis] = out[:, axis] = 0.0
    return out
