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
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import logsumexp

from gateway.check.wiring import Floats, Moves, Reading, WiredArm, Wiring
from gateway.identify.links import PER_LINK_AT_REST, link_prior
from gateway.identify.solve import Prior, solve
from gateway.model.regressor import LOAD_COLUMNS, gravity_regressor
from gateway.model.robot import link_lengths_m

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
    odds : float
        Natural logarithm of the evidence gained.
    axes : tuple of WiringView, one per axis
        Views of the axes with the found wiring.
    misfit : float
        Root mean square of the residual divided by the tolerance.
    """

    found: tuple[Wiring, ...]
    rivals: tuple[Wiring, ...]
    odds: float
    axes: tuple[WiringView, ...]
    misfit: float


class _Evidence:
    """Evidence of wirings from the same moves: marginal likelihood of the half-sums with unknown links and load."""

    def __init__(self, arm: WiredArm, moves: Moves) -> None:
        self.arm, self.moves = arm, moves
        _, _, band = Reading.stated(arm.axes).joints(moves, arm.axes)
        seen = np.hypot(SCATTER * np.abs(band).mean(axis=0), SCATTER_SEEN * _scatter(band))
        #: Standard deviation of a half-sum by drive [Nm, motor side].
        self._noise_nm = np.hypot(seen, FLOOR_SHARE * arm.torque_limit_nm) / np.abs(arm.axes.ratio)
        self._links, std = link_prior(arm.robot, max(arm.trust, LEAST_TRUST), PER_LINK_AT_REST)
        reach = link_lengths_m(arm.robot)[-1] + 0.1
        std[LOAD_COLUMNS] = np.hypot(std[LOAD_COLUMNS], arm.load_kg * np.array([1.0, reach, reach, reach]))
        errors = [np.full(arm.robot.axes, ZERO_STD_RAD), np.full(arm.robot.axes, SCALE_STD)]
        self._std = np.concatenate([std, *errors, OFFSET_SHARE * arm.torque_limit_nm])

    def of(self, reading: Reading) -> float:
        """Return the natural logarithm of the evidence."""
        return self._fitted(reading)[0]

    def misfit(self, reading: Reading) -> float:
        """Return the root mean square of the whitened residual."""
        return self._fitted(reading)[1]

    def _fitted(self, reading: Reading) -> tuple[float, float]:
        arm = self.arm
        q, measured, _ = reading.joints(self.moves, arm.axes)
        rows = gravity_regressor(arm.robot, q, arm.gravity_m_s2)
        design = np.concatenate([rows, *self._error_columns(q, rows @ self._links, measured)], axis=2)
        noise = np.tile(self._noise_nm[reading.order] * np.abs(reading.axes.ratio) / reading.torque_factor, len(q))
        mean = np.concatenate([self._links, np.zeros(len(self._std) - len(self._links))])
        none = np.zeros((0, len(mean)))
        flat = design.reshape(len(noise), -1)
        found = solve(flat, measured.ravel(), 1.0 / noise, Prior(mean, self._std, none, none[:, 0]))
        log = -0.5 * (found.misfit + found.log_determinant + len(noise) * np.log(2 * np.pi))
        log -= float(np.log(self._std).sum() + np.log(noise).sum())
        scaled = len(q) * float(np.log(np.abs(reading.scale)).sum())
        return log - scaled, float(np.sqrt(found.misfit / len(noise)))

    def _error_columns(self, q: Floats, expected: Floats, measured: Floats) -> tuple[Floats, Floats, Floats]:
        """Return columns (n, N, N) of tolerated errors: encoder zero, torque scale and torque offset of each axis.

        The measured torque is scaled here: with modelled torque a wrong ratio would be accepted as a scale error.
        """
        own = np.eye(self.arm.robot.axes)
        moved = [gravity_regressor(self.arm.robot, q + STEP_RAD * step, self.arm.gravity_m_s2) for step in own]
        zeros = np.stack([(rows @ self._links - expected) / STEP_RAD for rows in moved], axis=2)
        return zeros, np.abs(measured)[:, :, None] * own, np.broadcast_to(own, zeros.shape)


def judge_wiring(arm: WiredArm, moves: Moves) -> Verdict:
    """Find the wiring that explains the torques.

    Parameters
    ----------
    arm : WiredArm
    moves : Moves

    Returns
    -------
    Verdict
    """
    evidence = _Evidence(arm, moves)
    reading = Reading.stated(arm.axes)
    value = evidence.of(reading)
    found: list[Wiring] = []
    rivals: tuple[Wiring, ...] = ()
    gained = 0.0
    while len(found) < MOST:
        parity = _parity(reading, arm, moves)
        scored = _scored(evidence, reading, parity)
        best_value, best = max(scored, key=lambda each: each[0])
        forced = any(sign < 0 for sign in parity)
        if best_value - value < NAMED and not forced:
            break
        near = [each for each in scored if best_value - each[0] < SEEN]
        best_value, best = next((each for each in near if each[1].name == "gear_ratio"), (best_value, best))
        near = [each for each in near if each[1] is not best]
        rivals = tuple(each for _, each in sorted(near, key=lambda each: -each[0]))
        found.append(best)
        reading = reading.with_wiring(best)
        gained += best_value - value
        value = best_value
    views = tuple(_view(evidence, reading, joint, value) for joint in range(1, arm.robot.axes + 1))
    return Verdict(tuple(found), rivals, gained, views, evidence.misfit(reading))


def _parity(reading: Reading, arm: WiredArm, moves: Moves) -> list[int]:
    """Return the sign of torque relative to position by friction, per axis: 1 same, -1 opposite, 0 not determined."""
    mean, std = _bands(reading, arm, moves)
    return [
        int(np.sign(value)) if abs(value) > BAND_SIGMAS * spread else 0 for value, spread in zip(mean, std, strict=True)
    ]


def _bands(reading: Reading, arm: WiredArm, moves: Moves) -> tuple[Floats, Floats]:
    _, _, band = reading.joints(moves, arm.axes)
    spread = band.std(axis=0, ddof=1) / np.sqrt(len(band))
    return band.mean(axis=0), np.hypot(spread, FLOOR_SHARE * arm.torque_limit_nm)


def _scatter(band: Floats) -> Floats:
    """Return the scatter (N,) of half-differences (n, N) from their median."""
    return np.median(np.abs(band - np.median(band, axis=0)), axis=0) * 1.4826


def _scored(evidence: _Evidence, reading: Reading, parity: Sequence[int]) -> list[tuple[float, Wiring]]:
    """Return the evidence of every single difference compatible with friction."""
    joints = range(1, len(parity) + 1)
    opposite = [joint for joint in joints if parity[joint - 1] < 0]
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
        for other in range(1, evidence.arm.robot.axes + 1)
        if other != joint and value - evidence.of(reading.with_wiring(Wiring("swapped", (joint, other)))) < SEEN
    )
    band, band_std = _bands(reading, evidence.arm, evidence.moves)
    return WiringView(
        sign_seen=value - mirrored > SEEN,
        ratio_seen=spread < 0.5 * np.log(AGREES[1]) and AGREES[0] < factor < AGREES[1],
        ratio=factor,
        ratio_std=factor * spread,
        band_nm=float(band[joint - 1]),
        band_std_nm=float(band_std[joint - 1]),
        swaps_unseen=unseen,
    )
