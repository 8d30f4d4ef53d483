"""Commissioning mistakes at rest (wrong signs, swapped drives, coupled angles, rms taken as peak), and direct effects.

A mistake invalidates every other conclusion, so mistakes are searched first. Each is corrected in the data, and the
model without effects is fitted: its evidence and its prediction of left-out poses must improve. Friction opposes the
approach, so a negative friction band proves a reversed sign on an axis that was approached from both sides. On other
axes the sign of the band depends on what else the model lacks.

Two effects are measured directly, beside the search. A secondary encoder shows the elasticity of its joint. One-sided
visits with both approach directions show friction that differs by direction.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from gateway.data.table import Table
from gateway.diagnose.rest.holdout import Unseen, left_out, pose_of_rows, predicted
from gateway.diagnose.rest.rest_diagnosis_thresholds import REST
from gateway.diagnose.wind_up import elastic, wind_up
from gateway.identify.rest.hypothesis_fit import averaged_evidence, fit
from gateway.identify.rest.linear import Fit, RestProblem, certain_bands, modelled, visit_loads
from gateway.identify.rest.start_noise import first_noise
from gateway.model.effects.current_rms_peak import FACTOR
from gateway.model.unnamed import UNNAMED
from gateway.result.result import EffectResult, Evidence

Floats = NDArray[np.float64]

#: Draws of poses [-] that a limit is read from; more change it by less than a hundredth.
DRAWS = 400
#: Factor [-] by which readings of one axis may be off, and its noise floor with them.
MOST_FACTOR = 2.0


@dataclass(frozen=True, slots=True)
class Mistake:
    """One commissioning mistake.

    Attributes
    ----------
    name : sign_reversed, joint_reversed, axes_swapped, angles_coupled, zero_convention or current_rms_peak
    joints : joints counted from 1
    factor : reported over true current (current_rms_peak), else 1
    with_positions : whether the positions of swapped axes are swapped too
    sign : of the first joint's angle in the second one's column (angles_coupled)
    offset_rad : angle of the robot model less the reported one (zero_convention)
    ratio : RMS on left-out poses with it corrected over that of the uncorrected data; NaN = not tested
    """

    name: str
    joints: tuple[int, ...]
    factor: float = 1.0
    with_positions: bool = False
    sign: float = 1.0
    offset_rad: float = 0.0
    ratio: float = field(default=np.nan, compare=False)

    @property
    def handicap(self) -> float:
        """Prior log odds against the mistake: heavier links look like one factor on all axes."""
        return REST.common_mistake if len(self.joints) > 2 else 0.0

    def reading_of(self, axes: int) -> NDArray[np.int_]:
        """Index (N,) of the torque reading of each of N axes."""
        order = np.arange(axes)
        if self.name == "axes_swapped":
            swapped = [joint - 1 for joint in self.joints]
            order[swapped] = order[swapped[::-1]]
        return order

    def undo(self, table: Table) -> Table:
        """Return the table with the mistake corrected."""
        axes = [joint - 1 for joint in self.joints]
        if self.name == "axes_swapped":
            order = self.reading_of(table.tau_nm.shape[1])
            names = ["tau_nm", "tau_std_nm", "temperature_c"]
            if self.with_positions:
                names += ["q_rad", "direction", "q2nd_rad"]
            return replace(table, **{name: getattr(table, name)[:, order] for name in names})
        scale = np.ones(table.tau_nm.shape[1])
        if self.name == "angles_coupled":
            first, second = axes
            q_rad = table.q_rad.copy()
            q_rad[:, second] -= self.sign * q_rad[:, first]
            return replace(table, q_rad=q_rad)
        if self.name == "zero_convention":
            turned = {}
            for name in ("q_rad", "q2nd_rad"):
                turned[name] = getattr(table, name).copy()
                turned[name][:, axes] += self.offset_rad
            return replace(table, **turned)
        scale[axes] = 1.0 / self.factor if self.name == "current_rms_peak" else -1.0
        if self.name == "joint_reversed":
            columns = {name: getattr(table, name) for name in ("q_rad", "q2nd_rad", "direction")}
            table = replace(table, **{name: np.where(scale < 0, -values, values) for name, values in columns.items()})
        return replace(table, tau_nm=table.tau_nm * scale, tau_std_nm=table.tau_std_nm * np.abs(scale))


def candidates(measured: NDArray[np.bool_]) -> Iterator[Mistake]:
    """Return every single mistake on the measured axes."""
    axes = [int(axis) + 1 for axis in np.flatnonzero(measured)]
    for joint in axes:
        yield Mistake("sign_reversed", (joint,))
        yield Mistake("joint_reversed", (joint,))
    for first, second in itertools.combinations(axes, 2):
        yield Mistake("axes_swapped", (first, second), with_positions=False)
        yield Mistake("axes_swapped", (first, second), with_positions=True)
    for first in axes[:-1]:
        for sign in (1.0, -1.0):
            yield Mistake("angles_coupled", (first, first + 1), sign=sign)
    for joint in axes:
        for quarters in (1, 2, 3):
            yield Mistake("zero_convention", (joint,), offset_rad=float(np.pi / 2 * (quarters if quarters < 3 else -1)))
    for factor in (FACTOR, 1.0 / FACTOR):
        for joint in axes:
            yield Mistake("current_rms_peak", (joint,), float(factor))
        if len(axes) > 1:
            yield Mistake("current_rms_peak", tuple(axes), float(factor))


def plain_score(problem: RestProblem, rows_scale: float) -> tuple[float, Fit]:
    """Log evidence of the model without effects, reduced for negative friction bands."""
    result = fit(problem, (), first_noise(problem), steps=3)
    return averaged_evidence(result) + band_signs(problem, result) + rows_scale, result


def band_signs(problem: RestProblem, result: Fit) -> float:
    """Log probability that all friction bands that the visits determine are positive."""
    return float(np.sum(log_ndtr(_bands(problem, result)[determined_bands(problem)])))


def determined_bands(problem: RestProblem) -> NDArray[np.bool_]:
    """Mask (N,) of axes whose friction band is determined: half-differences, or one-sided visits from both sides."""
    side = np.where(problem.use_sum & ~problem.use_difference, problem.rows.side, 0.0)
    fewer = np.minimum((side > 0).sum(axis=0), (side < 0).sum(axis=0))
    enough = fewer >= REST.each_side
    return np.asarray((problem.use_difference.sum(axis=0) >= REST.each_side) | enough)


def informative_axes(problem: RestProblem) -> NDArray[np.bool_]:
    """Mask (N,) of axes that were measured and moved."""
    return np.asarray(problem.use_sum.any(axis=0) & (np.ptp(problem.rows.q_rad, axis=0) > REST.moved_rad))


def _bands(problem: RestProblem, result: Fit) -> Floats:
    """Friction band (N,) of each axis over its standard deviation; 0 where the visits do not determine it."""
    return np.where(determined_bands(problem), certain_bands(problem, result), 0.0)


def held_ratio(problem: RestProblem, now: Fit, changed: RestProblem, undone: Fit) -> tuple[float, float]:
    """Ratio of the RMS on left-out poses with a mistake corrected to that without, and its upper 95 % limit.

    Pooled over all axes, each reading in units of its noise floor. A friction band is never negative, so a negative one
    predicts nothing and its rows are tested without it. The limit is one-sided, by a bootstrap over poses, because one
    pose often has most of the squared residuals.
    """
    poses = np.unique(problem.rows.pose)
    squares = [
        _squares_by_pose(problem, now, poses, _as_read(now, undone)),
        _squares_by_pose(changed, undone, poses, undone.noise.start),
    ]
    before, after = (float(values.sum()) for values in squares)
    if before <= 0:
        return 1.0, np.inf
    rng = np.random.default_rng(DRAWS)
    drawn = rng.integers(0, len(poses), (DRAWS, len(poses)))
    ratio = squares[1][drawn].sum(axis=1) / np.maximum(squares[0][drawn].sum(axis=1), 1e-300)
    upper = float(np.quantile(ratio, REST.mistake_probability))
    return float(np.sqrt(after / before)), float(np.sqrt(upper))


def _as_read(now: Fit, undone: Fit) -> Floats:
    """Noise floor (groups,) of the uncorrected data, limited to what a factor between drives can explain.

    With a wrong sign or an inverted gear efficiency the scatter is larger than friction can cause. In units of that
    scatter no error would be visible.
    """
    return np.clip(now.noise.start, undone.noise.start / MOST_FACTOR, undone.noise.start * MOST_FACTOR)


def _squares_by_pose(problem: RestProblem, result: Fit, poses: NDArray[np.int_], floor: Floats) -> Floats:
    """Sum of squares (poses,) of the left-out residuals over a noise floor (groups,)."""
    impossible = np.zeros(len(result.scale))
    impossible[problem.band_part] = np.where(determined_bands(problem), np.minimum(result.band, 0.0), 0.0)
    residual = left_out(problem, result) + result.columns.times(impossible)
    scaled = residual / floor[problem.group]
    of_pose = np.searchsorted(poses, pose_of_rows(problem))
    return np.asarray(np.bincount(of_pose, weights=scaled**2, minlength=len(poses)), dtype=float)


def _over_floor(problem: RestProblem, result: Fit) -> float:
    """Residual of the half-sums over the scatter of the approach directions, on the worst axis."""
    sums = np.unique(problem.group[problem.group < problem.axes])
    return float((result.noise.std[sums] / result.noise.start[sums]).max(initial=0.0))


def links_far_from_cad(problem: RestProblem, fitted: Fit) -> bool:
    """Return True if the fitted links deviate too far from the CAD values."""
    return float(np.sum(((fitted.links - problem.links) / problem.link_std) ** 2)) > REST.far_from_cad


def beyond_any_effect(problem: RestProblem, plain: Fit) -> bool:
    """Return True if the residual without effects is so large that mistakes are searched first."""
    return _over_floor(problem, plain) > REST.beyond_any_effect or band_signs(problem, plain) < -REST.beyond_any_effect


def suspicious(problem: RestProblem, plain: Fit) -> bool:
    """Return True if the best hypothesis is implausible, or has so large a residual, that mistakes are searched."""
    backward = bool((_bands(problem, plain) < REST.negative_band).any())
    one_sided = not problem.rows.two_sided.all()
    gains = [abs(float(v[0])) for t, v in zip(plain.terms, plain.theta, strict=True) if t.scales_reading]
    unnamed = any(term.name == UNNAMED for term in plain.terms)
    odd = unnamed or one_sided or backward or max(gains, default=0.0) > REST.odd_gain
    return odd or _over_floor(problem, plain) > REST.suspicious or links_far_from_cad(problem, plain)


def find_mistakes(
    build: Callable[[tuple[Mistake, ...]], RestProblem], allowed: frozenset[str]
) -> tuple[tuple[Mistake, ...], float]:
    """Find mistakes whose correction raises the log evidence by `mistake` or more, most likely first.

    No mistake is reported if fewer than two axes were measured and moved, or if unseen poses fit worse. What a single
    axis shows can also be a spring, an offset or a wrong link.

    Parameters
    ----------
    build : mistakes -> RestProblem of the data with these corrected, in order
    allowed : names of mistakes that may be reported

    Returns
    -------
    mistakes, and the increase of the log evidence
    """
    found: list[Mistake] = []
    gained = 0.0
    problem = build(())
    if informative_axes(problem).sum() < REST.least_axes:
        return (), 0.0
    before, plain = plain_score(problem, 0.0)
    measured = np.asarray(problem.use_sum.any(axis=0))
    while len(found) < REST.most_mistakes and (not found or suspicious(problem, plain)):
        tried = []
        for mistake in candidates(measured):
            if mistake.name not in allowed or any(set(mistake.joints) & set(old.joints) for old in found):
                continue
            changed = build((*found, mistake))
            scale = -float(np.sum(np.isin(changed.axis + 1, mistake.joints))) * np.log(mistake.factor)
            score, result = plain_score(changed, scale - mistake.handicap)
            tried.append((score, mistake, changed, result))
        best = _most_likely(problem, plain, before + REST.mistake, tried)
        if best is None:
            break
        score, mistake, problem, plain = best
        gained, before = gained + score - before, score
        found.append(mistake)
    return tuple(found), gained


def unseen_ratio(read: Unseen, plain: Fit, undone: Unseen, fitted: Fit) -> float:
    """RMS ratio on held-out rows with mistakes corrected to that without, in units of the noise floors."""
    floors = fitted.noise.start, _as_read(plain, fitted)
    squares = [
        float(np.sum((predicted(held, each) / floor[held.problem.group[held.mask]]) ** 2))
        for held, each, floor in zip((undone, read), (fitted, plain), floors, strict=True)
    ]
    return float(np.sqrt(squares[0] / squares[1])) if squares[1] > 0 else 1.0


#: Data with one mistake corrected: evidence, the mistake, rows and fit of the model without effects.
_Trial = tuple[float, Mistake, RestProblem, Fit]


def _most_likely(problem: RestProblem, plain: Fit, least: float, tried: list[_Trial]) -> _Trial | None:
    """Return the trial with the highest score of at least `least` that also improves left-out poses."""
    for score, mistake, changed, result in sorted(tried, key=lambda trial: -trial[0]):
        if score < least:
            return None
        if mistake.handicap and links_far_from_cad(changed, result):
            continue  # a factor on all axes leaves links as the CAD has them, one heavy link does not
        ratio, upper = held_ratio(problem, plain, changed, result)
        # the gain of each axis also predicts a factor, far outside its prior: so a factor only must not be worse
        limit = 2.0 * ratio**2 - upper**2 if mistake.factor != 1.0 else upper**2
        if limit < 1.0:
            return score, replace(mistake, ratio=ratio), changed, result
    return None


def elastic_joints(problem: RestProblem, after: Fit) -> list[EffectResult]:
    """Report elastic joints among those with a secondary encoder.

    The wind-up is regressed on the modelled torque, with a constant for the zeros of the two encoders. A joint is
    reported if the slope is significant and its neglect would be visible in the torque.
    """
    rows = problem.rows
    loads = visit_loads(problem, after.loads)
    torque = problem.model.predict(after.setting, after.links, loads, after.band).joint_nm
    out = []
    for axis in range(problem.axes):
        bend = rows.wind_up_rad[:, axis]
        if not np.isfinite(bend).all() or len(bend) < 4:
            continue
        compliance, std, p_value = wind_up(torque[:, axis], bend, lambda _: 1.0, problem.axes)
        if compliance < REST.wind_up * std or _strength(problem, after, axis, compliance) < REST.wind_up_strength:
            continue
        out.append(elastic(axis, compliance, std, Evidence(p_value=p_value)))
    return out


def _strength(problem: RestProblem, after: Fit, axis: int, compliance: float) -> float:
    """Torque error without the secondary encoder, over the noise, on the axis where it is largest."""
    soft = after.setting.compliance_rad_nm.copy()
    soft[axis] -= compliance
    stiff = modelled(problem, after.setting, after.links, after.loads, after.band)
    other = modelled(problem, replace(after.setting, compliance_rad_nm=soft), after.links, after.loads, after.band)
    missed = (other - stiff) / after.noise.std[problem.group]
    return float(np.sqrt((problem.by_group(missed**2) / np.maximum(problem.by_group(), 1)).max()))


def friction_by_direction(problem: RestProblem, after: Fit) -> list[EffectResult]:
    """Report axes whose mean friction against the approach is significant in one-sided visits.

    In a two-sided visit this friction is the friction band, which every model has. A single one-sided visit cannot
    separate it from torque, but visits with both approach directions together can.
    """
    rows, certain = problem.rows, certain_bands(problem, after)
    at, axes = problem.band_part.start, problem.axes
    out = []
    for axis in range(axes):
        side = rows.side[problem.use_sum[:, axis], axis]
        if min(int((side > 0).sum()), int((side < 0).sum())) < REST.each_side:
            continue
        bias, std = float(after.band[axis]), float(np.sqrt(max(after.covariance[at + axis, at + axis], 0.0)))
        noise = float(after.noise.std[2 * axes + axis])
        if certain[axis] < REST.bias or bias < REST.bias_strength * noise:
            continue
        ratio = noise / float(np.hypot(noise, bias))
        evidence = Evidence(holdout_rms_ratio=ratio, p_value=float(max(axes * ndtr(-certain[axis]), 1e-300)))
        out.append(EffectResult("static_friction", (axis + 1,), {"bias_nm": bias}, {"bias_nm": std}, evidence))
    return out
