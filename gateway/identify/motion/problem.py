"""Rows of a moving run as a linear problem, axis by axis in an orthogonal basis, so that a solution does not pass over
all rows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array

from gateway.data.periods import uninterrupted
from gateway.data.rows import Table
from gateway.identify.motion.columns import NUISANCES, Columns
from gateway.identify.motion.prior import change_names
from gateway.identify.motion.stretches import Stretches
from gateway.identify.nuisance import NUISANCE_STD
from gateway.identify.solve import NOTHING, Prior, Solution, solve

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Mask = NDArray[np.bool_]

#: Share of the weight of a filter that must be on used rows: the rest is less than one row.
_USED_SHARE: Final = 0.98
_STEPS: Final = 12
_SETTLED: Final = 1e-6
#: Number of rounds in which parameters are bounded; a bound may move others beyond theirs.
LIMIT_PASSES: Final = 3
#: Standard deviation of a parameter at its bound.
HELD_STD: Final = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Contrasts:
    """Transform rows of several loads at the same phase of one motion into their mean and their differences.

    Errors of the arm's model are equal in all of them, so they are in the mean only. The differences determine the
    loads by far best, and have their own weight.

    Attributes
    ----------
    rows : tuple of int arrays of shape (loads, n)
    """

    rows: tuple[Ints, ...] = ()

    def of_axis(self, used: Mask) -> tuple[tuple[Ints, csr_array], tuple[Ints, csr_array]]:
        """Transformation of rows (n,) of one axis that are `used` (n,) into means and differences.

        Both with the rows (k,) that stand for them, and a matrix (k, n). Where a load lacks a row of a phase, those of
        the others stay as they are.
        """
        alone, apart = used.copy(), np.zeros(len(used), dtype=bool)
        pieces = []
        for rows in self.rows:
            here = rows[:, used[rows].all(axis=0)]
            alone[here], apart[here[1:]] = False, True
            loads, count = here.shape
            for row, weights in zip(here, _orthonormal(loads), strict=True):
                pieces.append((np.repeat(weights, count), np.tile(row, loads), here.ravel()))
        single = np.flatnonzero(alone)
        pieces.append((np.ones(len(single)), single, single))
        weight, row, column = (np.concatenate(items) for items in zip(*pieces, strict=True))
        complete = csr_array((weight, (row, column)), shape=(len(used), len(used)))
        means, differences = np.flatnonzero(used & ~apart), np.flatnonzero(apart)
        return (means, complete[means]), (differences, complete[differences])


def _orthonormal(count: int) -> Floats:
    """Orthonormal rows (count, count), the first of equal numbers (Helmert)."""
    out = np.zeros((count, count))
    out[0] = 1.0
    for k in range(1, count):
        out[k, :k], out[k, k] = 1.0, -k
    return out / np.linalg.norm(out, axis=1)[:, None]


@dataclass(frozen=True, slots=True, eq=False)
class AxisRows:
    """Used rows of one axis, or their differences.

    `rows` (k,) are their indices. `turn` (k, n) filters all rows and transforms them into these. `there` (c,) are the
    columns that act on the axis. `basis` (k, m) is orthonormal. `factor` (m, c + 2) holds those columns, the known
    torque and the measured torque in that basis.
    """

    axis: int
    rows: Ints
    turn: csr_array
    there: Ints
    basis: Floats
    factor: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Still:
    """Information of rest visits on the parameters of the moving rows: `rows @ x = right` (k, p), (k,), unit noise."""

    rows: Floats
    right: Floats


@dataclass(frozen=True, slots=True, eq=False)
class MotionProblem:
    """Moving rows with their columns.

    Attributes
    ----------
    columns : Columns
    tau_nm, qd_rad_s : arrays of shape (n, N)
    used : bool array of shape (n, N)
    stretches : Stretches
    parts : tuple of AxisRows
        One an axis, two where there are differences; each has its own noise.
    still : Still or None
    """

    columns: Columns
    tau_nm: Floats
    qd_rad_s: Floats
    used: Mask
    stretches: Stretches
    parts: tuple[AxisRows, ...]
    still: Still | None = None

    @staticmethod
    def of(
        columns: Columns,
        moving: Table,
        used: Mask,
        contrasts: Contrasts,
        low_pass: csr_array | None = None,
        still: Still | None = None,
    ) -> MotionProblem:
        """Build the problem from the rows of a table at `used` (n, N), filtered by a matrix (n, n).

        A row is left out if its filter takes what is not used: rows near a reversal have another friction.
        """
        if low_pass is not None:
            used = used & (low_pass @ used.astype(float) > _USED_SHARE)
        parts = [
            part
            for axis in range(moving.axes)
            for part in _axis_rows(columns, moving.tau_nm[:, axis], axis, contrasts.of_axis(used[:, axis]), low_pass)
        ]
        stretches = Stretches.of(uninterrupted(moving), moving.time_s)
        return MotionProblem(columns, moving.tau_nm, moving.qd_rad_s, used, stretches, tuple(parts), still)


@dataclass(frozen=True, slots=True, eq=False)
class About:
    """Linearisation at a solution (p,): torque of the bodies, total torque, and the columns that depend on them.

    `torque_nm` (n, N) is the torque of the bodies, including known ones. `local` maps a name to the (n, N) column of
    each axis's own parameter. `effects` (n, N, k) are columns of effects that depend on the torque, or None. `moved_nm`
    (n, N) is the change by a delay beyond its column. `model_nm` (n, N) is the total modelled torque.
    """

    value: Floats
    torque_nm: Floats
    local: dict[str, Floats]
    effects: Floats | None
    moved_nm: Floats
    model_nm: Floats


def _axis_rows(
    columns: Columns, tau_nm: Floats, axis: int, parts: Iterable[tuple[Ints, csr_array]], low_pass: csr_array | None
) -> list[AxisRows]:
    design = columns.design[:, axis]
    size = np.abs(design).max(axis=0, initial=0.0)
    there = np.flatnonzero(size > NOTHING * size.max(initial=0.0))
    measured = np.isfinite(tau_nm)
    stacked = np.column_stack([design[:, there], columns.known_nm[:, axis], np.where(measured, tau_nm, 0.0)])
    if low_pass is not None:
        smooth = _of_measured(low_pass, measured)
        parts = [(rows, turn @ smooth) for rows, turn in parts]
    return [AxisRows(axis, rows, turn, there, *np.linalg.qr(turn @ stacked)) for rows, turn in parts if len(rows)]


def _of_measured(low_pass: csr_array, measured: Mask) -> csr_array:
    """Return the filter (n, n) that uses the `measured` rows (n,) alone."""
    if measured.all():
        return low_pass
    kept = csr_array(low_pass @ diags_array(measured.astype(float)))
    kept.eliminate_zeros()
    total = np.asarray(kept.sum(axis=1))
    return csr_array(diags_array(1.0 / np.where(total > 0.0, total, 1.0)) @ kept)


def about(problem: MotionProblem, value: Floats) -> About:
    """Linearise at a solution (p,)."""
    columns, axes, last = problem.columns, problem.tau_nm.shape[1], problem.columns.first_effect
    none = np.zeros(axes)
    part = {name: value[index] for name, index in columns.nuisances.items()}
    bodies = columns.design[:, :, : columns.bodies] @ value[: columns.bodies]
    own = columns.design[:, :, columns.bodies : last] @ value[columns.bodies : last]
    torque = bodies + columns.known_nm
    gain, changes = part.get("gain", none), columns.changes
    if len(changes):
        gain = gain + value[changes][columns.occasion]
    complete = (1.0 + gain) * torque
    local = {"gain": torque}
    for k, name in enumerate(change_names(len(changes))):
        local[name] = torque * (columns.occasion == k)[:, None]
    lost, sign, moved = np.abs(torque), columns.sign, np.zeros_like(torque)
    if "delay" in columns.nuisances:
        delay = part["delay"]
        level = columns.dry(value)
        smooth = complete + own - level * columns.sign
        then, slopes = problem.stretches.earlier(np.hstack([smooth, problem.qd_rad_s, lost]), np.tile(delay, 3))
        (earlier, speed, lost), change = np.split(then, 3, axis=1), slopes[:, :axes]
        sign = np.tanh(speed / columns.smooth_rad_s)
        moved = earlier - smooth + level * (sign - columns.sign) + delay * change
        local["delay"] = -change
    local["load_friction"] = lost * sign
    local["loss_bend"] = part.get("load_friction", none) * _bent(lost) * sign
    local = {name: local[name] for name in columns.nuisances}
    model = complete + own + moved
    for name in ("load_friction", "loss_bend", "delay"):
        if name in local:
            model = model + part[name] * local[name]
    effects = columns.by_effects(value)
    if last < len(value):  # rows of effects are in step with the torque: no delay is theirs
        beside = columns.design[:, :, last:] if effects is None else columns.design[:, :, last:] + effects
        model = model + beside @ value[last:]
    return About(value, torque, local, effects, moved, model)


def _bent(lost_nm: Floats) -> Floats:
    """Derivative of sizes (n, N) by the exponent of their growth, about their mean."""
    share = lost_nm / np.maximum(lost_nm.mean(axis=0), 1e-9)
    return lost_nm * np.log(np.maximum(share, 1e-9))


def solved(problem: MotionProblem, here: About | None, sigma_nm: Floats, prior: Prior) -> Solution:
    """Solve the problem linearised at a solution (None: without nuisance parameters), with each part's `sigma_nm`."""
    parts = [in_basis(problem, part, here) for part in problem.parts]
    weight = [np.full(len(target), 1.0 / sigma) for sigma, (_, target) in zip(sigma_nm, parts, strict=True)]
    if problem.still is not None:
        parts.append((problem.still.rows, problem.still.right))
        weight.append(np.ones(len(parts[-1][1])))
    design, target = (np.concatenate(items) for items in zip(*parts, strict=True))
    return solve(design, target, np.concatenate(weight), prior)


def in_basis(problem: MotionProblem, mine: AxisRows, here: About | None) -> tuple[Floats, Floats]:
    """Columns (m, p) and target (m,) of one part in its basis and in the basis of the remaining rows."""
    columns, axis = problem.columns, mine.axis
    body = mine.there < columns.bodies
    inside, known, measured = mine.factor[:, :-2].copy(), mine.factor[:, -2], mine.factor[:, -1]
    if here is None:
        design = np.zeros((len(inside), len(columns.names)))
        design[:, mine.there] = inside
        return design, measured - known
    gain = here.value[columns.nuisances["gain"][axis]] if "gain" in columns.nuisances else 0.0
    bodies = inside[:, body] @ here.value[mine.there[body]]
    inside[:, body] *= 1.0 + gain
    others = [name for name in columns.nuisances if name != "gain"]
    reached = np.zeros(0, dtype=int) if here.effects is None else np.flatnonzero(here.effects[:, axis].any(axis=0))
    more = [] if here.effects is None else [here.effects[:, axis, reached]]
    outside = np.column_stack([*(here.local[name][:, axis] for name in others), *more, here.moved_nm[:, axis]])
    outside = mine.turn @ outside
    within = mine.basis.T @ outside
    beyond = np.asarray(np.linalg.qr(outside - mine.basis @ within, mode="r"), dtype=float)
    design = np.zeros((len(inside) + len(beyond), len(columns.names)))
    design[: len(inside), mine.there] = inside
    if "gain" in columns.nuisances:
        design[: len(inside), columns.nuisances["gain"][axis]] = bodies + known
    places = [*(columns.nuisances[name][axis] for name in others), *(columns.first_effect + reached)]
    for k, place in enumerate(places):
        design[:, place] = np.concatenate([within[:, k], beyond[:, k]])
    target = np.concatenate([measured - known + gain * bodies - within[:, -1], -beyond[:, -1]])
    return design, target


def part_columns(problem: MotionProblem, here: About, part: AxisRows) -> Floats:
    """Columns (k, p) of the rows of one part at a solution."""
    columns, axis = problem.columns, part.axis
    out = part.turn @ columns.design[:, axis]
    if "gain" in columns.nuisances:
        out[:, : columns.bodies] *= 1.0 + here.value[columns.nuisances["gain"][axis]]
    for name, index in columns.nuisances.items():
        out[:, index[axis]] = part.turn @ here.local[name][:, axis]
    if here.effects is not None:
        out[:, columns.first_effect :] += part.turn @ here.effects[:, axis]
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """Converged fit: its linearisation, its solution, and the solution without bounds."""

    here: About
    solution: Solution
    free: Solution


def settle(problem: MotionProblem, sigma_nm: Floats, start: About | None = None) -> Settled:
    """Solve to convergence with the standard deviation of each part, from a nearby solution if there is one.

    A gain multiplies the torque of all bodies, including known ones. Gains and losses are limited to their prior range;
    a larger value indicates an effect that the model lacks.
    """
    columns = problem.columns
    prior, used = columns.prior, problem.used
    solution = solved(problem, start, sigma_nm, prior)
    here = about(problem, solution.value)
    if not columns.nuisances:
        return Settled(here, solution, solution)
    for _ in range(_STEPS):
        before = here.model_nm[used]
        prior = columns.prior
        solution = solved(problem, here, sigma_nm, prior)
        for _ in range(LIMIT_PASSES):
            narrower = limited(columns, solution.value, prior)
            if narrower is prior:
                break
            prior = narrower
            solution = solved(problem, here, sigma_nm, prior)
        here = about(problem, solution.value)
        if np.linalg.norm(here.model_nm[used] - before) < _SETTLED * np.linalg.norm(problem.tau_nm[used]):
            break
    # at the same linearisation as `here`, also where the steps did not converge: the spread needs columns of one point
    return Settled(here, solution, solved(problem, here, sigma_nm, columns.prior))


def limited(columns: Columns, value: Floats, prior: Prior) -> Prior:
    """Return the prior with parameters bounded at their limit; the same object if no further one exceeds it."""
    held = [columns.nuisances[name] for name in NUISANCES if name in columns.nuisances]
    if not held:
        return prior
    usual = np.setdiff1d(np.concatenate(held), columns.taken)
    most = NUISANCE_STD * columns.prior.stds(usual)
    off = (value - columns.prior.mean)[usual]
    beyond = (np.abs(off) > most) & (prior.std[usual] > HELD_STD)
    if not beyond.any():
        return prior
    over, changed = usual[beyond], prior.mean.copy()
    changed[over] = columns.prior.mean[over] + np.sign(off[beyond]) * most[beyond]
    return replace(prior.with_std(over, np.full(len(over), HELD_STD)), mean=changed)
