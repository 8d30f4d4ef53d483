"""Velocity and torque offset of each drive for the motion of an instant: motor side, plain floats.

The terms of every axis are stated with their sources; a term that is left out is reported.

    t = A^-T tau(q, q', q'')                                    torque at the gear outputs
    f = t + (coulomb + load |t| + onset exp(-(theta'/v)^2)) s + viscous theta'
    u = f / eta where the motor drives, f eta where it is driven back (in between as s passes zero) + J theta''
    torque offset = st u / N,   velocity offset = (1 - share) sp N theta'

theta = A (q - q0) are the angles at the gear outputs. J is the rotor inertia there, N squared times that on its own
shaft. `share` is the part of the velocity that the drive feeds forward itself.

s is the direction of friction and gear losses. It follows the displacement, s += d theta / theta_s within -1 and 1
(Dahl, 1968). So it reverses within a small displacement and keeps its value while the axis rests.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drives.profile import DriveProfile
from gateway.cell.config import ArmConfig, AxisConfig
from gateway.errors import ConfigError
from gateway.feedforward.dynamics import ArmDynamics
from gateway.feedforward.identified import AxisConstants, Identified, Known, axis_constants
from gateway.result.follow import AxisSources
from gateway.result.result import Result

Floats = NDArray[np.float64]

PerAxis = list[float]

#: Displacement at the gear output over which friction and gear losses build up [rad]; twice that reverses them.
TURN_ROUND_RAD = 2e-5
#: Largest torque offset, as a share of the torque limit of the axis.
LIMIT_SHARE = 1.0
LEFT_OUT = "not included: no value"


@dataclass(frozen=True, slots=True)
class AxisTerms:
    """Drive train terms of one axis.

    Attributes
    ----------
    ratio : float
        N, negative if the gear reverses the direction.
    position_sign, torque_sign : float
    efficiency : float
        eta in (0, 1].
    rotor_kg_m2 : float
        At the gear output; 0 if left out, which `gateway.feedforward.law` reports.
    coulomb_nm, viscous_nm_s_rad : float
        At the gear output; 0 if left out.
    velocity_share : float
        Part of the commanded velocity that the drive feeds forward itself.
    limit_nm : float
        Largest torque offset, motor side.
    load_friction : float
        Share of the torque at the gear output that is lost in addition to the efficiency.
    onset_nm, stribeck_rad_s : float
        Breakaway friction minus Coulomb friction, and the speed over which it decays.
    """

    ratio: float
    position_sign: float
    torque_sign: float
    efficiency: float
    rotor_kg_m2: float
    coulomb_nm: float
    viscous_nm_s_rad: float
    velocity_share: float
    limit_nm: float
    load_friction: float = 0.0
    onset_nm: float = 0.0
    stribeck_rad_s: float = 1.0


class FeedforwardLaw:
    """Velocity and torque offset of every axis.

    Parameters
    ----------
    dynamics : ArmDynamics
        Arm and load.
    axes : sequence of AxisTerms, one per axis
    coupling : array of shape (N, N), optional
        A of theta = A (q - q0); None = identity.
    """

    __slots__ = ("_axes", "_coupling", "_dynamics", "_limits", "_to_gear", "_velocity")

    def __init__(self, dynamics: ArmDynamics, axes: Sequence[AxisTerms], coupling: Floats | None = None) -> None:
        if len(axes) != dynamics.axes:
            raise ValueError(f"{dynamics.axes} axes are needed, got {len(axes)}")
        self._dynamics = dynamics
        self._limits = tuple(axis.limit_nm for axis in axes)
        self._velocity = tuple((1.0 - axis.velocity_share) * axis.position_sign * axis.ratio for axis in axes)
        self._axes = tuple(
            (
                axis.coulomb_nm,
                axis.viscous_nm_s_rad,
                1.0 / axis.efficiency - 1.0,
                1.0 - axis.efficiency,
                axis.rotor_kg_m2,
                axis.torque_sign / axis.ratio,
                axis.load_friction,
                axis.onset_nm,
                1.0 / axis.stribeck_rad_s,
            )
            for axis in axes
        )
        identity = coupling is None or np.array_equal(coupling, np.eye(len(axes)))
        self._coupling = None if coupling is None or identity else np.asarray(coupling, dtype=float)
        self._to_gear = None if self._coupling is None else np.linalg.inv(self._coupling).T

    @property
    def limits_nm(self) -> tuple[float, ...]:
        """Largest torque offset (N,) [Nm], motor side."""
        return self._limits

    def sense(self, before: PerAxis, moved_rad: PerAxis) -> PerAxis:
        """Return the direction (N,) of friction and gear losses after a displacement.

        Parameters
        ----------
        before : list of floats, one per axis
            Sense before it, each within -1 and 1; 0 = not known.
        moved_rad : list of floats, one per axis
            Change of the joint positions.
        """
        moved = moved_rad if self._coupling is None else (self._coupling @ moved_rad).tolist()
        return [max(-1.0, min(1.0, old + step / TURN_ROUND_RAD)) for old, step in zip(before, moved, strict=True)]

    def offsets(self, q: PerAxis, qd: PerAxis, qdd: PerAxis, sense: PerAxis) -> tuple[PerAxis, PerAxis]:
        """Return velocity offsets [rad/s] and torque offsets [Nm], (N,) each, motor side, without limiting.

        Parameters
        ----------
        q, qd, qdd : lists of floats, one per axis
            Commanded joint positions [rad], velocities [rad/s], accelerations [rad/s2].
        sense : list of floats, one per axis
            Direction of friction and gear losses, see `sense`.
        """
        torque = self._dynamics.torque(q, qd, qdd)
        rates, gains = qd, qdd
        if self._coupling is not None and self._to_gear is not None:
            torque = (self._to_gear @ torque).tolist()
            rates, gains = (self._coupling @ qd).tolist(), (self._coupling @ qdd).tolist()
        out = []
        for force, rate, gain, side, axis in zip(torque, rates, gains, sense, self._axes, strict=True):
            coulomb, viscous, more, less, rotor, to_motor, load, onset, slow = axis
            if onset:
                share = slow * rate
                coulomb += onset * math.exp(-share * share)
            force += (coulomb + load * abs(force)) * side + viscous * rate
            driving = side if force > 0.0 else -side
            force += force * driving * (more if driving > 0.0 else less)
            out.append((force + rotor * gain) * to_motor)
        return [factor * rate for factor, rate in zip(self._velocity, rates, strict=True)], out

    def excess(self, torque_nm: Sequence[float]) -> tuple[int, float] | None:
        """Return the axis (from 0) furthest beyond its limit and its offset [Nm]; None if there is none."""
        shares = [abs(value) / limit for value, limit in zip(torque_nm, self._limits, strict=True)]
        worst = max(range(len(shares)), key=shares.__getitem__)
        return (worst, torque_nm[worst]) if not shares[worst] <= 1.0 or math.isnan(shares[worst]) else None


def axis_terms(
    arm: ArmConfig,
    profiles: Sequence[DriveProfile],
    result: Result | None,
    identified: Identified | None = None,
    *,
    fed: bool = True,
) -> tuple[tuple[AxisTerms, ...], tuple[AxisSources, ...]]:
    """Return the terms of every axis: identified in motion, else from the cell file, else friction from the rest poses.

    Parameters
    ----------
    arm : ArmConfig
    profiles : sequence of DriveProfile, one per axis
    result : Result or None
        Its friction band replaces Coulomb friction that was neither identified nor stated.
    identified : Identified, optional
    fed : bool
        True if the offsets are sent to the drives, not only computed.

    Raises
    ------
    ConfigError
        `fed` is set and a profile lacks the objects; every such axis is named.
    InputError
        An identified value contradicts the stated one.
    """
    without = [
        f"axis {number} (node {axis.node_id}, {profile.name})"
        for number, (axis, profile) in enumerate(zip(arm.axis, profiles, strict=True), start=1)
        if fed and profile.feedforward is None
    ]
    if without:
        raise ConfigError(
            f"arm '{arm.name}': the profile of {', '.join(without)} has no table [feedforward]: it is not known"
            " whether the drive supports 0x60B1 and 0x60B2; see docs/how-to/drive-profiles.md"
        )
    known = axis_constants(arm, identified)
    pairs = [
        _axis(axis, profile, constants, _band(result, number))
        for number, (axis, profile, constants) in enumerate(zip(arm.axis, profiles, known, strict=True))
    ]
    return tuple(terms for terms, _ in pairs), tuple(sources for _, sources in pairs)


def _band(result: Result | None, number: int) -> Known | None:
    if result is None or len(result.friction_band_nm) <= number:
        return None
    band = result.friction_band_nm[number]
    known = np.isfinite(band) and band >= 0
    return Known(float(band), "friction band of the rest poses") if known else None


def _axis(
    axis: AxisConfig, profile: DriveProfile, known: AxisConstants, band: Known | None
) -> tuple[AxisTerms, AxisSources]:
    share = profile.feedforward.velocity_share if profile.feedforward is not None else None
    ratio, nothing = axis.gear_ratio.value, Known(0.0, LEFT_OUT)
    rotor, viscous = known.rotor_kg_m2 or nothing, known.viscous_nm_s_rad or nothing
    coulomb = known.coulomb_nm or band or nothing
    terms = AxisTerms(
        ratio=ratio,
        position_sign=float(axis.position_sign),
        torque_sign=float(axis.torque_sign),
        efficiency=axis.gear_efficiency.value,
        rotor_kg_m2=rotor.value,
        coulomb_nm=coulomb.value,
        viscous_nm_s_rad=viscous.value,
        velocity_share=1.0 if share is None else share.value,
        limit_nm=LIMIT_SHARE * axis.torque_limit_nm / abs(ratio),
        load_friction=known.load_friction,
    )
    lost, shape = axis.gear_efficiency.source, ""
    if known.load_friction:
        lost = f"{lost}; {100 * known.load_friction:.2g} % of the torque in addition, {coulomb.source}"
    if np.isfinite(known.breakaway_nm):
        onset_nm = known.breakaway_nm - coulomb.value
        terms = replace(terms, onset_nm=onset_nm, stribeck_rad_s=known.stribeck_rad_s)
        shape = f", with {known.breakaway_nm:.4g} Nm breakaway torque"
    sources = AxisSources(
        gear_losses=lost,
        rotor_inertia=rotor.source,
        coulomb=coulomb.source + shape,
        viscous=viscous.source,
        velocity_share=f"{terms.velocity_share:g}: {'' if share is None else share.source}",
        notes=known.notes,
    )
    named = {"rotor inertia": rotor, "Coulomb friction": coulomb, "viscous friction": viscous}
    return terms, replace(sources, missing=tuple(name for name, one in named.items() if one is nothing))
