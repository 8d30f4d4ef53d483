"""Estimate the internal force in the part from the joint torques of both arms, weighted by friction uncertainty.

`e = A h + C c + v`. The residual torques e of all J joints of both arms are what remains after a free motion with the
constants of the cell file and the weight of the part. They consist of the internal wrench h, errors c of the constants
(`model_uncertainty`) and an unexplained rest v. A joint that reverses or has not moved yet has unknown friction and
gets a low weight. Where all joints are at rest, the interval of the estimate is wide.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import uniform_filter1d

from gateway.pair.calibration import PathWrenches
from gateway.pair.force import AVERAGED_S, InternalForce
from gateway.pair.joint_targets import ExternalTorque, Shown
from gateway.pair.learning_update import led
from gateway.pair.model_uncertainty import (
    OF_MOTION,
    ModelUncertainty,
    UncertaintyColumns,
    columns_of,
    constants_of,
    part_uncertainty,
)
from gateway.pair.transform import Floats

#: Expected internal force at rest, standard deviation, and per speed of the hand, because servos lag differently [N],
#: [N s/m]; moments by a lever [m].
USUAL_N, USUAL_N_S_M, LEVER_M = 40.0, 320.0, 0.2
#: Uncertainty of friction as a share of it, in steady motion and while friction has not settled.
TURNING_SHARE, EITHER_SHARE = 0.04, 1.0 / math.sqrt(3.0)
#: What a torque sample may be off, as a share of the largest torque of the axis: noise, vibration of the gear.
SAMPLE_SHARE = 0.002
#: What no mean of neighbours makes less, the same share by the square of the speed of the hand [s^2/m^2]: what no model
#: follows then (vibration of the gears, different filters of the drives).
UNFOLLOWED_S2_M2 = 0.003
#: Hands do not yield to what joints that have not turned yet may feign of a force, so many standard deviations of it:
#: where nothing is between them they would squeeze the part by what they yield.
CERTAIN_STD = 2.0
#: Mean square of the unexplained torque over its expectation: above it something besides the part and what is unsure of
#: the arms has pulled at them.
UNEXPLAINED_RATIO = 4.0


class ForceBalance:
    """Estimate of the internal wrench at every SYNC of a trajectory, and of the completed trajectory.

    Parameters
    ----------
    arms : ExternalTorque of master and slave
    maps : PathWrenches
    dt_s : control cycle
    cutoff_hz : of the low-pass

    Attributes
    ----------
    count : commands of the trajectory
    delay : number of commands by which the arms lag
    uncertainty : ModelUncertainty
    wrench, covariance : array of shape (6,), None before the first, and its covariance (6, 6)
    fresh : bool
        The last SYNC updated it.
    pulled : bool
        An external force acted on the arms on the last trajectory used for learning, and not on the one before.
    """

    def __init__(
        self, arms: tuple[ExternalTorque, ExternalTorque], maps: PathWrenches, dt_s: float, cutoff_hz: float
    ) -> None:
        self._arms, self._maps = arms, maps
        #: SYNCs over which a completed trajectory is averaged.
        self._size = max(1, round(AVERAGED_S / dt_s)) | 1
        self._low_pass = 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * dt_s)
        self.count = len(arms[0].delay)
        where = np.round(arms[0].delay).astype(int)
        self.delay = self.count - 1 - int(where[-1])
        force, share, part = [], [], []
        both = zip((1.0, -1.0), arms, maps.from_centre, maps.share, maps.share_per_kg, strict=True)
        for sign, arm, from_centre, weight, per_kg in both:
            at_tip = np.swapaxes(arm.jacobian, 1, 2) @ from_centre[where]
            force.append(sign * at_tip)
            share.append(-np.einsum("nij,nj->ni", at_tip, weight[where]))
            part.append(-at_tip @ part_uncertainty(per_kg[where], maps.part_mass_kg))
        #: Joint torque (M, J, 6) per wrench inside the part, and of the part's weight and inertia (M, J).
        self._force, self._share = np.concatenate(force, axis=1), np.concatenate(share, axis=1)
        motions = tuple((arm.q_rad, arm.speed_rad_s, arm.acceleration_rad_s2) for arm in arms)
        self.columns: UncertaintyColumns = columns_of(
            (arms[0].arm, arms[1].arm), motions, dt_s, np.concatenate(part, axis=1)
        )
        hand = np.einsum("nij,nj->ni", arms[0].jacobian[:, :3], arms[0].speed_rad_s)
        speed = np.linalg.norm(hand, axis=1)
        usual = USUAL_N + USUAL_N_S_M * speed
        self._usual = (usual[:, None] * np.repeat([1.0, LEVER_M], 3))[..., None] ** -2.0 * np.eye(6)
        limit_nm = np.concatenate([arm.arm.torque_limit_nm for arm in arms])
        self._sample_nm, self._unfollowed_nm = SAMPLE_SHARE * limit_nm, UNFOLLOWED_S2_M2 * np.outer(speed**2, limit_nm)
        self._coulomb_nm = np.concatenate([arm.arm.coulomb_nm for arm in arms])
        nominal = np.hstack([arm.speed_rad_s for arm in arms]), np.hstack([arm.acceleration_rad_s2 for arm in arms])
        self._nominal = self.columns.of(np.sign(nominal[0]), *nominal)
        self._unexplained = False
        self.begin(ModelUncertainty(constants_of(len(limit_nm))))

    def begin(self, uncertainty: ModelUncertainty) -> None:
        """Reset the estimate, and take the present uncertainty of the arms' constants."""
        self.uncertainty = uncertainty
        self._unsure = self._nominal @ uncertainty.covariance @ np.swapaxes(self._nominal, 1, 2)
        self._value = uncertainty.value.copy()
        self.wrench: Floats | None = None
        self.fresh = self.pulled = False
        self._seen = np.full((4, *self._share.shape), np.nan)
        for arm in self._arms:
            arm.reset()

    def take(self, m: int, seen: tuple[Shown | None, Shown | None], row: int | None) -> None:
        """Take the observations of both arms at the SYNC before that of command m, stored as row `row` of the
        trajectory.

        A SYNC without data of one arm leaves the wrench unchanged and not `fresh`.
        """
        first, second = seen
        self.fresh = first is not None and second is not None
        if first is None or second is None:
            return
        at = max(m - 1, 0)
        both = [np.concatenate([getattr(first, name), getattr(second, name)]) for name in Shown.__slots__]
        if row is not None:
            self._seen[:, row] = both
        torque, turned, speed, acceleration = both
        left = torque - self._share[at] - self.columns.torque(at, self._value, turned, speed, acceleration)
        own = self._hidden(turned) ** 2 + self._sample_nm**2
        fresh, self.covariance, gain = self._solved(at, left, self._unsure[at] + np.diag(own))
        feigned = (gain * self._open(turned) ** 2) @ gain.T
        if self.wrench is None:
            self.wrench, self._feigned = fresh, feigned
            return
        self.wrench = self.wrench + self._low_pass * (fresh - self.wrench)
        self._feigned = self._feigned + self._low_pass * (feigned - self._feigned)

    def inputs(self, m: int) -> tuple[Floats, Floats] | None:
        """Return wrenches (6,) on both fingertips, base axes [N, Nm], of the part's weight and the certain internal
        force.
        """
        if self.wrench is None:
            return None
        certain = self.wrench.copy()
        for part in (slice(0, 3), slice(3, 6)):
            size = float(np.linalg.norm(self.wrench[part]))
            along = self.wrench[part] / size if size > 0.0 else self.wrench[part]
            # the filtered variance fades to nothing while all joints turn, and rounding may take it below that
            std = math.sqrt(max(0.0, along @ self._feigned[part, part] @ along))
            certain[part] = max(0.0, size - CERTAIN_STD * std) * along
        maps, certain = self._maps, certain
        return (
            maps.from_centre[0][m] @ (maps.share[0][m] - certain),
            maps.from_centre[1][m] @ (maps.share[1][m] + certain),
        )

    def mean_to_and_fro(self) -> Floats:
        """Return the wrench (6,) of the mean torque of a forward and backward motion, so that friction cancels."""
        torque, turned, speed, acceleration = np.nanmean(self._seen, axis=1)
        left = torque - self._share[0] - self.columns.torque(0, self._value, turned, speed, acceleration)
        beside = OF_MOTION * len(torque)
        columns, unsure = self.columns.along[0], self.uncertainty.covariance[beside:, beside:]
        return self._solved(0, left, columns @ unsure @ columns.T + np.diag(self._sample_nm**2))[0]

    # -- a completed trajectory
    # ------------------------------------------------------------------------------------------

    def learn(self) -> None:
        """Update the arms' constants from the trajectory, unless an external force acted on the arms on it alone."""
        # mean square of the torque that no internal force explains, over its expectation
        torque_left, weight, information = self._weighed()
        pulled = np.einsum("nij,nj->ni", information, torque_left)
        explained = np.einsum("ni,ni->n", pulled, np.linalg.solve(information @ self._force, pulled[..., None])[..., 0])
        square = np.einsum("ni,nij,nj->n", torque_left, weight, torque_left) - explained
        unexplained = (float(np.mean(square)) / (torque_left.shape[1] - self._force.shape[2])) > UNEXPLAINED_RATIO
        self.pulled, self._unexplained = unexplained and not self._unexplained, unexplained
        if self.pulled:
            return
        there = ~np.isnan(self._seen[0]).any(axis=1)
        left, columns, hidden = self._averaged()
        std = np.sqrt(hidden**2 + self._sample_nm**2)
        self.uncertainty.learn(columns[there], left[there], self._force[there], std[there])

    def internal_force(self) -> InternalForce:
        """Return the internal wrench along the completed trajectory, averaged symmetrically and therefore without
        delay.
        """
        left, _, information = self._weighed()
        covariance = np.linalg.inv(information @ self._force + self._usual)
        wrench = np.einsum("nij,njk,nk->ni", covariance, information, left)
        return InternalForce(
            led(wrench, self.delay), led(np.asarray(covariance, dtype=np.float64), self.delay), self.pulled
        )

    def _weighed(self) -> tuple[Floats, Floats, Floats]:
        """Return averaged residual torques (M, J), their weights (M, J, J), and those by wrench (M, 6, J)."""
        left, columns, hidden = self._averaged()
        left = left - columns @ self.uncertainty.value
        unsure = columns @ self.uncertainty.covariance @ np.swapaxes(columns, 1, 2)
        own = hidden**2 + self._sample_nm**2 / self._size + self._unfollowed_nm**2
        weight = np.asarray(np.linalg.inv(unsure + own[:, :, None] * np.eye(len(self._sample_nm))), dtype=np.float64)
        return left, weight, np.swapaxes(self._force, 1, 2) @ weight

    def _averaged(self) -> tuple[Floats, Floats, Floats]:
        """Torques (M, J) less the part's share, what is unsure of them (M, J, K), and what dry friction hides (M, J).

        Torque and inertia are averaged over the same neighbours: a timing error of a SYNC or an encoder simulates a
        large acceleration, and the mean of both suppresses it.
        """
        torque, turned, speed, acceleration = np.stack([_filled(each) for each in self._seen])
        each = torque - self._share, self.columns.of(turned, speed, acceleration), self._hidden(turned)
        left, columns, hidden = (uniform_filter1d(values, self._size, axis=0, mode="nearest") for values in each)
        return left, columns, hidden

    def _hidden(self, turned: Floats) -> Floats:
        """Return the standard deviation (..., J) of the dry friction torque [Nm]."""
        return np.hypot(TURNING_SHARE * self._coulomb_nm, self._open(turned))

    def _open(self, turned: Floats) -> Floats:
        """Return the friction torque's standard deviation for unknown direction (joint at rest or reversed)."""
        return EITHER_SHARE * self._coulomb_nm * np.sqrt(1.0 - turned**2)

    def _solved(self, at: int, left: Floats, unsure: Floats) -> tuple[Floats, Floats, Floats]:
        """Return wrench (6,), its covariance and wrench per torque (6, J) by torques (J,) of covariance (J, J).

        Six parameters from correlated torques at every SYNC: too small and too frequent for a fit by `identify.solve`.
        """
        force = self._force[at]
        information = np.linalg.solve(unsure, force).T
        covariance = np.linalg.inv(information @ force + self._usual[at])
        gain = covariance @ information
        return gain @ left, covariance, gain


def _filled(values: Floats) -> Floats:
    """Return rows (M, n) with missing ones interpolated from their neighbours."""
    there = np.flatnonzero(~np.isnan(values).any(axis=1))
    every = np.arange(len(values))
    return np.stack([np.interp(every, there, column[there]) for column in values.T], axis=1)
