"""Strength of a mechanism in the half-sums and half-differences of an arm.

The torque that it adds to the half-sums is weighted by the floor of each axis and projected on everything that can take
it over: links with the prior they were drawn with, the load, gains, bias by direction and efficiency with theirs. The
strength is the RMS over the visits of what is left, on the axis where that is largest. For what it adds to the
half-differences: their RMS after removing each axis's mean, over the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.arm import NatureArm
from benchmarks.nature.effect import Mechanism, TableRows, rows_of
from benchmarks.nature.measuring import quiet, reported_nm
from sim.offline import PlannedVisit, gravity_columns

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Halves:
    """Half the sum and half the difference of both sides behind the declared gear (visits, 6) [Nm]."""

    half_sum_nm: Array
    half_difference_nm: Array


def halves(tau_nm: Array, declared_efficiency: Array) -> Halves:
    """Halves of reported torques (2 visits, 6), up and down in turn, each taken through the gear by its direction."""
    up, down = tau_nm[0::2], tau_nm[1::2]
    up = np.where(up > 0, up * declared_efficiency, up / declared_efficiency)
    down = np.where(down < 0, down * declared_efficiency, down / declared_efficiency)
    return Halves((up + down) / 2.0, (up - down) / 2.0)


def added(arm: NatureArm, rows: TableRows, effect: Mechanism) -> Halves:
    """Return the contribution of an effect to the halves, with equal stops and without noise."""
    stops, eta = quiet(arm, rows), arm.friction.declared_efficiency
    with_ = halves(reported_nm(arm, rows, (effect,), stops)[0], eta)
    without = halves(reported_nm(arm, rows, (), stops)[0], eta)
    return Halves(with_.half_sum_nm - without.half_sum_nm, with_.half_difference_nm - without.half_difference_nm)


def efficiency_slopes(arm: NatureArm, rows: TableRows) -> tuple[Array, Array]:
    """Change of the half-sums (visits, 6) [Nm] with the efficiency of each axis, and with half its split by direction.

    Beyond the band it is near a constant by the sign of the torque; within, both sides drive.
    """
    friction = arm.friction
    step = 1e-3

    def half_sums(both: float, split: float) -> Array:
        turned = replace(friction, driving=friction.driving + both + split, driven=friction.driven + both - split)
        seen = reported_nm(replace(arm, friction=turned), rows, (), quiet(arm, rows))[0]
        return halves(seen, friction.declared_efficiency).half_sum_nm

    return (half_sums(0.0, 0.0) - half_sums(-step, 0.0)) / step, (half_sums(0.0, 0.0) - half_sums(0.0, -step)) / step


@dataclass(frozen=True, slots=True)
class Absorbing:
    """What takes a torque in the half-sums over: weighted columns with their prior as rows, orthonormal."""

    basis: Array
    floor_nm: Array

    def left(self, half_sum_nm: Array) -> Array:
        """Half-sums (visits, 6) over the floor, less what links, load and nuisances take over."""
        target = (half_sum_nm / self.floor_nm).ravel()
        top = self.basis[: target.size]
        return (target - top @ (top.T @ target)).reshape(half_sum_nm.shape)

    def beside(self, curves: Sequence[Array]) -> Absorbing:
        """The same with the curves (visits, 6) [Nm] of other effects, each of free amplitude."""
        basis = self.basis
        for curve in curves:
            column = np.zeros(len(basis))
            column[: curve.size] = (curve / self.floor_nm).ravel()
            left = column - basis @ (basis.T @ column)
            size = float(np.linalg.norm(left))
            if size > 1e-9 * float(np.linalg.norm(column)):
                basis = np.column_stack([basis, left / size])
        return Absorbing(basis, self.floor_nm)


def absorbing(arm: NatureArm, visits: Sequence[PlannedVisit]) -> Absorbing:
    """What the visits of an arm can put into its links, its load and its nuisances."""
    rows = rows_of(visits)
    _, tau = reported_nm(arm, rows, (), quiet(arm, rows))
    q, loaded, tau = rows.q_rad[0::2], rows.loaded[0::2], tau[0::2]
    columns = gravity_columns(arm.chain, q, arm.gravity_m_s2)
    common, split = efficiency_slopes(arm, rows)
    bias = arm.friction.bias_std * arm.friction.coulomb_nm
    each = np.eye(6)
    priors = [
        columns * arm.links_std,
        each * (tau * arm.gain_std)[:, :, None],
        each * (common * arm.friction.efficiency_std)[:, :, None],
        each * (split * arm.friction.split_std)[:, :, None],
        each * (np.ones_like(tau) * bias)[:, :, None],
    ]
    free = columns[:, :, 20:] * loaded[:, None, None]
    parts = np.concatenate([*priors, free], axis=2) / arm.floor_nm[:, None]
    design = parts.reshape(-1, parts.shape[2])
    known = design.shape[1] - 4
    stacked = np.vstack([design, np.eye(known, design.shape[1])])
    return Absorbing(np.linalg.qr(stacked)[0], arm.floor_nm)


def strength(arm: NatureArm, rows: TableRows, effect: Mechanism, taken: Absorbing) -> float:
    """Strength of an effect as the text of the module defines it; infinite for a mistake of wiring."""
    if effect.wired is not None:
        return float("inf")
    more = added(arm, rows, effect)
    left = taken.left(more.half_sum_nm)
    apart = (more.half_difference_nm - more.half_difference_nm.mean(axis=0)) / arm.floor_nm
    return float(max(np.sqrt(np.mean(left**2, axis=0)).max(), np.sqrt(np.mean(apart**2, axis=0)).max()))


def strengths_beside(
    arm: NatureArm, visits: Sequence[PlannedVisit], rows: TableRows, effects: Sequence[Mechanism]
) -> tuple[float, ...]:
    """Strength of each effect beyond what the others of the same arm could take over as well."""
    taken = absorbing(arm, visits)
    curves = [np.zeros((len(visits), 6)) if e.wired else added(arm, rows, e).half_sum_nm for e in effects]
    return tuple(
        strength(arm, rows, effect, taken.beside([*curves[:place], *curves[place + 1 :]]))
        for place, effect in enumerate(effects)
    )
