"""Compare the wiring of the arm with the cell file, from small moves of each axis and the gravity torque of the model.

An encoder follows its own motor whatever the cell file states. A sign, a gear ratio or the order of the axes is visible
only in the torque. The torque changes with the posture as predicted by the model or by another wiring. Each wiring is a
hypothesis with a Gaussian evidence. Links have the prior of the cell file; the load is unknown. Small errors of encoder
zeros, gear losses and torque constants are allowed. Friction needs no model: it opposes the motion, so the
half-difference of the two approaches is positive if torque and position have the same sign.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from gateway.cell.conversion import AxisConversion
from gateway.identify.links import PER_LINK_AT_REST, link_prior
from gateway.identify.solve import Prior, solve
from gateway.model.regressor import LOAD_COLUMNS, gravity_regressor
from gateway.model.robot import Robot, link_lengths_m

Floats = NDArray[np.float64]

#: Difference in evidence (natural logarithm) from which a wiring is named, and from which others are excluded.
NAMED: Final = 12.0
SEEN: Final = 5.0
#: Factors of ratio and torque scale to test, and the range that counts as no difference.
FACTORS: Final = np.exp(np.linspace(np.log(0.1), np.log(10.0), 47))
AGREES: Final = (0.75, 1.33)
#: Tolerated errors: gear losses and torque constants [share], encoder zeros [rad].
SCALE_STD: Final = 0.05
ZERO_STD_RAD: Final = 0.01
#: Least scatter of the friction from one approach to the next, as a share of its band, and how far the scatter that was
#: seen in a few postures is trusted.
SCATTER: Final = 0.25
SCATTER_SEEN: Final = 1.5
#: Tolerated torque difference, as a share of the torque limit.
FLOOR_SHARE: Final = 0.0005
OFFSET_SHARE: Final = 0.003
#: Relative standard deviation of link masses that are called exact.
LEAST_TRUST: Final = 0.01
#: Number of standard deviations from which the friction band is significant.
BAND_SIGMAS: Final = 4.0
MOST: Final = 3
STEP_RAD: Final = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """Motor-side means at rest, each posture approached in both directions.

    Attributes
    ----------
    motor_rad, motor_nm : arrays of shape (n, 2, N)
        Values by drive; first the approach with all joints decreasing, then increasing.
    """

    motor_rad: Floats
    motor_nm: Floats


@dataclass(frozen=True, slots=True)
class Wiring:
    """Difference of the arm from the cell file.

    Attributes
    ----------
    name : str
        `as_stated`, `reversed` (position and torque), `position_reversed`, `torque_reversed`, `swapped`, `gear_ratio`,
        `torque_scale`.
    joints : tuple of int
        From 1.
    factor : float
        Gear ratio of the cell file divided by the true one; reported divided by true torque.
    """

    name: str
    joints: tuple[int, ...] = ()
    factor: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Interpretation of the motor values under a wiring: order of the drives, conversion, torque factor."""

    order: NDArray[np.int64]
    axes: AxisConversion
    torque_factor: Floats
    #: Torque factor per axis, relative to the interpretation of the cell file.
    scale: Floats

    @classmethod
    def stated(cls, axes: AxisConversion) -> Reading:
        """Return the interpretation of the cell file."""
        count = len(axes.ratio)
        return cls(np.arange(count), axes, np.ones(count), np.ones(count))

    def with_wiring(self, wiring: Wiring) -> Reading:
        """Return the interpretation of the motor values with one additional wiring difference."""
        at = [joint - 1 for joint in wiring.joints]
        if wiring.name == "swapped":
            order = self.order.copy()
            order[at] = order[at[::-1]]
            return replace(self, order=order)
        axes, torque, scale = self.axes, self.torque_factor.copy(), self.scale.copy()
        signs = np.ones_like(scale)
        signs[at] = -1.0
        if wiring.name in ("reversed", "position_reversed"):
            axes = replace(axes, position_sign=axes.position_sign * signs)
        if wiring.name in ("reversed", "torque_reversed"):
            axes = replace(axes, torque_sign=axes.torque_sign * signs)
        if wiring.name == "gear_ratio":
            ratio = axes.ratio.copy()
            ratio[at] /= wiring.factor
            axes = replace(axes, ratio=ratio)
        if wiring.name == "torque_scale":
            torque[at] *= wiring.factor
        if wiring.name in ("gear_ratio", "torque_scale"):
            scale[at] *= wiring.factor
        return replace(self, axes=axes, torque_factor=torque, scale=scale)

    def joints(self, moves: Moves, stated: AxisConversion) -> tuple[Floats, Floats, Floats]:
        """Return joint angles, half-sums of the two approaches, and half-differences along the motion, (n, N) each.

        The half-difference is computed without the gear efficiency: friction and gear losses both make it positive.
        """
        position, torque = moves.motor_rad[..., self.order], moves.motor_nm[..., self.order] / self.torque_factor
        up = np.sign(self.axes.joint_velocity(stated.motor_velocity(np.ones(len(self.order)))[self.order]))
        sides = [self.axes.joint_torque_by_direction(torque[:, side], sense * up) for side, sense in enumerate((-1, 1))]
        band = self.axes.joint_torque(torque[:, 1] - torque[:, 0]) / 2.0 * up
        return self.axes.joint_position(position.mean(axis=1)), (sides[0] + sides[1]) / 2.0, band


@dataclass(frozen=True, slots=True, eq=False)
class WiringView:
    """Result of the moves for one axis.

    Attributes
    ----------
    sign_seen, ratio_seen : bool
        True if the data distinguish the stated sign, and the stated gear ratio, from others.
    ratio, ratio_std : float
        Gear ratio of the cell file divided by the one estimated from the torques.
    band_nm, band_std_nm : float
        Friction that opposes the motion; negative if torque and position have opposite signs.
    swaps_unseen : tuple of int
        Axes that may be swapped with this one.
    """

    sign_seen: bool
    ratio_seen: bool
    ratio: float
    ratio_std: float
    band_nm: float
    band_std_nm: float
    swaps_unseen: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Result of the moves for the wiring.

    Attributes
    ----------
    found : tuple of Wiring
        Differences from the cell file that the torques require, most likely first.
    rivals : tuple of Wiring
        Hypotheses that explain the torques nearly as well as the last one found.
    axes : tuple of WiringView, one per axis
        Views of the axes with the found wiring.
    misfit : float
        Root mean square of the residual divided by the tolerance.
    """

    found: tuple[Wiring, ...]
    rivals: tuple[Wiring, ...]
    axes: tuple[WiringView, ...]
    misfit: float


class _Evidence:
    """Evidence of wirings from the same moves: marginal likelihood of the half-sums with unknown links and load."""

    def __init__(
        self,
        moves: Moves,
        robot: Robot,
        axes: AxisConversion,
        gravity_m_s2: Floats,
        torque_limit_nm: Floats,
        link_std: float,
        load_kg: float,
    ) -> None:
        self.moves, self.axes, self._robot, self._gravity_m_s2 = moves, axes, robot, gravity_m_s2
        self.floor_nm = FLOOR_SHARE * torque_limit_nm
        _, _, band = Reading.stated(axes).joints(moves, axes)
        scatter = np.median(np.abs(band - np.median(band, axis=0)), axis=0) * 1.4826
        seen = np.hypot(SCATTER * np.abs(band).mean(axis=0), SCATTER_SEEN * scatter)
        #: Standard deviation of a half-sum by drive [Nm, motor side].
        self._noise_nm = np.hypot(seen, self.floor_nm) / np.abs(axes.ratio)
        self._links, std = link_prior(robot, max(link_std, LEAST_TRUST), PER_LINK_AT_REST)
        reach = link_lengths_m(robot)[-1] + 0.1
        std[LOAD_COLUMNS] = np.hypot(std[LOAD_COLUMNS], load_kg * np.array([1.0, reach, reach, reach]))
        errors = [np.full(robot.axes, ZERO_STD_RAD), np.full(robot.axes, SCALE_STD)]
        self._std = np.concatenate([std, *errors, OFFSET_SHARE * torque_limit_nm])

    def of(self, reading: Reading) -> float:
        """Return the natural logarithm of the evidence."""
        return self.fitted(reading)[0]

    def fitted(self, reading: Reading) -> tuple[float, float]:
        """Return the natural logarithm of the evidence, and the root mean square of the whitened residual.

        Errors of encoder zero, torque scale and torque offset of each axis are tolerated. The scale is that of the
        measured torque: with modelled torque a wrong ratio would be accepted as a scale error.
        """
        q, measured, _ = reading.joints(self.moves, self.axes)
        rows, own = gravity_regressor(self._robot, q, self._gravity_m_s2), np.eye(self._robot.axes)
        moved = [gravity_regressor(self._robot, q + STEP_RAD * step, self._gravity_m_s2) - rows for step in own]
        zeros = np.stack([change @ self._links / STEP_RAD for change in moved], axis=2)
        scales = np.abs(measured)[:, :, None] * own
        design = np.concatenate([rows, zeros, scales, np.broadcast_to(own, zeros.shape)], axis=2)
        noise = np.tile(self._noise_nm[reading.order] * np.abs(reading.axes.ratio) / reading.torque_factor, len(q))
        mean = np.concatenate([self._links, np.zeros(len(self._std) - len(self._links))])
        none = np.zeros((0, len(mean)))
        flat = design.reshape(len(noise), -1)
        found = solve(flat, measured.ravel(), 1.0 / noise, Prior(mean, self._std, none, none[:, 0]))
        log = -0.5 * (found.misfit + found.log_determinant + len(noise) * np.log(2 * np.pi))
        log -= float(np.log(self._std).sum() + np.log(noise).sum())
        scaled = len(q) * float(np.log(np.abs(reading.scale)).sum())
        return log - scaled, float(np.sqrt(found.misfit / len(noise)))

    def friction(self, reading: Reading) -> tuple[Floats, Floats]:
        """Return the friction (N,) that opposes the motion [Nm], and its standard deviation."""
        _, _, band = reading.joints(self.moves, self.axes)
        spread = band.std(axis=0, ddof=1) / np.sqrt(len(band))
        return band.mean(axis=0), np.hypot(spread, self.floor_nm)


def judge_wiring(
    moves: Moves,
    robot: Robot,
    axes: AxisConversion,
    *,
    gravity_m_s2: Floats,
    torque_limit_nm: Floats,
    link_std: float,
    load_kg: float,
) -> Verdict:
    """Find the wiring that explains the torques.

    Parameters
    ----------
    moves : Moves
    robot : Robot
    axes : AxisConversion
        Conversion of the cell file.
    gravity_m_s2 : array of shape (3,)
    torque_limit_nm : array of shape (N,)
    link_std : float
        Relative standard deviation of the links' masses.
    load_kg : float
        Standard deviation of the unknown load's mass.
    """
    evidence = _Evidence(moves, robot, axes, gravity_m_s2, torque_limit_nm, link_std, load_kg)
    reading = Reading.stated(axes)
    value, misfit = evidence.fitted(reading)
    found: list[Wiring] = []
    rivals: tuple[Wiring, ...] = ()
    while len(found) < MOST:
        friction_nm, std_nm = evidence.friction(reading)
        # torque and position have opposite signs: friction would drive the motion
        opposite = np.flatnonzero(friction_nm < -BAND_SIGMAS * std_nm) + 1
        scored = _scored(evidence, reading, opposite.tolist())
        best_value, best = max(scored, key=lambda each: each[0])
        if best_value - value < NAMED and not len(opposite):
            break
        near = [each for each in scored if best_value - each[0] < SEEN]
        best_value, best = next((each for each in near if each[1].name == "gear_ratio"), (best_value, best))
        near = [each for each in near if each[1] is not best]
        rivals = tuple(each for _, each in sorted(near, key=lambda each: -each[0]))
        found.append(best)
        reading = reading.with_wiring(best)
        value, misfit = evidence.fitted(reading)
    views = tuple(_view(evidence, reading, joint, value) for joint in range(1, robot.axes + 1))
    return Verdict(tuple(found), rivals, views, misfit)


def _scored(evidence: _Evidence, reading: Reading, opposite: Sequence[int]) -> list[tuple[float, Wiring]]:
    """Return the evidence of every single difference compatible with friction: of these joints, if there are any."""
    joints = range(1, len(reading.order) + 1)
    names = ("torque_reversed", "position_reversed") if opposite else ("reversed",)
    wirings = [Wiring(name, (joint,)) for joint in opposite or joints for name in names]
    pairs = itertools.combinations(joints, 2)
    wirings += [Wiring("swapped", pair) for pair in pairs if not opposite or set(pair) <= set(opposite)]
    scored = [(evidence.of(reading.with_wiring(wiring)), wiring) for wiring in wirings]
    if opposite:
        return scored
    for name in ("gear_ratio", "torque_scale"):
        for joint in joints:
            values, factor, _ = _factor(evidence, reading, name, joint)
            if not AGREES[0] < factor < AGREES[1]:
                scored.append((values, Wiring(name, (joint,), factor)))
    return scored


def _factor(evidence: _Evidence, reading: Reading, name: str, joint: int) -> tuple[float, float, float]:
    """Return the mean evidence over the factors, the mean factor, and its standard deviation (logarithms)."""
    logs = np.array([evidence.of(reading.with_wiring(Wiring(name, (joint,), float(factor)))) for factor in FACTORS])
    weight = np.exp(logs - logsumexp(logs))
    mean = float(weight @ np.log(FACTORS))
    std = float(np.sqrt(weight @ (np.log(FACTORS) - mean) ** 2))
    return float(logsumexp(logs) - np.log(len(FACTORS))), float(np.exp(mean)), std


def _view(evidence: _Evidence, reading: Reading, joint: int, value: float) -> WiringView:
    mirrored = evidence.of(reading.with_wiring(Wiring("reversed", (joint,))))
    _, factor, spread = _factor(evidence, reading, "gear_ratio", joint)
    unseen = tuple(
        other
        for other in range(1, len(reading.order) + 1)
        if other != joint and value - evidence.of(reading.with_wiring(Wiring("swapped", (joint, other)))) < SEEN
    )
    band, band_std = evidence.friction(reading)
    return WiringView(
        sign_seen=value - mirrored > SEEN,
        ratio_seen=spread < 0.5 * np.log(AGREES[1]) and AGREES[0] < factor < AGREES[1],
        ratio=factor,
        ratio_std=factor * spread,
        band_nm=float(band[joint - 1]),
        band_std_nm=float(band_std[joint - 1]),
        swaps_unseen=unseen,
    )
