"""Compute the next transform function from the corrections of past cycles (CN104379308 embodiments 2, 6, 7 and 8).

All is computed for every command at once, `T''[m] = inv(W_T_B1 B1_T''_E1) W_T_B2 B2_T''_E2` with commands and
representative corrections (eqs. (25) to (27)); the learning points are then taken from it.

Three hazards decide the form. A function that is rebuilt each cycle from the mean of the last R corrections applies
every correction R times and becomes unstable from R = 5 on: either it is rebuilt once per block of R cycles and the
store cleared, or the stored corrections are re-referenced to the new function. A correction is delayed against its
force, so the one `lead` later belongs to a command. Measured positions would teach the servo lag with the wrong sign (a
lag difference d enters as -d v where +d v is needed), so commands are the default source.

The representative correction of several cycles ([0180], [0189], claim 8) treats each component of the 6-vector by
itself. Corrections are a few millimetres and milliradians, and a mean of rotation matrices would not be a rotation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.learning_points import Selection
from gateway.pair.transform import Floats, apply_correction, log_rotation, relation
from gateway.pair.transform_function import TransformFunction, function_of_knots

Source = Literal["command", "measured", "master_measured"]
Schedule = Literal["block", "rereferenced"]


@dataclass(frozen=True, slots=True)
class Forgetting:
    """Learning with forgetting, per knot in coordinates about the first function (u_0 = 0).

    `u_(n+1) = (1 - gamma) u_n + phi e_n + psi (e_n - e_(n-1))/Tc` with the proposed change e_n. With trial gain g it
    converges if `|1 - gamma - g phi| < 1` (psi = 0), and it keeps the share `gamma/(gamma + g phi)` of the difference
    to the first function: forgetting buys robustness with residual force. gamma 0.02 to 0.1 and phi 0.3 to 0.8 are
    usual.
    """

    gamma: float = 0.0
    phi: float = 1.0
    psi_s: float = 0.0

    def __post_init__(self) -> None:
        if not (0.0 <= self.gamma < 1.0 and self.phi > 0.0) or not np.isfinite(self.psi_s):
            raise ConfigError(f"forgetting: gamma must be in [0, 1), phi above 0, got {self.gamma} and {self.phi}")
        if self.psi_s == 0.0 and not self.converges(1.0):
            raise ConfigError(f"forgetting: |1 - gamma - phi| = {abs(1 - self.gamma - self.phi):.3g} does not converge")

    def converges(self, trial_gain: float) -> bool:
        """Return whether trials converge when each removes the share `trial_gain` of the error (psi = 0)."""
        return abs(1.0 - self.gamma - trial_gain * self.phi) < 1.0

    def bias(self, trial_gain: float) -> float:
        """Return the share of the offset from the first function that is never learned."""
        return self.gamma / (self.gamma + trial_gain * self.phi)

    def update(self, present: Floats, change: Floats, change_before: Floats, cycle_s: float) -> Floats:
        """Return the next coordinates from the present ones, the proposed change and the previous one, all (..., 6)."""
        rate = (change - change_before) / cycle_s
        return (1.0 - self.gamma) * present + self.phi * change + self.psi_s * rate


@dataclass(frozen=True, slots=True)
class LearningRule:
    """Parameters of learning during cycles.

    Attributes
    ----------
    cycles : R, cycles that one representative correction stands for; 1 = every cycle (embodiment 2)
    kind : representative value
    schedule : "block" rebuilds once per R cycles and clears the store, "rereferenced" every cycle
    source : "command" (corrected commands), "measured" (present positions of both), or "master_measured" (for a
        master whose controller filters its commands: its present positions, the slave's corrected commands)
    lead_s : delay between a command and its correction; None = damping/stiffness + loop time
    smooth_s : width of the symmetric mean over the commands around the one that is read; what changes faster than the
        correction can follow would otherwise build up from update to update where learning points are close
    left_share : share of the correction for the force that was left at the end of a cycle, where it is known, that is
        learned at once; the chain's stiffness is known as an upper bound or badly
    figure : 14: the slave follows the master's corrected command; 15: the stored command plus the master's
        representative correction, which keeps the master's momentary correction away from the slave
    forgetting : Forgetting
    selection : where the learning points belong (embodiment 8); None = where the first function has its knots
    choice : "always" uses a learned function from the next cycle on, "convergence" once it has settled
    """

    cycles: int = 1
    kind: Kind = "mean"
    schedule: Schedule = "block"
    source: Source = "command"
    lead_s: float | None = None
    smooth_s: float = 0.06
    left_share: float = 0.7
    figure: Literal[14, 15] = 15
    forgetting: Forgetting = Forgetting()
    selection: Selection | None = None
    choice: Literal["always", "convergence"] = "always"

    def __post_init__(self) -> None:
        if self.cycles < 1:
            raise ConfigError(f"learning: at least 1 cycle per update, got {self.cycles}")
        if self.schedule not in get_args(Schedule):
            raise ConfigError(
                f"learning: schedule '{self.schedule}' is refused: rebuilding every cycle from the mean of the last R"
                " corrections applies each of them R times and is unstable from R = 5 on; use 'block' or 'rereferenced'"
            )
        if self.kind not in get_args(Kind) or self.source not in get_args(Source):
            raise ConfigError(f"learning: representative '{self.kind}' or source '{self.source}' is not known")
        if (self.lead_s is not None and not self.lead_s >= 0.0) or not self.smooth_s >= 0.0:
            raise ConfigError(
                f"learning: lead and smoothing must not be negative, got {self.lead_s}, {self.smooth_s} s"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Bases:
    """Bases of master and slave in the world (4, 4) [m]."""

    w_t_b1: Floats
    w_t_b2: Floats


def led(values: Floats, lead: int) -> Floats:
    """Return values (M, ...) shifted by `lead` commands; the last one is repeated at the end."""
    return values[np.minimum(np.arange(len(values)) + lead, len(values) - 1)]


def smoothed(values: Floats, width: int) -> Floats:
    """Symmetric moving mean of values (M, ...) over `2 width + 1` commands, fewer towards both ends: no phase shift."""
    count = len(values)
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    index = np.arange(count)
    half = np.minimum(width, np.minimum(index, count - 1 - index))
    size = (2 * half + 1).reshape((-1,) + (1,) * (values.ndim - 1))
    return (total[index + half + 1] - total[index - half]) / size


def raw_relation(bases: Bases, commands: Floats, slave_base: Floats, corrections: Floats) -> Floats:
    """Relation (M, 4, 4) of the corrected commands, eqs. (25) to (27).

    Parameters
    ----------
    bases : Bases
    commands, slave_base : arrays of shape (M, 4, 4)
        Master's command, and slave's command before its correction.
    corrections : array of shape (M, 2, 6)
        Representative corrections of master and slave.
    """
    first = apply_correction(commands, corrections[:, 0])
    second = apply_correction(slave_base, corrections[:, 1])
    return relation(bases.w_t_b1, first, bases.w_t_b2, second)


def local(relations: Floats, reference: Floats) -> Floats:
    """Coordinates (M, 6) of relations about a reference: `[P - P_ref; log(R_ref^T R)]`."""
    turn = np.swapaxes(reference[:, :3, :3], 1, 2) @ relations[:, :3, :3]
    return np.concatenate([relations[:, :3, 3] - reference[:, :3, 3], log_rotation(turn)], axis=1)


def from_local(coordinates: Floats, reference: Floats) -> Floats:
    """Relations (M, 4, 4) of coordinates (M, 6) about a reference (M, 4, 4)."""
    upright = np.concatenate([coordinates[:, :3], np.einsum("nij,nj->ni", reference[:, :3, :3], coordinates[:, 3:])], 1)
    return apply_correction(reference, upright)


def at_points(relations: Floats, s_m: Floats, points: np.ndarray) -> TransformFunction:
    """Function through the relations (M, 4, 4) at chosen commands; of commands at the same arc length the first is
    taken.
    """
    arc_m, first = np.unique(s_m[points], return_index=True)
    return function_of_knots(arc_m, relations[points[first]])


def largest_change(after: Floats, before: Floats) -> tuple[float, float]:
    """Return the largest displacement [m] and rotation [rad] between two sets of relations (n, 4, 4)."""
    difference = local(after, before)
    return (
        float(np.linalg.norm(difference[:, :3], axis=1).max()),
        float(np.linalg.norm(difference[:, 3:], axis=1).max()),
    )


Kind = Literal["mean", "weighted", "median", "mode"]
NEWEST_SHARE = 0.7
LEAST_FOR_MODE = 5


def representative(corrections: ArrayLike, kind: Kind) -> Floats:
    """Representative value of corrections.

    Parameters
    ----------
    corrections : array of shape (R, ...)
        Oldest cycle first.
    kind : "mean", "weighted" (weights 0.7^age), "median" or "mode" (half-sample mode; median below 5 cycles)

    Returns
    -------
    array of shape (...)

    Raises
    ------
    ConfigError
        Unknown kind, or no cycle.
    """
    values = np.asarray(corrections, dtype=float)
    if kind not in get_args(Kind):
        raise ConfigError(f"representative '{kind}' is none of {', '.join(get_args(Kind))}")
    if len(values) == 0:
        raise ConfigError("a representative needs at least one cycle")
    if kind == "mean":
        return values.mean(axis=0)
    if kind == "weighted":
        weight = NEWEST_SHARE ** np.arange(len(values) - 1, -1, -1)
        return np.tensordot(weight / weight.sum(), values, axes=(0, 0))
    if kind == "mode" and len(values) >= LEAST_FOR_MODE:
        return half_sample_mode(values)
    return np.median(values, axis=0)


def half_sample_mode(values: ArrayLike) -> Floats:
    """Mode (...) of samples (R, ...): the densest half is taken again and again (Robertson and Cryer, 1974)."""
    ordered = np.sort(np.asarray(values, dtype=float), axis=0)
    while len(ordered) > 3:
        half = (len(ordered) + 1) // 2
        spread = ordered[half - 1 :] - ordered[: len(ordered) - half + 1]
        start = np.argmin(spread, axis=0)
        rows = start[None] + np.arange(half).reshape((-1,) + (1,) * start.ndim)
        ordered = np.take_along_axis(ordered, rows, axis=0)
    if len(ordered) < 3:
        return ordered.mean(axis=0)
    lower, upper = ordered[1] - ordered[0], ordered[2] - ordered[1]
    mean_low, mean_high = ordered[:2].mean(axis=0), ordered[1:].mean(axis=0)
    return np.where(lower < upper, mean_low, np.where(upper < lower, mean_high, ordered[1]))
