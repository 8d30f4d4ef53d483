"""Torque error of an entered load over the whole workspace, inferred from a few unseen poses.

Let r (n, N) be measured less predicted torque at rest. Each hypothesis explains r by one physical error,
`e(q) = Phi(q) a` with `a ~ N(0, s^2 I)`, or by none (e = 0); noise is `N(0, (f sigma)^2)`. The columns Phi are those of
a wrong load, a wrong link, a tilted base, a wrong joint zero or a changed gain. For springs and cables, they are an
offset per axis with harmonics of its own angle. Scales s and noise factors f are on a grid. Posterior odds follow from
the evidence of each hypothesis. The probability that |e| exceeds the tolerance anywhere in the workspace is their
weighted mean.

A decision is made by that probability (JCGM 106:2012, 8.3: guarded acceptance and rejection): pass at or below
`WRONG_DECISION`, fail at or above 1 - `WRONG_DECISION`, else the data cannot decide.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.identify.stated_effects import Stated, with_stated
from gateway.model.regressor import LOAD_COLUMNS, gravity_regressor
from gateway.model.rest import Model
from gateway.model.robot import Robot
from gateway.model.visits import Gears, visits_at
from gateway.result.result import Bare, LoadResult

Floats = NDArray[np.float64]

#: Largest probability of a wrong decision at which a decision is made.
WRONG_DECISION: Final = 0.02
#: Its quantile of the normal distribution: a guard band is this many standard deviations.
GUARD: Final = 2.054
#: Prior standard deviations of an error's amplitudes; an amplitude of 1 reaches the tolerance somewhere.
_SCALES: Final = (0.5, 1.0, 2.0, 4.0)
#: Factors on the stated noise, and their prior probabilities: noise of another run may be larger.
_NOISE_FACTORS: Final = ((1.0, 0.6), (2.0, 0.3), (4.0, 0.1))
#: Prior probability that there is no error.
_NO_ERROR: Final = 0.5
#: Expected standard deviation of the error over the tolerance at which no further pose is needed; the one at which none
#: of 0 and twice the tolerance is still decided.
_RESOLVED: Final = 0.2
UNDECIDED: Final = 0.5
_DRAWS: Final = 4000
_STEP_RAD: Final = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class EnteredLoad:
    """Prediction of the measured torque: the unloaded arm as identified, with the load as entered.

    Attributes
    ----------
    robot : Robot
    bare : Bare
    load : LoadResult
        With mass and centre of gravity in the last link.
    effects : tuple of (Term, array)
        Effects of the result with their parameters.
    gears : Gears or None
        Needed with effects; None = no losses.
    band_nm : array of shape (N,) or None
        Friction band, for effects of friction; None = 0.
    """

    robot: Robot
    bare: Bare
    load: LoadResult
    effects: tuple[Stated, ...] = ()
    gears: Gears | None = None
    band_nm: Floats | None = None

    def parameters(self) -> Floats:
        """Parameters [m, hx, hy, hz] (4 N,) of every link in combinations that rest determines, with the load in the
        last.
        """
        values = np.zeros(4 * self.robot.axes)
        values[list(self.bare.columns)] = self.bare.value
        values[LOAD_COLUMNS] += self.load.mass_kg * np.array([1.0, *(self.load.com_m or ())])
        return values

    def torque(self, q_rad: Floats, gravity_m_s2: Floats | None = None) -> Floats:
        """Torque (n, N) [Nm] that is measured at rest if the entered load is right."""
        gravity = np.array(self.bare.gravity_m_s2) if gravity_m_s2 is None else gravity_m_s2
        if self.effects:
            return self._with_effects(q_rad, gravity)
        rows = gravity_regressor(self.robot, q_rad, gravity) @ self.parameters()
        return self.factor() * rows + np.nan_to_num(np.array(self.bare.offset_nm))

    def _with_effects(self, q_rad: Floats, gravity_m_s2: Floats) -> Floats:
        axes = self.robot.axes
        gears = self.gears or Gears.of(None, axes)
        setting = with_stated(self.effects, q_rad, gears)
        bias_nm = np.nan_to_num(np.array(self.bare.offset_nm))
        setting = replace(setting, gain=setting.gain * self.factor(), bias_nm=setting.bias_nm + bias_nm)
        links, band_nm = self.parameters(), np.zeros(axes) if self.band_nm is None else np.nan_to_num(self.band_nm)
        model = Model(self.robot, visits_at(q_rad, gears), gravity_m_s2)
        return model.predict(setting, links, np.zeros((len(q_rad), 4)), band_nm).sum_nm

    def factor(self) -> Floats:
        """Measured over true torque (N,)."""
        gain = np.array(self.bare.gain) if self.bare.gain else np.zeros(self.robot.axes)
        return 1.0 + np.nan_to_num(gain)


@dataclass(frozen=True, slots=True, eq=False)
class ErrorFamily:
    """One kind of physical error: name, and columns (n, N, k) at the postures, scaled to the tolerance (1)."""

    name: str
    columns: Floats


@dataclass(frozen=True, slots=True, eq=False)
class WorkspaceError:
    """Posterior of the error after measuring the poses.

    Attributes
    ----------
    exceeds : float
        Probability that the error exceeds the tolerance somewhere in the workspace.
    mean, std : arrays of shape (m, N)
        Of the error over the tolerance at the postures of the workspace.
    likeliest : str
        The error that explains the residual best; empty = none is needed.
    odds : float
        Its probability.
    """

    exceeds: float
    mean: Floats
    std: Floats
    likeliest: str
    odds: float

    @property
    def outcome(self) -> str:
        """Pass, fail or cannot tell."""
        if self.exceeds <= WRONG_DECISION:
            return "pass"
        return "fail" if self.exceeds >= 1.0 - WRONG_DECISION else "cannot tell"

    @property
    def wrong_decision(self) -> float:
        """Probability that the more likely of pass and fail is wrong; limited by the number of draws."""
        return max(min(self.exceeds, 1.0 - self.exceeds), 1.0 / _DRAWS)


def error_families(entered: EnteredLoad, q_rad: Floats, tolerance_nm: Floats) -> tuple[ErrorFamily, ...]:
    """Return the kinds of errors that are tested, over the tolerance (N,), at postures (n, N) of the workspace."""
    found = []
    for name, columns in _raw_columns(entered, q_rad):
        scaled = columns / tolerance_nm[:, None]
        largest = np.abs(scaled).max(axis=(0, 1))
        kept = largest > 1e-9 * max(float(largest.max()), 1e-12)
        if kept.any():
            found.append(ErrorFamily(name, scaled[:, :, kept] / largest[kept]))
    return tuple(found)


def _raw_columns(entered: EnteredLoad, q_rad: Floats) -> Iterator[tuple[str, Floats]]:
    """Name and columns (n, N, k) [Nm per unit] of every error."""
    count, axes = q_rad.shape
    gravity = np.array(entered.bare.gravity_m_s2)
    rows = entered.factor()[:, None] * gravity_regressor(entered.robot, q_rad, gravity)
    torque = entered.torque(q_rad)
    yield "load", rows[:, :, LOAD_COLUMNS]
    for link in range(axes - 1):
        yield f"mass of link {link + 1}", rows[:, :, 4 * link : 4 * link + 4]
    tilts = [entered.torque(q_rad, gravity + np.linalg.norm(gravity) * turn) - torque for turn in 1e-3 * np.eye(3)]
    yield "tilt of the base", np.stack(tilts, axis=2)
    for joint in range(axes):
        step = np.zeros(axes)
        step[joint] = _STEP_RAD
        turned = (entered.torque(q_rad + step) - entered.torque(q_rad - step)) / (2.0 * _STEP_RAD)
        yield f"zero of J{joint + 1}", turned[:, :, None]
        own, q = np.zeros((count, axes, 6)), q_rad[:, joint]
        own[:, joint] = np.column_stack([np.ones(count), np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q), q])
        yield f"spring or cable on J{joint + 1}", own
        yield f"gain of J{joint + 1}", own[:, :, :1] * torque[:, joint, None, None]


def inferred_error(
    families: Sequence[ErrorFamily], measured: NDArray[np.int_], residual: Floats, noise: Floats
) -> WorkspaceError:
    """Infer the error over the workspace.

    Parameters
    ----------
    families : sequence of ErrorFamily
        At m postures of the workspace, the measured ones among them.
    measured : int array of shape (n,)
        Rows of the measured postures.
    residual : array of shape (n, N)
        Measured less predicted torque over the tolerance.
    noise : array of shape (N,)
        Standard deviation of a measured torque over the tolerance.
    """
    weight = np.tile(noise, len(residual))
    reading = residual.ravel() / weight
    found = [_Hypothesis("", factor, share * _NO_ERROR, reading, None) for factor, share in _NOISE_FACTORS]
    prior = (1.0 - _NO_ERROR) / (len(families) * len(_SCALES))
    for family in families:
        design = family.columns[measured].reshape(len(weight), -1) / weight[:, None]
        found += [
            _Hypothesis(family.name, factor, share * prior, reading, (family, design, scale))
            for scale in _SCALES
            for factor, share in _NOISE_FACTORS
        ]
    log = np.array([each.log_evidence for each in found])
    odds = np.exp(log - log.max())
    odds /= odds.sum()
    by_name: dict[str, float] = {}
    for each, share in zip(found, odds, strict=True):
        by_name[each.name] = by_name.get(each.name, 0.0) + float(share)
    likeliest = max(by_name, key=lambda name: by_name[name])
    shape = families[0].columns.shape[:2]
    exceeds, mean, square = 0.0, np.zeros(shape), np.zeros(shape)
    rng = np.random.default_rng(0)
    for each, share in zip(found, odds, strict=True):
        if share < 1e-5:
            continue
        own, spread, over = each.over(shape, noise, max(int(share * _DRAWS), 50), rng)
        exceeds += share * over
        mean += share * own
        square += share * (spread**2 + own**2)
    std = np.sqrt(np.maximum(square - mean**2, 0.0))
    return WorkspaceError(float(exceeds), mean, std, likeliest, by_name[likeliest])


class _Hypothesis:
    """Hypothesis of a single error with fixed scale and noise level: evidence and posterior of its amplitudes."""

    def __init__(
        self,
        name: str,
        factor: float,
        prior: float,
        reading: Floats,
        error: tuple[ErrorFamily, Floats, float] | None,
    ) -> None:
        self.name, self.factor = name, factor
        self.log_evidence = float(np.log(prior) - 0.5 * reading @ reading / factor**2 - len(reading) * np.log(factor))
        self.columns: Floats | None = None
        if error is None:
            return
        family, design, scale = error
        precision = design.T @ design / factor**2 + np.eye(design.shape[1]) / scale**2
        self.columns = family.columns
        self.covariance = np.linalg.inv(precision)
        pull = design.T @ reading / factor**2
        self.amplitude = self.covariance @ pull
        self.log_evidence += 0.5 * float(pull @ self.amplitude)
        self.log_evidence -= 0.5 * (np.linalg.slogdet(precision)[1] + 2.0 * design.shape[1] * np.log(scale))

    def over(
        self, shape: tuple[int, ...], noise: Floats, draws: int, rng: np.random.Generator
    ) -> tuple[Floats, Floats, float]:
        """Mean and standard deviation (m, N) of the error, and the probability that it exceeds the tolerance (1).

        What noise beyond the stated one hides may be error: two standard deviations of it are added.
        """
        hidden = 2.0 * noise * np.sqrt(self.factor**2 - 1.0)
        if self.columns is None:
            return np.zeros(shape), np.zeros(shape) + hidden / 2.0, float((hidden > 1.0).any())
        mean = self.columns @ self.amplitude
        std = np.sqrt(np.maximum(np.einsum("nik,kl,nil->ni", self.columns, self.covariance, self.columns), 0.0))
        std = np.hypot(std, hidden / 2.0)
        drawn = rng.multivariate_normal(self.amplitude, self.covariance, draws, method="cholesky")
        # only an error near the tolerance can exceed it
        near = (np.abs(mean) + 5.0 * std + hidden > 1.0).any(axis=1)
        if not near.any():
            return mean, std, 0.0
        rows = self.columns[near].reshape(-1, self.columns.shape[2])
        size = np.abs(drawn @ rows.T) + np.tile(hidden, int(near.sum()))
        return mean, std, float((size > 1.0).any(axis=1).mean())


def fewest_poses(families: Sequence[ErrorFamily], noise: Floats, allowed: NDArray[np.int_], most: int) -> list[int]:
    """Choose postures one after another until every error is resolved, at most `most`.

    Each pose is the one at which the errors that are not resolved yet are least known (greedy G-optimal design).

    Parameters
    ----------
    families : sequence of ErrorFamily
    noise : array of shape (N,)
        Standard deviation of a measured torque over the tolerance.
    allowed : int array of shape (k,)
        Rows of the postures that may be measured.
    most : int
    """
    chosen: list[int] = []
    while len(chosen) < most:
        variance = [_variance(family, noise, chosen) for family in families]
        if chosen and max(float(each.max()) for each in variance) <= _RESOLVED**2:
            break
        gain = np.zeros(len(families[0].columns))
        for each in variance:
            if each.max() > _RESOLVED**2:
                gain += np.log1p(each / noise**2).sum(axis=1)
        gain[chosen] = -np.inf
        chosen.append(int(allowed[np.argmax(gain[allowed])]))
    return chosen


def resolution(families: Sequence[ErrorFamily], noise: Floats, chosen: Sequence[int]) -> float:
    """Largest expected standard deviation of any error over the tolerance in the workspace, after these poses."""
    return max(float(np.sqrt(_variance(family, noise, chosen).max())) for family in families)


def _variance(family: ErrorFamily, noise: Floats, chosen: Sequence[int]) -> Floats:
    """Variance (m, N) of an error with a prior standard deviation of 2 of its amplitudes."""
    design = (family.columns[list(chosen)] / noise[:, None]).reshape(-1, family.columns.shape[2])
    covariance = np.linalg.inv(design.T @ design + np.eye(family.columns.shape[2]) / 4.0)
    return np.einsum("nik,kl,nil->ni", family.columns, covariance, family.columns)
