"""Detect swapped drives: compare the settings of each drive with the axes of the cell.

A drive holds the software limits, rated torque and gear of the axis that it was set up for. If two drives fail at their
own axes and each fits the axis of the other, one swap is reported. A single deviating value is reported by its own
rule.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final

from drives.objects import OBJECTS
from drives.values import Identity
from gateway.cell.config import ArmConfig
from gateway.preflight.rules import Address, Axis, Readings, drive_range_rad, joint_torque_limit_nm
from gateway.result.result import Finding

#: Allowed excess of a drive range over the cell's range, as a share of the cell's span.
WIDER: Final = 0.15
#: Rounding tolerance of a range, as a share of the cell's span.
ROUNDING: Final = 1e-3
#: Required ratio of fit, swapped over as addressed.
CLEARLY: Final = 2.5
#: Least factor between the torque margins of two axes that is significant; chosen limits differ by less.
MARGINS_APART: Final = 2.0
#: Allowed relative difference of a drive's gear ratio from the cell's.
SAME_GEAR: Final = 0.01
#: Evidence that alone gives a warning, if the drives have no limits.
TORQUE: Final = "torque limit"


@dataclass(frozen=True, slots=True)
class SeenDrive:
    """A drive that answered.

    Attributes
    ----------
    axis : Axis
        Axis of its node id.
    identity : Identity
    readings : mapping
        (index, subindex) -> value; None if the drive has no such object.
    unread : mapping
        (index, subindex) -> why an object that only informs could not be read.
    """

    axis: Axis
    identity: Identity
    readings: Readings
    unread: Mapping[Address, str] = field(default_factory=dict[Address, str])


#: Two drives, as addressed or swapped.
_Two = tuple[SeenDrive, SeenDrive]


def judge_places(arm: ArmConfig, drives: Sequence[SeenDrive]) -> list[Finding]:
    """Return findings for swapped drives.

    Parameters
    ----------
    arm : ArmConfig
    drives : sequence of SeenDrive
        Those of the arm that answered.

    Returns
    -------
    list of Finding
        One failing item per pair; a warning if only the torques indicate it. A drive that fits several other axes
        gives none.
    """
    found: list[tuple[Axis, Axis, list[str]]] = []
    for first, second in combinations(drives, 2):
        stated, exchanged = (first, second), (replace(first, axis=second.axis), replace(second, axis=first.axis))
        # True: evidence for a swap; False: against it; None: no evidence
        matching = [[not each.identity.mismatches(each.axis.profile) for each in two] for two in (stated, exchanged)]
        gears = [[_same_gear(drive) for drive in two] for two in (stated, exchanged)]
        evidence = {
            "model": _all_agree(*matching),
            "software limits": _ranges(arm, stated, exchanged),
            TORQUE: _torques(stated, exchanged),
            "gear ratio": _all_agree(*gears),
        }
        reasons = [name for name, value in evidence.items() if value]
        have_limits = all(drive_range_rad(drive.axis, arm, drive.readings) for drive in stated)
        if reasons and False not in evidence.values() and not (reasons == [TORQUE] and have_limits):
            found.append((first.axis, second.axis, reasons))
    named = [axis.joint for *pair, _ in found for axis in pair]
    items: list[Finding] = []
    for first, second, reasons in found:
        if not named.count(first.joint) == named.count(second.joint) == 1:
            continue
        joints, ids = f"J{first.joint} and J{second.joint}", f"{first.config.node_id} and {second.config.node_id}"
        what = f"the drives of {joints} look swapped (node ids or motor cables): each fits the other's axis by its "
        only_torque = reasons == [TORQUE]
        advice = f"swap node ids {ids} in the cell file or in the drives, or swap the cables, before changing any limit"
        if only_torque:
            advice = f"check the wiring of drives and motors with `servo-gateway check --move`; then swap {ids}"
        items.append(first.item("warn" if only_torque else "fail", None, what + " and ".join(reasons), advice))
    return items


def _all_agree(stated: Sequence[bool | None], exchanged: Sequence[bool | None]) -> bool | None:
    """Return which order agrees; None where both or none do, or a drive has no value."""
    return None if None in stated or all(stated) == all(exchanged) else all(exchanged)


def _ranges(arm: ArmConfig, stated: _Two, exchanged: _Two) -> bool | None:
    """Compare software limits 0x607D with the ranges of the cell."""
    before, after = ([_range_off(arm, drive) for drive in two] for two in (stated, exchanged))
    old, new = ([off for off in offs if off is not None] for offs in (before, after))
    if len(old) + len(new) < 4:
        return None
    belongs, fits = (all(short <= ROUNDING and far <= WIDER for short, far in offs) for offs in (old, new))
    if fits:
        sizes = [max(off) for off in old], [max(off) for off in new]
        clear = all(map(operator.gt, *sizes)) and sum(sizes[0]) > CLEARLY * sum(sizes[1])
        return True if clear and any(short > ROUNDING for short, _ in old) else None
    return False if belongs else None


def _range_off(arm: ArmConfig, drive: SeenDrive) -> tuple[float, float] | None:
    """Return how far the drive range ends within and beyond the cell's range, as shares of the cell's span."""
    own = drive_range_rad(drive.axis, arm, drive.readings)
    if own is None:
        return None
    low, high = drive.axis.config.position_limit_rad
    outside = (low - own[0], own[1] - high)
    return max(0.0, *(-end for end in outside)) / (high - low), max(0.0, *outside) / (high - low)


def _torques(stated: _Two, exchanged: _Two) -> bool | None:
    """Compare torque limits, from 0x6072 and 0x6076, with those of the cell.

    The product of both margins does not depend on the order; in the right order they are similar.
    """
    margins = [margin for drive in (*stated, *exchanged) if (margin := _margin(drive)) is not None]
    if len(margins) < 4:
        return None
    apart, apart_exchanged = (abs(math.log(margins[at] / margins[at + 1])) for at in (0, 2))
    limit = math.log(MARGINS_APART)
    is_swapped = min(margins[:2]) < 1 and min(margins[2:]) >= 1
    if is_swapped and apart > limit and apart > CLEARLY * apart_exchanged:
        return True
    return False if apart_exchanged > limit and apart_exchanged > CLEARLY * apart else None


def _margin(drive: SeenDrive) -> float | None:
    """Return the torque of the drive over the cell's limit; None if all drives of the model have the same value."""
    rated = drive.axis.profile.torque.rated
    if rated is None or rated.object is None:
        return None
    limit_nm = joint_torque_limit_nm(drive.axis, drive.readings)
    return None if not limit_nm else limit_nm / drive.axis.config.torque_limit_nm


def _same_gear(drive: SeenDrive) -> bool | None:
    """Return whether the gear ratio of the drive, 0x6091, is that of the cell; None where it has none."""
    motor, shaft = (
        drive.readings.get(OBJECTS[name].address) for name in ("gear_motor_revolutions", "gear_shaft_revolutions")
    )
    if not motor or not shaft or motor == shaft:
        return None
    ratio = abs(drive.axis.config.gear_ratio.value)
    return abs(motor / shaft / ratio - 1.0) < SAME_GEAR
