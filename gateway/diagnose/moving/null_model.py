"""Null model, to which effects are added: columns and priors of an estimate in motion, and the noise of each axis.

Residuals of a moving run are autocorrelated, so n rows count as far fewer. The weight of each axis contains the share
of independent rows (integrated autocorrelation). The noise scale of an axis comes from a fit of that axis alone. A
scale from the residual of the tested model would reduce the weight of the very axis that lacks an effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.knowledge import Knowledge
from gateway.identify.motion.columns import NUISANCES, Columns, MovingSetup, moving_columns
from gateway.identify.motion.prior import held_to_friction
from gateway.identify.motion.problem import HELD_STD
from gateway.identify.nuisance import NUISANCE_STD
from gateway.identify.prior_loads import BARE_LABEL, unknown_labels
from gateway.identify.spread import counting_share
from gateway.model.base import moving_base
from gateway.model.motion import PER_BODY, Mask, Modelled, MovingRows, rounding_rad_s
from gateway.model.robot import SHORTEST_M
from gateway.model.term import Term

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Length of a column below which there is none.
NOTHING_NM = 1e-12
#: Nuisance parameters of a search. Delays are corrected in the rows before. Nonlinear losses and a friction that falls
#: from breakaway are effects to be named, so they are no nuisance parameters: with them 2 of 3 falls as large as
#: Coulomb friction are missed; without them a usual fall is reported as an effect on 10 of 37 simulated arms.
#: Gains of unstated uncertainty stay independent: with a common part the links would absorb a balancer.
SEARCHED: Final = (*NUISANCES, "bias", "run_friction", "load_inertia")
#: Standard deviation of a constant torque beside an unknown load, of the Coulomb level: of a third of an estimate's,
#: because blocks of time are predicted (J2 of the KR300: 178 Nm are left of blocks held out, against 205 Nm).
OFFSET_SHARE: Final = 0.03
#: Least Coulomb friction [-] over the torque of its axis: below, its scatter is lost in any noise.
LEAST_FRICTION: Final = 1e-3
#: Least length [-] of a link over the reach of the arm: wrists are short, and not points.
LEAST_LENGTH: Final = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class MovingNoise:
    """Noise scale (N,) [Nm] of the residual, and share (N,) of independent rows."""

    sigma_nm: Floats
    share: Floats

    @property
    def weight(self) -> Floats:
        """Weight (N,) of a row [1/Nm]."""
        return np.sqrt(self.share) / self.sigma_nm


def noise_of(motion: MovingRows, columns: Columns, terms: Sequence[Term], modelled: Modelled | None) -> MovingNoise:
    """Scale and share of each axis from a fit of that axis alone; 1 and 1 for unmeasured axes."""
    sigma, share = np.ones((2, motion.axes))
    for axis in np.flatnonzero(motion.measured):
        more = []
        for term in terms:
            axes = term.enters(motion.axes)
            if axis in axes and (modelled is not None or not term.modelled):
                more.append(term.columns(motion, modelled)[:, axes.index(axis)])  # type: ignore[arg-type]
        _, rest = axis_alone(motion, columns, int(axis), more)
        rows = motion.judged[:, axis] & ~motion.held_out
        floor = 1e-6 * max(float(np.abs(motion.tau_nm[rows, axis]).max()), 1e-6)
        sigma[axis] = max(float(np.sqrt(np.mean(rest**2))), floor)
        share[axis] = counting_share(rest)
    return MovingNoise(sigma, share)


def axis_alone(motion: MovingRows, columns: Columns, axis: int, more: Sequence[Floats] = ()) -> tuple[float, Floats]:
    """Coulomb friction [Nm] and residual (k,) of the fitted rows of one axis, from a fit of that axis alone.

    Its links, its loads and further columns (n, m) are free parameters.
    """
    rows = motion.judged[:, axis] & ~motion.held_out
    bodies = motion.rigid[:, axis]
    # a load left out would pass for noise where two of them differ
    labels = np.setdiff1d(motion.load[~motion.held_out], [BARE_LABEL])
    loaded = [bodies[:, -PER_BODY:] * (motion.load == label)[:, None] for label in labels]
    own = columns.design[:, axis, columns.lasting[axis]]
    matrix = np.column_stack([own, bodies, *loaded, *more])[rows]
    scale = np.linalg.norm(matrix, axis=0)
    there = scale > NOTHING_NM
    target, value = motion.tau_nm[rows, axis], np.zeros(len(scale))
    value[there] = np.linalg.lstsq(matrix[:, there] / scale[there], target, rcond=1e-6)[0] / scale[there]
    return float(value[0]), target - matrix @ value


def scaled_to(problem_noise: MovingNoise, residual_nm: Floats, judged: Mask) -> MovingNoise:
    """Return the noise with its common scale raised to the residual of the whole model (median over the axes)."""
    count = judged.sum(axis=0)
    there = count > 0
    square = (residual_nm**2 * judged).sum(axis=0)[there] / count[there]
    factor = float(np.sqrt(np.median(square / problem_noise.sigma_nm[there] ** 2)))
    return MovingNoise(problem_noise.sigma_nm * max(1.0, factor), problem_noise.share)


@dataclass(frozen=True, slots=True, eq=False)
class NullModel:
    """The model without effects.

    Attributes
    ----------
    columns : Columns
    trust : float or None
        Relative standard deviation of the CAD values; None = link parameters unknown.
    lines : for each axis, indices of its nonzero columns and those columns (n, k)
    sums : cached sums over rows, by the set of rows
    """

    columns: Columns
    trust: float | None
    lines: tuple[tuple[Ints, Floats], ...]
    sums: dict[bytes, Floats] = field(repr=False, default_factory=dict)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.lines)

    @property
    def friction(self) -> Ints:
        """Columns (N, 4) of Coulomb and viscous friction, rotor inertia and a constant torque of every axis."""
        return self.columns.lasting

    @property
    def gain(self) -> Ints:
        """Index of the gain (N,) of every axis among the parameters."""
        return self.columns.nuisances["gain"]

    @property
    def usual(self) -> Ints:
        """Indices of gains and load frictions (2 N,) among the parameters."""
        return np.concatenate([self.columns.nuisances[name] for name in NUISANCES])

    def std_of(self, index: int) -> float:
        """Standard deviation of the prior of a gain or load friction."""
        return float(self.columns.prior.stds(self.usual)[np.flatnonzero(self.usual == index)[0]])

    def beyond(self, index: int, value: float) -> bool:
        """Return True if a gain or load friction is at its prior limit and the rows pull it beyond."""
        off = abs(value - float(self.columns.prior.mean[index]))
        return index not in self.columns.taken and off > (1.0 - 1e-6) * NUISANCE_STD * self.std_of(index)

    def held(self, index: Ints, value: float) -> NullModel:
        """Return a copy with gains or load frictions fixed at a value, without other prior knowledge of them."""
        if not len(index):
            return self
        prior = self.columns.prior.freed(index).with_std(index, np.full(len(index), HELD_STD))
        mean = prior.mean.copy()
        mean[index] = value
        taken = np.union1d(self.columns.taken, index)
        return replace(self, columns=replace(self.columns, prior=replace(prior, mean=mean), taken=taken))

    def without_usual_of(self, terms: Sequence[Term]) -> NullModel:
        """Return a copy without the nuisance parameters that effects replace."""
        index = [self.columns.usual_of(term) for term in terms]
        return self.held(np.array([k for k in index if k is not None], dtype=int), 0.0)

    def trusting(self, trust: float) -> NullModel:
        """Return a copy with another relative standard deviation of the CAD values, if there are any."""
        prior, factor = self.columns.prior, np.ones(len(self.columns.prior.rows))
        if self.trust is None:
            return self
        factor[: len(self.columns.links)] = self.trust / trust  # what is known of the links comes first
        prior = replace(prior, rows=prior.rows * factor[:, None], right=prior.right * factor)
        return replace(self, columns=replace(self.columns, prior=prior), trust=trust)


def null_model(motion: MovingRows, trust: float | None, knowledge: Knowledge) -> NullModel:
    """Build the columns of rows for a relative standard deviation of the CAD values.

    A load without fitted rows has no columns. If the links are unknown and no row is of an unloaded arm or a known
    load, the first load is part of the last link.
    """
    fitted = motion.load[~motion.held_out]
    unknown = unknown_labels(motion.load, knowledge.known)
    seen = [label for label in unknown if label in fitted]
    lumped = trust is None and not knowledge.stated_loads and not (fitted == BARE_LABEL).any()
    free = seen[1:] if lumped else seen
    nothing = {label: (0.0, 0.0, 0.0, 0.0) for label in unknown if label not in free}
    stated = replace(
        knowledge,
        link_std=np.inf if trust is None else trust,
        known={**knowledge.known, **nothing},
    )
    setup = MovingSetup(smooth_rad_s=rounding_rad_s(motion.speed_rad_s), nuisances=SEARCHED)
    rows = replace(motion, tau_nm=np.where(motion.held_out[:, None], np.nan, motion.tau_nm))
    columns = moving_columns(rows, motion.robot, stated, setup)
    level_nm = np.array([_coulomb_nm(motion, columns, axis) for axis in range(motion.axes)])
    prior = held_to_friction(columns.prior, columns.names, level_nm, OFFSET_SHARE if columns.loads else np.inf)
    columns = replace(columns, prior=prior)
    if trust is None:
        columns = _of_plausible_size(columns, motion)
    return NullModel(columns, trust, tuple(_line(columns.design[:, axis]) for axis in range(motion.axes)))


def _line(columns: Floats) -> tuple[Ints, Floats]:
    """Mask of the nonzero columns (n, P) of one axis, and those columns."""
    there = np.flatnonzero(columns.any(axis=0))
    return there, np.ascontiguousarray(columns[:, there])


def _of_plausible_size(columns: Columns, motion: MovingRows) -> Columns:
    """Return the columns with unknown links limited to a plausible size.

    Blocks of rows are predicted from few others, which do not determine free links.
    """
    base, size = moving_base(motion.robot, motion.gravity_m_s2), _plausible_size(motion)
    spread = base.combination * size
    scale = np.linalg.norm(spread, axis=1)
    spread = spread / scale[:, None]
    root = np.linalg.cholesky(spread @ spread.T)
    own = np.linalg.inv(root) / scale
    rows = np.pad(own, ((0, 0), (0, len(columns.names) - len(own))))
    prior = columns.prior
    prior = replace(prior, rows=np.vstack([rows, prior.rows]), right=np.append(np.zeros(len(own)), prior.right))
    to_links = size[:, None] * (np.linalg.solve(root, spread).T @ own)  # the likeliest links of these combinations
    return replace(columns, prior=prior, to_links=to_links)


def _plausible_size(motion: MovingRows) -> Floats:
    """Prior standard deviation (10 N,) of the parameters of unknown links, from the torque of the arm.

    Each link is a body with the mass that the strongest axis can hold at half the reach, and of the link's length.
    """
    onward = np.linalg.norm(motion.robot.placement[1:, :3, 3], axis=1)
    reach = max(float(onward.sum()), SHORTEST_M)
    gravity = max(float(np.linalg.norm(motion.gravity_m_s2)), 1.0)
    mass = float(_torque_scale(motion).max()) / (gravity * 0.5 * reach)
    length = np.maximum(np.append(onward, 0.0), LEAST_LENGTH * reach)
    powers = np.array([0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0])
    return (mass * length[:, None] ** powers).reshape(-1)


def _torque_scale(motion: MovingRows) -> Floats:
    scale = np.sqrt((motion.tau_nm[~motion.held_out] ** 2).mean(axis=0))
    return np.where(scale > 0, scale, 1.0)


def _coulomb_nm(motion: MovingRows, columns: Columns, axis: int) -> float:
    """Coulomb friction [Nm] of one axis, at least a small share of the noise."""
    least = LEAST_FRICTION * float(_torque_scale(motion)[axis])
    moves = bool((motion.judged[:, axis] & ~motion.held_out).any())
    return max(abs(axis_alone(motion, columns, axis)[0]), least) if moves else least
