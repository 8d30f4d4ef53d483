"""Write the drive's own limits from the cell file: position (0x607D) and torque (0x6072); they are never loosened."""

from __future__ import annotations

import math
from typing import Final

from drives.access import ObjectAccess
from drives.cia402 import AT_REST, decode_state, describe
from drives.errors import DriveFault, SdoAbort, SdoProtocolError
from drives.objects import OBJECTS

#: Distance of the drive's own position limits outside those of the master, in motor revolutions: a stop that begins at
#: the master's limit ends before the drive's. Behind a gear of 100 it is 0.03 rad of the joint.
LIMIT_MARGIN_REVOLUTIONS: Final = 0.5
#: Reciprocal of the share by which a drive may round the limit up.
ROUNDED: Final = 10
_I32_MAX: Final = 0x7FFFFFFF
#: 0x607E: the sign of positions is turned round in the drive.
_POSITION_REVERSED: Final = 0x80

Counts = tuple[int, int]


def limits_in_counts(limit_rad: tuple[float, float] | None, count_rad: float) -> Counts:
    """Return the lowest and highest position count inside a range of motor angles [rad]; None = no limit."""
    if limit_rad is None:
        return -_I32_MAX - 1, _I32_MAX
    low, high = math.ceil(limit_rad[0] / count_rad), math.floor(limit_rad[1] / count_rad)
    return max(low, -_I32_MAX - 1), min(high, _I32_MAX)


def write_position_limits(access: ObjectAccess, limit: Counts, revolution_counts: float) -> bool:
    """Let the drive refuse targets far outside the axis' limits (0x607D), where profile and drive allow it.

    The drive's own limits are narrowed, never widened. They are left unchanged where the axis is outside the limits
    that would be written. The same holds where their meaning is not certain: with a home offset (0x607C), with
    reversed positions (0x607E), or where one of these cannot be read.

    Parameters
    ----------
    access : ObjectAccess
        Of a drive that is not enabled.
    limit : (int, int)
        Lowest and highest target that the master commands.
    revolution_counts : float
        Counts of one motor revolution.

    Returns
    -------
    bool
        Whether the drive keeps these limits now.
    """
    low, high = OBJECTS["position_limit_min"], OBJECTS["position_limit_max"]
    if not access.may_write(low.index):
        return False
    held = access.read_readable(low), access.read_readable(high)
    if held[0] is None or held[1] is None:
        return False
    try:
        shifted = access.read_optional(OBJECTS["home_offset"]) or 0
        polarity = access.read_optional(OBJECTS["polarity"]) or 0
    except (SdoAbort, SdoProtocolError):
        return False
    if shifted or polarity & _POSITION_REVERSED:
        return False
    margin = round(LIMIT_MARGIN_REVOLUTIONS * revolution_counts)
    found = access.original(low, held[0]), access.original(high, held[1])
    new = _narrowed(found, (limit[0] - margin, limit[1] + margin))
    position = access.read(access.profile.position.object)
    if not new[0] <= position <= new[1]:
        return False
    reason = "position limits of the axis, and a margin"
    steps = [(low, new[0]), (high, new[1])]
    for entry, value in reversed(steps) if new[0] >= held[1] else steps:
        access.write(entry, value, reason, rounded=range(value - margin, value + margin + 1))
    return True


def _narrowed(found: Counts, wanted: Counts) -> Counts:
    """Where both allow it; limits that are not in order, such as 0 and 0, are none."""
    low, high = max(wanted[0], -_I32_MAX - 1), min(wanted[1], _I32_MAX)
    if found[0] < found[1] and max(low, found[0]) < min(high, found[1]):
        return max(low, found[0]), min(high, found[1])
    return low, high


def limit_torque(access: ObjectAccess, permille: int | None) -> None:
    """Lower the largest torque that the drive gives (0x6072), where profile and drive allow it.

    The limit of an earlier run is replaced: the drive gets the smaller one of its original value and the present need.

    Parameters
    ----------
    access : ObjectAccess
    permille : int or None
        Of the rated torque; None = the need is not known, and the drive gets its original value.

    Raises
    ------
    DriveFault
        The drive is enabled: changing the limit under power may let the axis drop.
    ConfigurationRefused, SdoError
        As the drive answers.
    """
    entry = OBJECTS["max_torque"]
    held = access.read_readable(entry) if access.may_write(entry.index) else None
    if held is None:
        return
    status = access.read(OBJECTS["statusword"])
    if decode_state(status) not in AT_REST:
        what = f"is in {describe(status)}: its torque limit is changed only while it is disabled"
        raise DriveFault(what, node=access.node_id, index=entry.index, code=status, advice="disable it first")
    original = access.original(entry, held)
    limit = original if permille is None or permille <= 0 else min(permille, original)
    if permille is not None or limit != held:
        rounded = range(limit, min(original, limit + limit // ROUNDED) + 1)
        access.write(entry, limit, "lowest torque that the motion needs", rounded=rounded)
