"""Terms of the offsets for every axis, each with its source; a term that is left out is reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drives.profile import DriveProfile
from gateway.cell.config import ArmConfig, AxisConfig
from gateway.errors import ConfigError
from gateway.feedforward.identified import AxisConstants, Identified, Known, axis_constants
from gateway.feedforward.law import AxisTerms
from gateway.result.follow import AxisSources
from gateway.result.result import Result

#: Largest torque offset, as a share of the torque limit of the axis.
LIMIT_SHARE = 1.0
LEFT_OUT = "not included: no value"


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
