"""Pre-flight check: the six drives are asked what they are, and judged. Nothing is written, nothing moves."""

from __future__ import annotations

from collections.abc import Sequence

from drives.bus import Bus
from drives.errors import DriveError, SdoAbort, SdoError
from drives.objects import OBJECTS
from drives.profile import CountsFromObjects, DriveProfile, ObjectReference
from drives.sdo import SdoClient
from gateway.check_rules import Address, Axis, CheckItem, Readings, judge_axis, judge_limits
from gateway.config import ArmConfig

READ_ALWAYS = (
    "device_type", "vendor_id", "product_code", "revision", "serial_number", "software_version", "statusword",
    "mode_display", "max_torque", "max_current", "rated_current", "rated_torque", "position", "position_limit_min",
    "position_limit_max", "polarity", "encoder_increments", "encoder_revolutions", "gear_motor_revolutions",
    "gear_shaft_revolutions", "torque_offset", "abort_connection_option", "consumer_heartbeat", "supported_modes",
)  # fmt: skip


def addresses(profile: DriveProfile) -> dict[Address, str]:
    """Objects to read, with their types, for a drive of this profile."""
    wanted = {OBJECTS[name].address: OBJECTS[name].type for name in READ_ALWAYS}
    references: list[ObjectReference] = [profile.torque.object]
    references += [rated.object for rated in (profile.torque.rated,) if rated is not None and rated.object is not None]
    counts = profile.position.counts_per_revolution
    if isinstance(counts, CountsFromObjects):
        references += [counts.object, counts.per]
    return wanted | {(reference.index, reference.subindex): reference.type for reference in references}


def read_axis(bus: Bus, axis: Axis) -> Readings:
    """Read every object of interest; None where the drive does not have it.

    Raises
    ------
    SdoTimeout
        The drive does not answer at all.
    """
    sdo = SdoClient(bus, axis.config.node_id, axis.profile.sdo.timeout_s, axis.profile.sdo.slow_timeout_s)
    try:
        sdo.read(*OBJECTS["device_type"].address, "u32")
        return {address: _read(sdo, address, kind) for address, kind in addresses(axis.profile).items()}
    finally:
        sdo.close()


def _read(sdo: SdoClient, address: Address, kind: str) -> int | str | None:
    try:
        return sdo.read_text(*address) if kind == "str" else sdo.read(*address, kind)
    except SdoAbort:
        return None


def check_arm(bus: Bus, arm: ArmConfig, profiles: Sequence[DriveProfile]) -> list[CheckItem]:
    """Check the six drives of an arm; a drive that does not answer is a failing line, the others are still read.

    Parameters
    ----------
    bus : Bus
    arm : ArmConfig
    profiles : sequence of 6 DriveProfile
        Of the axes, in order.
    """
    items: list[CheckItem] = []
    for joint, (config, profile) in enumerate(zip(arm.axis, profiles, strict=True), start=1):
        axis = Axis(joint, config, profile)
        try:
            readings = read_axis(bus, axis)
        except SdoError as error:
            items.append(_unreachable(axis, error))
            continue
        items += judge_axis(axis, readings)
        items += judge_limits(axis, arm, readings)
    return items


def _unreachable(axis: Axis, error: DriveError) -> CheckItem:
    return CheckItem(
        "fail",
        f"J{axis.joint} node {axis.config.node_id}",
        f"does not answer: {error.what}",
        "check power, wiring and node id; `servo-gateway scan` shows who is there",
    )
