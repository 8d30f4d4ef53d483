"""Commissioning mistakes: a torque sign, two drives in each other's place, an rms value taken for a peak value.

They wreck every other conclusion and are therefore looked for first: each is undone in the data, and the model without
effects is asked whether it likes the data better. Friction always opposes the approach, so a band below zero alone
proves a reversed sign.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from gateway.data.table import Table
from gateway.diagnose.rest.fit import fit
from gateway.diagnose.rest.linear import Fit, RestProblem
from gateway.diagnose.rest.problem import first_noise
from gateway.diagnose.rest.thresholds import REST
from gateway.model.effects.current_rms_peak import FACTOR
from gateway.model.unnamed import UNNAMED

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Mistake:
    """One mistake.

    Attributes
    ----------
    name : sign_reversed, axes_swapped or current_rms_peak
    joints : joints counted from 1
    factor : reported over true current (current_rms_peak), else 1
    with_positions : whether the positions of swapped axes are swapped too
    """

    name: str
    joints: tuple[int, ...]
    factor: float = 1.0
    with_positions: bool = False

    @property
    def handicap(self) -> float:
        """Log odds against the mistake beforehand: heavier links look like a factor on all axes at once."""
        return REST.common_mistake if len(self.joints) > 2 else 0.0

    def undo(self, table: Table) -> Table:
        """The table as it would read without the mistake."""
        axes = [joint - 1 for joint in self.joints]
        if self.name == "axes_swapped":
            return _swapped(table, axes, self.with_positions)
        factor = -1.0 if self.name == "sign_reversed" else 1.0 / self.factor
        scale = np.ones(table.tau_nm.shape[1])
        scale[axes] = factor
        return replace(table, tau_nm=table.tau_nm * scale, tau_std_nm=table.tau_std_nm * np.abs(scale))


def _swapped(table: Table, axes: list[int], with_positions: bool) -> Table:
    order = np.arange(table.tau_nm.shape[1])
    order[axes] = order[axes[::-1]]
    names = ["tau_nm", "tau_std_nm", "temperature_c"]
    if with_positions:
        names += ["q_rad", "direction", "q2nd_rad"]
    return replace(table, **{name: getattr(table, name)[:, order] for name in names})


def candidates(measured: NDArray[np.bool_]) -> Iterator[Mistake]:
    """Every single mistake on the measured axes."""
    axes = [int(axis) + 1 for axis in np.flatnonzero(measured)]
    for joint in axes:
        yield Mistake("sign_reversed", (joint,))
    for first, second in itertools.combinations(axes, 2):
        yield Mistake("axes_swapped", (first, second), with_positions=False)
        yield Mistake("axes_swapped", (first, second), with_positions=True)
    for factor in (FACTOR, 1.0 / FACTOR):
        for joint in axes:
            yield Mistake("current_rms_peak", (joint,), float(factor))
        if len(axes) > 1:
            yield Mistake("current_rms_peak", tuple(axes), float(factor))


def plain_score(problem: RestProblem, rows_scale: float) -> tuple[float, Fit]:
    """Evidence of the model without effects, less what a friction band below zero costs."""
    result = fit(problem, (), first_noise(problem), steps=3)
    return result.evidence + band_signs(problem, result) + rows_scale, result


def band_signs(problem: RestProblem, result: Fit) -> float:
    """Log probability that every friction band of a fit is positive."""
    seen = problem.by_group()[problem.axes :].reshape(2, -1).sum(axis=0) > 0
    return float(np.sum(norm.logcdf(_bands(problem, result)[seen])))


def _bands(problem: RestProblem, result: Fit) -> Floats:
    """Friction band (N,) of each axis in its own standard deviations."""
    return result.band / np.sqrt(np.maximum(np.diag(result.covariance)[problem.band_part], 1e-30))


def _over_floor(problem: RestProblem, result: Fit) -> float:
    """What a fit leaves of the half sums over what their sides leave, on the axis where that is most."""
    sums = np.unique(problem.group[problem.group < problem.axes])
    return float((result.noise.std[sums] / result.noise.start[sums]).max(initial=0.0))


def links_far_from_cad(problem: RestProblem, fitted: Fit) -> bool:
    """Whether a fit asks for links that are far from what the CAD says."""
    return float(np.sum(((fitted.links - problem.links) / problem.link_std) ** 2)) > REST.far_from_cad


def beyond_any_effect(problem: RestProblem, plain: Fit) -> bool:
    """Whether the model without effects fails so badly that a mistake is the first thing to look for."""
    return _over_floor(problem, plain) > REST.beyond_any_effect or band_signs(problem, plain) < -REST.beyond_any_effect


def suspicious(problem: RestProblem, plain: Fit) -> bool:
    """Whether the best hypothesis is so odd, or leaves so much, that a mistake is worth looking for."""
    backward = bool((_bands(problem, plain) < REST.negative_band).any())
    one_sided = not problem.rows.two_sided.all()
    gains = [abs(float(v[0])) for t, v in zip(plain.terms, plain.theta, strict=True) if t.scales_reading]
    unnamed = any(term.name == UNNAMED for term in plain.terms)
    odd = unnamed or one_sided or backward or max(gains, default=0.0) > REST.odd_gain
    return odd or _over_floor(problem, plain) > REST.suspicious or links_far_from_cad(problem, plain)


def find_mistakes(
    table: Table, build: Callable[[Table], RestProblem], allowed: frozenset[str]
) -> tuple[tuple[Mistake, ...], float]:
    """Mistakes whose undoing the model without effects likes better by `mistake` or more, most likely first.

    Parameters
    ----------
    table : Table
    build : table -> RestProblem
    allowed : names that may be given

    Returns
    -------
    mistakes, and by how much the logarithm of the evidence rose
    """
    found: list[Mistake] = []
    gained = 0.0
    problem = build(table)
    before, plain = plain_score(problem, 0.0)
    measured = np.asarray(problem.use_sum.any(axis=0))
    while len(found) < REST.most_mistakes and (not found or suspicious(problem, plain)):
        best: tuple[float, Mistake, RestProblem, Fit] | None = None
        for mistake in candidates(measured):
            if mistake.name not in allowed or any(set(mistake.joints) & set(old.joints) for old in found):
                continue
            changed = build(mistake.undo(table))
            scale = -float(np.sum(np.isin(changed.axis + 1, mistake.joints))) * np.log(mistake.factor)
            scale -= mistake.handicap
            value, result = plain_score(changed, scale)
            if mistake.handicap and links_far_from_cad(changed, result):
                continue  # a factor on all axes leaves links as the CAD has them, one heavy link does not
            if best is None or value > best[0]:
                best = value, mistake, changed, result
        if best is None or best[0] - before < REST.mistake:
            break
        gained += best[0] - before
        before, mistake, problem, plain = best
        table = mistake.undo(table)
        found.append(mistake)
    return tuple(found), gained
