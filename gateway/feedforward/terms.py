"""What the offsets hold and what not, axis by axis, each with its source: nothing is left out in silence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drives.profile import DriveProfile
from gateway.cell.config import ArmConfig, AxisConfig
from gateway.errors import ConfigError
from gateway.feedforward.law import AxisTerms
from gateway.result.follow import AxisSources
from gateway.result.result import Result

#: Share of the axis' torque limit that a torque offset may take.
LIMIT_SHARE = 1.0
LEFT_OUT = "not included: not given"


def axis_terms(
    arm: ArmConfig, profiles: Sequence[DriveProfile], result: Result | None
) -> tuple[tuple[AxisTerms, ...], tuple[AxisSources, ...]]:
    """Terms of every axis from cell, profiles and, for friction the cell does not give, the rest poses' band.

    Parameters
    ----------
    arm : ArmConfig
    profiles : sequence of DriveProfile, one per axis
    result : Result or None
        Its friction band stands for Coulomb friction.

    Raises
    ------
    ConfigError
        A profile without the objects; every such axis is named.
    """
    without = [
        f"axis {number} (node {axis.node_id}, {profile.name})"
        for number, (axis, profile) in enumerate(zip(arm.axis, profiles, strict=True), start=1)
        if profile.feedforward is None
    ]
    if without:
        raise ConfigError(
            f"arm '{arm.name}': the profile of {', '.join(without)} has no [feedforward]: it is not known that "
            "the drive takes 0x60B1 and 0x60B2, and how; see docs/how-to/drive-profiles.md"
        )
    pairs = [
        _axis(axis, profile, _band(result, number))
        for number, (axis, profile) in enumerate(zip(arm.axis, profiles, strict=True))
    ]
    return tuple(terms for terms, _ in pairs), tuple(sources for _, sources in pairs)


def _band(result: Result | None, number: int) -> float | None:
    if result is None or len(result.friction_band_nm) <= number:
        return None
    band = result.friction_band_nm[number]
    return float(band) if np.isfinite(band) and band >= 0 else None


def _axis(axis: AxisConfig, profile: DriveProfile, band_nm: float | None) -> tuple[AxisTerms, AxisSources]:
    share = profile.feedforward.velocity_share if profile.feedforward is not None else None
    ratio, rotor = axis.gear_ratio.value, axis.rotor_inertia_kg_m2
    coulomb, viscous = axis.coulomb_nm, axis.viscous_nm_s_rad
    coulomb_from = LEFT_OUT if band_nm is None else "friction band of the rest poses"
    terms = AxisTerms(
        ratio=ratio,
        position_sign=float(axis.position_sign),
        torque_sign=float(axis.torque_sign),
        efficiency=axis.gear_efficiency.value,
        rotor_kg_m2=0.0 if rotor is None else rotor.value,
        coulomb_nm=(band_nm or 0.0) if coulomb is None else coulomb.value,
        viscous_nm_s_rad=0.0 if viscous is None else viscous.value,
        velocity_share=1.0 if share is None else share.value,
        limit_nm=LIMIT_SHARE * axis.torque_limit_nm / abs(ratio),
    )
    sources = AxisSources(
        gear_losses=axis.gear_efficiency.source,
        rotor_inertia=LEFT_OUT if rotor is None else rotor.source,
        coulomb=coulomb_from if coulomb is None else coulomb.source,
        viscous=LEFT_OUT if viscous is None else viscous.source,
        velocity_share=f"{terms.velocity_share:g}: {'' if share is None else share.source}",
    )
    named = {
        "rotor inertia": sources.rotor_inertia,
        "Coulomb friction": sources.coulomb,
        "viscous friction": sources.viscous,
    }
    return terms, replace(sources, missing=tuple(name for name, source in named.items() if source == LEFT_OUT))
