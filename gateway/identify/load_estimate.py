"""Load from its fitted parameters: mass and centre of gravity with covariance, and undetermined quantities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.inertia import LoadInertia
from gateway.identify.solve import ByGroup, Prior
from gateway.model.robot import Robot
from gateway.result.inertia import moments_of, tensor_of
from gateway.result.names import INERTIA_WHOLE
from gateway.result.numerals import half_width
from gateway.result.result import Finding, LoadResult
from gateway.result.values import matrix

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]
Names = NDArray[np.str_]

LOAD_PARTS = ("mass_kg", "com_x_m", "com_y_m", "com_z_m")
_AS_ZERO = 1e-9
#: Name of the finding of a refused load.
REFUSED: Final = "refused_load"
#: A mass that is negative by more standard deviations is refused: one load in a thousand by chance.
NEGATIVE_MASS_STD = 3.0
#: Mass of a part in standard deviations below which its centre, a quotient, has no normal error.
LEAST_PART_STD = 4.0
CONSTANTS: Final = "constants"
LINKS: Final = "links"
FRICTION: Final = "friction"
#: Source: gains that change between runs and while the arm warms up.
DRIFT: Final = "drift"
#: Sources: zero errors of the joints; a hose or cable that comes with the load.
ZEROS: Final = "zeros"
CABLE: Final = "cable"
#: Source: measured rows, and everything without a prior.
NOISE: Final = "noise"
#: Keys of a budget.
SOURCES: Final = (CONSTANTS, LINKS, FRICTION, DRIFT, NOISE)


@dataclass(frozen=True, slots=True, eq=False)
class LoadEstimate:
    """Estimate of one load: mass, centre of gravity, inertia, their uncertainty and what is not identifiable.

    Attributes
    ----------
    label : str
    mass_kg, mass_std_kg : float
        NaN where the data cannot give them.
    com_m, com_std_m : arrays of shape (3,)
        In the last link; 1.96 standard deviations hold the truth in 95 %.
    correlation : array of shape (4, 4)
        Of [mass, x, y, z], NaN where unidentifiable.
    covariance : array of shape (4, 4)
        Of [m, hx, hy, hz], as far as the data determine it.
    unidentifiable : tuple of str
        Of mass and centre of gravity.
    inertia : LoadInertia or None
        None where nothing moved.
    per_pose_mass_kg : mapping of pose number to mass
    budget : mapping of source to its share of the mass's variance, sum 1
    common_errors : mapping of a kind of prior to an array of shape (4, m)
        Of [mass, x, y, z] per standard deviation of an error that all measurements share.
    refused : str or None
        Why the data of this load contradict each other; everything else is NaN then.
    """

    label: str
    mass_kg: float
    mass_std_kg: float
    com_m: Floats
    com_std_m: Floats
    correlation: Floats
    covariance: Floats
    unidentifiable: tuple[str, ...] = ()
    per_pose_mass_kg: Mapping[str, float] = field(default_factory=dict)
    budget: Mapping[str, float] = field(default_factory=dict)
    common_errors: Mapping[str, Floats] = field(default_factory=dict)
    refused: str | None = None
    inertia: LoadInertia | None = None

    @property
    def moment(self) -> Floats:
        """First moment and mass [m, hx, hy, hz]."""
        return self.mass_kg * np.concatenate([[1.0], self.com_m])


def refused_load(label: str, reason: str, per_pose_mass_kg: Mapping[str, float] | None = None) -> LoadEstimate:
    """Return a load whose data contradict each other, with the reason."""
    return replace(unknown_load(label), per_pose_mass_kg=dict(per_pose_mass_kg or {}), refused=reason)


def refused_findings(
    loads: Iterable[LoadEstimate | LoadResult], advice: str = "check units, signs and labels of its rows"
) -> list[Finding]:
    """Return a failing finding for each load that was refused."""
    return [
        Finding("fail", f"load {load.label}", f"refused: {load.refused}", advice, REFUSED)
        for load in loads
        if load.refused
    ]


def negative_mass(mass_kg: float, std_kg: float) -> str | None:
    """Return the reason to refuse a mass that is significantly negative; None otherwise."""
    if mass_kg + NEGATIVE_MASS_STD * std_kg >= 0:
        return None
    return f"the fit gives a negative mass of {mass_kg:.3g} kg (standard deviation {std_kg:.2g} kg)"


def load_directions(moment: Floats) -> Floats:
    """Derivatives (4, 4) of [m, x, y, z] by [m, hx, hy, hz] at `moment` (4,)."""
    mass = moment[0] if abs(moment[0]) > _AS_ZERO else _AS_ZERO
    turn = np.zeros((4, 4))
    turn[0, 0] = 1.0
    turn[1:, 0] = -moment[1:] / mass**2
    turn[1:, 1:] = np.eye(3) / mass
    return turn


def load_from_moment(
    label: str,
    moment: Floats,
    covariance: Floats,
    widening: Floats,
    found: NDArray[np.bool_],
    longest_m: float,
    part_of: tuple[str, str] | None = None,
) -> LoadEstimate:
    """Compute mass and centre of gravity from [m, h] (4,) with covariance (4, 4).

    A mass below zero by more than its uncertainty is refused. A coordinate of the centre whose standard deviation
    exceeds the arm's own length is not known.

    Parameters
    ----------
    label : str
    moment, covariance : arrays of shape (4,), (4, 4)
    widening : array of shape (4,)
        Factor on the standard deviations of [m, x, y, z].
    found : bool array of shape (4,)
        Which of [m, x, y, z] the data determine.
    longest_m : float
        Length of the arm.
    part_of : tuple of str, optional
        Labels of the gripper with the part and of the gripper alone, where the load is their difference. Its mass is
        refused as negative from the end of its interval on, and gives no centre below `LEAST_PART_STD`.
    """
    turn = load_directions(moment)
    spread = turn @ covariance @ turn.T
    std = np.sqrt(np.maximum(np.diag(spread), 0.0))
    wide = std * widening
    if part_of is None and found[0] and (reason := negative_mass(float(moment[0]), float(wide[0]))) is not None:
        return refused_load(label, reason)
    if part_of is not None and found[0]:
        if moment[0] < -half_width(wide[0]):
            both, gripper = part_of
            reason = (
                f"'{both}' is lighter than '{gripper}' by {-moment[0]:.3g} kg (standard deviation {wide[0]:.2g} kg)"
            )
            return refused_load(label, f"{reason}: are the two labels of --part exchanged?")
        found = found & np.concatenate([[True], [bool(moment[0] >= LEAST_PART_STD * wide[0])] * 3])
    known = found & np.concatenate([[True], wide[1:] <= longest_m])
    value = np.where(known, np.concatenate([moment[:1], turn[1, 1] * moment[1:]]), np.nan)
    size = np.where(known & (std > 0), std, np.nan)
    correlation = spread / np.outer(size, size)
    np.fill_diagonal(correlation, np.where(known, 1.0, np.nan))
    wide = np.where(known, wide, np.nan)
    missing = tuple(name for name, good in zip(LOAD_PARTS, known, strict=True) if not good)
    return LoadEstimate(
        label,
        float(value[0]),
        float(wide[0]),
        value[1:],
        wide[1:],
        correlation,
        covariance,
        missing,
    )


def unknown_load(label: str) -> LoadEstimate:
    """Return a load that the data do not determine."""
    nothing, square = np.full(3, np.nan), np.full((4, 4), np.nan)
    return LoadEstimate(label, np.nan, np.nan, nothing, nothing, square, square, LOAD_PARTS)


def load_result(load: LoadEstimate, robot: Robot | None) -> LoadResult:
    """Entry of one load in the result file; in the flange's frame too, if the robot model has the flange."""
    known = np.isfinite(load.com_m)
    flange = None if robot is None else robot.flange
    reported = load.refused is None and np.isfinite(load.mass_kg)
    inertia = load.inertia if reported else None
    open_ = (INERTIA_WHOLE,) if inertia is None else inertia.unidentifiable
    return LoadResult(
        label=load.label,
        mass_kg=float(load.mass_kg),
        mass_std_kg=float(load.mass_std_kg),
        com_m=tuple(load.com_m.tolist()) if known.any() else None,
        com_std_m=tuple(load.com_std_m.tolist()) if known.any() else None,
        frame="link_6" if robot is None else robot.last_link,
        com_flange_m=None if flange is None or not known.all() else tuple(in_flange(load.com_m, flange).tolist()),
        correlation=matrix(load.correlation) if reported else None,
        unidentifiable=load.unidentifiable if load.refused is not None else (*load.unidentifiable, *open_),
        per_pose_mass_kg=dict(load.per_pose_mass_kg),
        budget=dict(load.budget),
        common_errors={name: matrix(values) for name, values in load.common_errors.items()},
        inertia_kg_m2=None if inertia is None else _some(inertia.value_kg_m2),
        inertia_std_kg_m2=None if inertia is None else _some(inertia.std_kg_m2),
        inertia_flange_kg_m2=None if inertia is None or flange is None else _in_flange(inertia.value_kg_m2, flange),
        refused=load.refused,
    )


def _in_flange(moments_kg_m2: Floats, flange: Floats) -> tuple[float, ...] | None:
    """Moments of inertia (6,) along the axes of the flange; None if one of them is unknown."""
    if not np.isfinite(moments_kg_m2).all():
        return None
    turn = flange[:3, :3]
    return moments_of(turn.T @ tensor_of(moments_kg_m2) @ turn)


def _some(values: Floats) -> tuple[float, ...] | None:
    """Return the numbers if at least one is known, else None."""
    return tuple(values.tolist()) if np.isfinite(values).any() else None


def in_flange(point_m: Floats, flange: Floats) -> Floats:
    """Transform a point (3,) of the last link into the frame of the flange with pose (4, 4)."""
    return flange[:3, :3].T @ (point_m - flange[:3, 3])


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """Source of the uncertainty of each row and each prior of a weighted problem.

    Attributes
    ----------
    row : str array of shape (n,)
        Source of each row.
    parameter : source -> array of shape (p,)
        Share of the prior's variance of each parameter that is of that source; of free ones it does not matter.
    further : str
        Source of the prior's further combinations.
    """

    row: Names
    parameter: Mapping[str, Floats]
    further: str = LINKS


def budget_of(
    design: ByGroup, prior: Prior, covariance: Floats, direction: Floats, sources: Sources
) -> Mapping[str, float]:
    """Return the share of the variance of `direction @ x` by source, with sum 1.

    The estimate is linear in the measured rows and in the prior's means, each of variance 1. The variance is the
    sum of the squares of its coefficients, `|direction C A^T|^2 + |direction C P^T|^2`, and every row and
    every prior belongs to one source.

    Parameters
    ----------
    design : columns (n, p)
        Of rows with unit variance.
    prior : Prior
    covariance : array of shape (p, p)
        Of the solution: the inverse of `A^T A + P^T P`.
    direction : array of shape (p,)
    sources : Sources

    Returns
    -------
    mapping
        Each of `SOURCES`; empty where nothing has a variance.
    """
    reach = covariance @ direction
    held = np.isfinite(prior.std)
    by_row = design.times(reach) ** 2
    by_prior = np.zeros(len(reach))
    by_prior[held] = (reach[held] / prior.std[held]) ** 2
    nothing = np.zeros(len(reach))
    total = {
        source: float(by_row[sources.row == source].sum() + by_prior @ sources.parameter.get(source, nothing))
        for source in SOURCES
    }
    total[sources.further] += float(((prior.rows @ reach) ** 2).sum())
    complete = sum(total.values())
    if not (np.isfinite(complete) and complete > 0.0):
        return {}
    return {source: value / complete for source, value in total.items()}


def budget_by_priors(lead: Floats, precision: Floats, sources: Mapping[str, Ints], variance: float) -> dict[str, float]:
    """Return the share of a variance by source, with sum 1, if all uncertainty except noise is in priors.

    `NOISE` is what the priors leave. With covariance `C` and prior precision `L` the variance `a C a` of `a x` is
    `a C A C a + a C L C a`, the first from the rows and the second from the priors, one term for each parameter.

    Parameters
    ----------
    lead : array of shape (p,)
        `C a`: covariance of the quantity with every parameter.
    precision : array of shape (p,) or (p, p)
        Of the prior of every parameter, 0 = free; a matrix where priors tie parameters together.
    sources : mapping of name to parameters (k,)
    variance : float
        Of the quantity, with what is beyond the model; nothing comes out where it is not above 0.
    """
    if not (np.isfinite(variance) and variance > 0.0):
        return {}
    part = lead * (precision * lead if precision.ndim == 1 else precision @ lead) / variance
    out = {name: float(part[index].sum()) for name, index in sources.items()}
    complete = max(sum(out.values()), 1e-300)
    known = min(complete, 1.0)
    return {name: share * known / complete for name, share in out.items()} | {NOISE: 1.0 - known}
