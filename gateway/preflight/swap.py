"""Detect swapped drives: compare the settings of each drive with the axes of the cell.

A drive holds the software limits, rated torque and gear of the axis that it was set up for. If two drives fail at their
own axes and each fits the axis of the other, one swap is reported. A single deviating value is reported by its own
rule.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final

from drives.objects import OBJECTS
from drives.values import Identity
from gateway.cell.config import ArmConfig
from gateway.preflight.limits import software_range_rad
from gateway.preflight.rules import Address, Axis, Readings, joint_torque_limit_nm
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

    def at(self, axis: Axis) -> SeenDrive:
        """Return the same drive, assigned to another axis."""
        return replace(self, axis=axis)


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two drives, as addressed and swapped."""

    arm: ArmConfig
    as_stated: tuple[SeenDrive, SeenDrive]
    exchanged: tuple[SeenDrive, SeenDrive]


#: True: evidence for a swap; False: against it; None: no evidence.
_Evidence = Callable[[_Pair], bool | None]


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
    found: list[tuple[SeenDrive, SeenDrive, list[str]]] = []
    for first, second in combinations(drives, 2):
        pair = _Pair(arm, (first, second), (first.at(second.axis), second.at(first.axis)))
        reasons = _reasons(pair)
        if reasons:
            found.append((first, second, reasons))
    named = [drive.axis.joint for first, second, _ in found for drive in (first, second)]
    return [
        _line(first.axis, second.axis, reasons)
        for first, second, reasons in found
        if named.count(first.axis.joint) == named.count(second.axis.joint) == 1
    ]


def _reasons(pair: _Pair) -> list[str]:
    """Return the evidence for a swap; empty if any evidence contradicts it."""
    says = {name: evidence(pair) for name, evidence in _EVIDENCE.items()}
    reasons = [name for name, value in says.items() if value]
    if False in says.values():
        return []
    have_limits = all(software_range_rad(drive.axis, pair.arm, drive.readings) for drive in pair.as_stated)
    return [] if reasons == [TORQUE] and have_limits else reasons


def _line(first: Axis, second: Axis, reasons: Sequence[str]) -> Finding:
    joints = f"J{first.joint} and J{second.joint}"
    ids = f"{first.config.node_id} and {second.config.node_id}"
    what = f"the drives of {joints} look swapped (node ids or motor cables): each fits the other's axis by its "
    only_torque = list(reasons) == [TORQUE]
    advice = f"swap node ids {ids} in the cell file or in the drives, or swap the cables, before changing any limit"
    if only_torque:
        advice = f"check the wiring of drives and motors with `servo-gateway check --move`; then swap {ids}"
    where = f"J{first.joint} node {first.config.node_id}"
    return Finding("warn" if only_torque else "fail", where, what + " and ".join(reasons), advice)


def _models(pair: _Pair) -> bool | None:
    """Identity 0x1018 against the profiles."""
    stated, exchanged = (
        [not drive.identity.mismatches(drive.axis.profile) for drive in drives]
        for drives in (pair.as_stated, pair.exchanged)
    )
    if all(stated) == all(exchanged):
        return None
    return all(exchanged)


def _ranges(pair: _Pair) -> bool | None:
    """Compare software limits 0x607D with the ranges of the cell."""
    stated = [_range_off(pair.arm, drive) for drive in pair.as_stated]
    exchanged = [_range_off(pair.arm, drive) for drive in pair.exchanged]
    if None in stated or None in exchanged:
        return None
    if all(_belongs(off) for off in exchanged):
        stops_short = any(off is not None and off[0] > ROUNDING for off in stated)
        old, new = [_size(off) for off in stated], [_size(off) for off in exchanged]
        clear = all(map(operator.gt, old, new)) and sum(old) > CLEARLY * sum(new)
        return True if stops_short and clear else None
    return False if all(_belongs(off) for off in stated) else None


def _range_off(arm: ArmConfig, drive: SeenDrive) -> tuple[float, float] | None:
    """Return how far the drive range ends within and beyond the cell's range, as shares of the cell's span."""
    own = software_range_rad(drive.axis, arm, drive.readings)
    if own is None:
        return None
    low, high = drive.axis.config.position_limit_rad
    outside = (low - own[0], own[1] - high)
    return max(0.0, *(-end for end in outside)) / (high - low), max(0.0, *outside) / (high - low)


def _belongs(off: tuple[float, float] | None) -> bool:
    return off is not None and off[0] <= ROUNDING and off[1] <= WIDER


def _size(off: tuple[float, float] | None) -> float:
    return math.nan if off is None else max(off)


def _torques(pair: _Pair) -> bool | None:
    """Compare torque limits, from 0x6072 and 0x6076, with those of the cell.

    The product of both margins does not depend on the order; in the right order they are similar.
    """
    stated = [_margin(drive) for drive in pair.as_stated]
    exchanged = [_margin(drive) for drive in pair.exchanged]
    apart, apart_exchanged = _apart(stated), _apart(exchanged)
    if apart is None or apart_exchanged is None:
        return None
    limit = math.log(MARGINS_APART)
    weak = any(margin is not None and margin < 1 for margin in stated)
    strong = all(margin is not None and margin >= 1 for margin in exchanged)
    if weak and strong and apart > limit and apart > CLEARLY * apart_exchanged:
        return True
    return False if apart_exchanged > limit and apart_exchanged > CLEARLY * apart else None


def _margin(drive: SeenDrive) -> float | None:
    """Return the torque of the drive over the cell's limit; None if all drives of the model have the same value."""
    rated = drive.axis.profile.torque.rated
    if rated is None or rated.object is None:
        return None
    limit_nm = joint_torque_limit_nm(drive.axis, drive.readings)
    return None if not limit_nm else limit_nm / drive.axis.config.torque_limit_nm


def _apart(margins: Sequence[float | None]) -> float | None:
    first, second = margins
    return None if first is None or second is None else abs(math.log(first / second))


def _gears(pair: _Pair) -> bool | None:
    """Compare the gear ratios of the drives, 0x6091, with those of the cell."""
    stated = [_same_gear(drive) for drive in pair.as_stated]
    exchanged = [_same_gear(drive) for drive in pair.exchanged]
    if None in stated or all(stated) == all(exchanged):
        return None
    return all(exchanged)


def _same_gear(drive: SeenDrive) -> bool | None:
    motor, shaft = (
        drive.readings.get(OBJECTS[name].address) for name in ("gear_motor_revolutions", "gear_shaft_revolutions")
    )
    if not motor or not shaft or motor == shaft:
        return None
    ratio = abs(drive.axis.config.gear_ratio.value)
    return abs(motor / shaft / ratio - 1.0) < SAME_GEAR


_EVIDENCE: Final[dict[str, _Evidence]] = {
    "model": _models,
    "software limits": _ranges,
    TORQUE: _torques,
    "gear ratio": _gears,
}
