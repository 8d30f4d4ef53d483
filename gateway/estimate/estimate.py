"""Convert a fit of rest visits into an estimate: named parameters, loads, torque by axis, unloaded-arm parameters.

Its plausibility: agreement between the poses, and centre of mass within reach of the flange.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.identify.knowledge import Knowledge
from gateway.identify.links import PER_LINK_AT_REST, link_prior
from gateway.identify.load_estimate import LoadEstimate
from gateway.identify.prior_loads import LOAD_NAMES, LOAD_UNITS
from gateway.identify.rest.linear import Fit, RestProblem
from gateway.identify.rest.rest_loads import load_estimates, nuisance_results, well_determined, widening
from gateway.identify.rest.rest_nuisance import KINDS
from gateway.model.base import BaseSet, rest_base
from gateway.model.regressor import gravity_names
from gateway.model.robot import Robot, reach_m
from gateway.result.numerals import half_width, holds_zero
from gateway.result.result import AxisMotion, Bare, Finding, NextMeasurement, NuisanceResult, SetAside
from gateway.result.values import matrix, numbers

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: Names and units of the nuisances in a list of parameters.
_NUISANCES = {"gain": ("gain", "1"), "bias": ("offset", "Nm"), "load_friction": ("loss", "1")}
#: Residual over the noise of other rows above which a load's data are refused.
CONTRADICTS = 5.0
_FAR = 0.5
_SHARE = 0.2
_HULL_SHARE = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class FittedRows:
    """Measured and modelled torque, n visits or instants by N axes [Nm]; NaN = not measured or not used.

    `std_nm` is the standard deviation of each torque in the fit. `leverage` is the share of the row's own noise that
    the fit absorbs, 0 to 1.
    """

    run: NDArray[np.str_]
    load: NDArray[np.str_]
    pose: NDArray[np.int_]
    time_s: Floats
    q_rad: Floats
    direction: NDArray[np.int_]
    tau_nm: Floats
    model_nm: Floats
    band_nm: Floats
    std_nm: Floats
    leverage: Floats

    @property
    def residual_nm(self) -> Floats:
        """Measured minus modelled torque (n, N)."""
        return self.tau_nm - self.model_nm

    @property
    def rms_nm(self) -> Floats:
        """Root mean square (N,) of the residual over the rows used; NaN where there is none."""
        left = self.residual_nm
        count = np.isfinite(left).sum(axis=0)
        total = np.nansum(left**2, axis=0)
        return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Result of one estimator.

    Attributes
    ----------
    method : str
    loads : tuple of LoadEstimate
    sigma_nm : array of shape (N,)
        Noise floor of a half-sum; NaN where not known.
    band_nm : array of shape (N,)
        Friction band of each axis; NaN where not seen.
    names, units : tuples of p str
    value, std : arrays of shape (p,)
        `std` is NaN for what the data do not determine.
    covariance : array of shape (p, p)
    rows : FittedRows or None
    rank : int
    condition : float
        Of the scaled, weighted columns.
    lumped : tuple of str
        Parameter combinations that the data cannot separate.
    bare : Bare or None
    findings : tuple of Finding
    next : tuple of NextMeasurement
    nuisance : mapping
        Nuisance parameters, by their names in the result.
    set_aside : tuple of SetAside
        Outliers that were rejected from the fit.
    motion : tuple of AxisMotion
        Friction, rotor inertia and delay of the axes that moved.
    quality : mapping
        Further figures for the report.
    """

    method: str
    loads: tuple[LoadEstimate, ...]
    sigma_nm: Floats
    band_nm: Floats
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    value: Floats = field(default_factory=lambda: np.zeros(0))
    std: Floats = field(default_factory=lambda: np.zeros(0))
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    rows: FittedRows | None = None
    rank: int = 0
    condition: float = np.nan
    lumped: tuple[str, ...] = ()
    bare: Bare | None = None
    findings: tuple[Finding, ...] = ()
    next: tuple[NextMeasurement, ...] = ()
    nuisance: Mapping[str, NuisanceResult] = field(default_factory=dict)
    set_aside: tuple[SetAside, ...] = ()
    motion: tuple[AxisMotion, ...] = ()
    quality: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class LinkColumns:
    """The 4 N link parameters [m, hx, hy, hz]: those with a prior, free ones, and base combinations of free ones."""

    held: Ints
    open: Ints
    base: BaseSet

    @staticmethod
    def of(robot: Robot, knowledge: Knowledge) -> LinkColumns:
        """Group the link parameters by the trust in the robot model's inertials that is stated."""
        _, std = link_prior(robot, knowledge.trust, PER_LINK_AT_REST)
        open_ = np.flatnonzero(np.isinf(std))
        return LinkColumns(
            np.flatnonzero(np.isfinite(std)), open_, rest_base(robot, knowledge.gravity_m_s2, open_.tolist())
        )


def describe(
    problem: RestProblem,
    fit: Fit,
    robot: Robot,
    knowledge: Knowledge,
    by_statement: Mapping[str, Floats] | None = None,
) -> Estimate:
    """Return the estimate for a fit of rest visits; `by_statement` as in `load_estimates`."""
    names, units, rows = zip(*_named(problem, LinkColumns.of(robot, knowledge), len(fit.scale)), strict=True)
    directions = np.array(rows)
    found = well_determined(problem, fit, directions)
    wide = widening(problem, fit, directions)
    covariance = directions @ fit.covariance @ directions.T * np.outer(wide, wide)
    value = directions @ fit.common
    return Estimate(
        method="joint",
        loads=load_estimates(problem, fit, robot, by_statement=by_statement),
        names=names,
        units=units,
        value=np.where(found, value, np.nan),
        std=np.where(found, np.sqrt(np.maximum(np.diag(covariance), 0.0)), np.nan),
        covariance=covariance,
        rows=fitted_rows(problem, fit),
        sigma_nm=axis_sigma(problem, fit),
        band_nm=fit.friction_band_nm,
        rank=fit.rank,
        condition=fit.condition,
        lumped=tuple(name for name, good in zip(names, found, strict=True) if not good),
        bare=bare_of(problem, fit, robot, knowledge),
        nuisance=nuisance_results(problem, fit),
        quality={"rows": len(problem.target), "parameters": len(names)},
    )


def _named(problem: RestProblem, links: LinkColumns, count: int) -> Iterator[tuple[str, str, Floats]]:
    """Return name, unit and linear function (count,) of each reported parameter.

    Links with a prior are reported one by one, free links as base parameters; then loads, friction bands and nuisance
    parameters.
    """
    everything = np.eye(count)
    for column in links.held:
        yield gravity_names(problem.axes)[column], LOAD_UNITS[column % PER_LINK_AT_REST], everything[column]
    for name, kept, combination in zip(links.base.names, links.base.indices, links.base.combination, strict=True):
        yield name, LOAD_UNITS[links.open[kept] % PER_LINK_AT_REST], combination @ everything[links.open]
    for index, label in enumerate(problem.labels):
        for name, unit, row in zip(LOAD_NAMES, LOAD_UNITS, everything[problem.load_part(index)], strict=True):
            yield f"{name}[{label}]", unit, row
    for axis in np.flatnonzero(problem.sided):
        yield f"friction[J{axis + 1}]", "Nm", everything[problem.band_part.start + axis]
    for kind, (name, unit) in _NUISANCES.items():
        start = problem.nuisance_part.start + KINDS.index(kind) * problem.axes
        for axis in np.flatnonzero(problem.use_sum.any(axis=0)):
            row = problem.gain_directions[axis] if kind == "gain" else everything[start + axis]
            yield f"{name}[J{axis + 1}]", unit, row


def fitted_rows(problem: RestProblem, fit: Fit) -> FittedRows:
    """Measured and modelled torque of every visit."""
    visits = problem.rows

    def spread(values: Floats) -> Floats:
        out = np.full(visits.sum_nm.shape, np.nan)
        out[problem.use_sum] = values[: int(problem.use_sum.sum())]
        return out

    return FittedRows(
        run=visits.run,
        load=visits.load,
        pose=visits.pose,
        time_s=visits.time_s,
        q_rad=visits.q_rad,
        direction=visits.side.astype(int),
        tau_nm=visits.sum_nm,
        model_nm=spread(problem.target - fit.residual),
        band_nm=visits.difference_nm,
        std_nm=spread(fit.noise.std[problem.group]),
        leverage=spread(fit.basis.leverage),
    )


def axis_sigma(problem: RestProblem, fit: Fit) -> Floats:
    """Typical standard deviation (N,) [Nm] of the half-sums of each axis; NaN where not measured."""
    rows = int(problem.use_sum.sum())
    std, axis = fit.noise.std[problem.group[:rows]], problem.axis[:rows]
    return np.array([np.median(std[axis == k]) if (axis == k).any() else np.nan for k in range(problem.axes)])


def bare_of(problem: RestProblem, fit: Fit, robot: Robot, knowledge: Knowledge) -> Bare | None:
    """Return the base gravity parameters of the unloaded arm, if rows and priors determine all of them."""
    base = rest_base(robot, knowledge.gravity_m_s2)
    rank, axes = base.rank, robot.axes
    # columns of effects come behind those that every hypothesis has
    directions = np.zeros((rank + 2 * axes, len(fit.scale)))
    directions[:rank, problem.link_part] = base.combination
    if not well_determined(problem, fit, directions[:rank]).all():
        return None
    measured = np.flatnonzero(problem.use_sum.any(axis=0))
    directions[rank + measured, : problem.n_common] = problem.gain_directions[measured]
    bias = problem.nuisance_part.start + KINDS.index("bias") * axes
    directions[rank + axes + measured, bias + measured] = 1.0
    wide = widening(problem, fit, directions)
    covariance = directions @ fit.covariance @ directions.T * np.outer(wide, wide)
    value = directions[:, : problem.n_common] @ fit.common
    value[rank:][~directions[rank:].any(axis=1)] = np.nan
    return Bare(
        robot=robot.name,
        gravity_m_s2=numbers(knowledge.gravity_m_s2),
        columns=tuple(base.indices.tolist()),
        names=base.names,
        value=tuple(value[:rank].tolist()),
        covariance=matrix(covariance[:rank, :rank]),
        combination=matrix(base.combination),
        offset_nm=tuple(value[rank + axes :].tolist()),
        gain=tuple(value[rank : rank + axes].tolist()),
        gain_covariance=matrix(covariance),
    )


def disagree(masses_kg: Sequence[float]) -> bool:
    """Return True if a fifth of the poses (at least two) give masses off the median by half of it or more."""
    values = np.asarray(masses_kg, dtype=float)
    if len(values) < 3:
        return False
    middle = float(np.median(values))
    far = int((np.abs(values - middle) > _FAR * abs(middle)).sum())
    return far >= max(2, int(np.ceil(_SHARE * len(values))))


def describe_masses(masses_kg: Mapping[str, float]) -> str:
    """Return the text for the range of the masses that single poses give."""
    values = np.array(list(masses_kg.values()))
    return f"{values.min():.3g} to {values.max():.3g} kg (median {np.median(values):.3g})"


def hull_radius_m(robot: Robot) -> float:
    """Distance from the last link within which a load's centre of mass is expected [m]."""
    return max(_HULL_SHARE * reach_m(robot), 0.1)


def physical_findings(load: LoadEstimate, frame: str, radius_m: float) -> list[Finding]:
    """Report implausible values of a load whose centre is given in the named frame; no value is changed."""
    where, out = f"load {load.label}", []
    if load.inertia is not None and not load.inertia.free:
        out.append(
            Finding("info", where,
                    "the unconstrained fit gives an inertia that no rigid body has; the nearest "
                    "physical inertia within the uncertainty is reported",
                    "turn the wrist faster, about more than one axis, where the inertia matters")
        )  # fmt: skip
    if holds_zero(load.mass_kg, load.mass_std_kg):
        return out  # nothing has no centre
    distance = float(np.linalg.norm(load.com_m))
    slack = half_width(float(np.linalg.norm(load.com_std_m))) if np.isfinite(load.com_std_m).all() else 0.0
    if np.isfinite(distance) and distance > radius_m:
        margin = "" if distance - slack > radius_m else ", but within its uncertainty it may be inside"
        out.append(
            Finding("warn", where,
                    f"centre of mass is {distance:.2f} m from {frame}, outside a sphere of {radius_m:.2f} m{margin}",
                    "not believable for a tool: the model may lack an effect")
        )  # fmt: skip
    return out
