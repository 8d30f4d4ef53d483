"""Pre-flight check: the six drives are asked what they are, and judged. Nothing is written, nothing moves."""

from __future__ import annotations

from collections.abc import Sequence

from drives.bringup import read_identity
from drives.bus import Bus
from drives.busload import cycle_bits_worst, load_percent
from drives.errors import DriveError, SdoAbort, SdoError
from drives.instrument import InstrumentSetup
from drives.objects import OBJECTS
from drives.pdo import rpdo_plan, tpdo_plans
from drives.probe import probe
from drives.profile import CountsFromObjects, DriveProfile, ObjectReference
from drives.sdo import SdoClient
from drives.values import Identity
from gateway.check.rules import Address, Axis, CheckItem, Readings, judge_axis, judge_identity, judge_limits
from gateway.check.swap import SeenDrive, judge_places
from gateway.config import ArmConfig, BusConfig

# Largest planned worst-case load of a bus that the clock paces.
LOAD_LIMIT_PERCENT = 70.0
READ_ALWAYS = (
    "statusword",
    "max_torque",
    "position",
    "position_limit_min",
    "position_limit_max",
    "polarity",
    "encoder_increments",
    "gear_motor_revolutions",
    "gear_shaft_revolutions",
    "torque_offset",
    "abort_connection_option",
    "consumer_heartbeat",
    "supported_modes",
)


def addresses(profile: DriveProfile) -> dict[Address, str]:
    """Objects to read, with their types, for a drive of this profile."""
    wanted = {OBJECTS[name].address: OBJECTS[name].type for name in READ_ALWAYS}
    references: list[ObjectReference] = [profile.torque.object]
    references += [rated.object for rated in (profile.torque.rated,) if rated is not None and rated.object is not None]
    counts = profile.position.counts_per_revolution
    if isinstance(counts, CountsFromObjects):
        references += [counts.object, counts.per]
    return wanted | {(reference.index, reference.subindex): reference.type for reference in references}


def read_axis(bus: Bus, axis: Axis) -> tuple[Identity, Readings]:
    """Read identity and every object of interest; None where the drive does not have it.

    Raises
    ------
    SdoError
        The drive does not answer.
    """
    sdo = SdoClient(bus, axis.config.node_id, axis.profile.sdo.timeout_s, axis.profile.sdo.slow_timeout_s)
    try:
        identity = read_identity(sdo)
        return identity, {address: _read(sdo, address, kind) for address, kind in addresses(axis.profile).items()}
    finally:
        sdo.close()


def _read(sdo: SdoClient, address: Address, kind: str) -> int | None:
    try:
        return sdo.read(*address, kind)
    except SdoAbort:
        return None


def check_arm(bus: Bus, arm: ArmConfig, profiles: Sequence[DriveProfile]) -> list[CheckItem]:
    """Check the six drives of an arm; a drive that does not answer is a failing line, the others are still read.

    Drives in each other's place come first: what each of them says of its limits follows from it.

    Parameters
    ----------
    bus : Bus
    arm : ArmConfig
    profiles : sequence of 6 DriveProfile
        Of the axes, in order.
    """
    answers = probe(bus, [config.node_id for config in arm.axis])
    items: list[CheckItem] = []
    seen: list[SeenDrive] = []
    for joint, (config, profile) in enumerate(zip(arm.axis, profiles, strict=True), start=1):
        axis = Axis(joint, config, profile)
        if answers[config.node_id] > 1:
            items.append(_twice(axis, answers[config.node_id]))
            continue
        try:
            identity, readings = read_axis(bus, axis)
        except SdoError as error:
            items.append(_unreachable(axis, error))
            continue
        seen.append(SeenDrive(axis, identity, readings))
        items += judge_identity(axis, identity)
        items += judge_axis(axis, readings)
        items += judge_limits(axis, arm, readings)
    return judge_places(arm, seen) + items


def judge_bus_load(
    config: BusConfig, axes: Sequence[tuple[int, DriveProfile]], instruments: Sequence[InstrumentSetup] = ()
) -> CheckItem:
    """Worst-case share of the wire that the planned exchange of everything on a bus takes.

    Parameters
    ----------
    config : BusConfig
        Bit rate, SYNC period and pacing.
    axes : sequence of (node id, DriveProfile)
        Every drive on this bus.
    instruments : sequence of InstrumentSetup, optional
        Measuring devices beside them.

    Returns
    -------
    CheckItem
        Failing above `LOAD_LIMIT_PERCENT` where the clock paces the bus; in lockstep the bus paces itself.
    """
    sizes = [0]
    for node_id, profile in axes:
        plans = (rpdo_plan(node_id), *tpdo_plans(profile, node_id)[0])
        sizes += [plan.size_bytes for plan in plans]
    sizes += [plan.size_bytes for setup in instruments for plan in setup.plans()]
    bits = cycle_bits_worst(sizes)
    percent = load_percent(bits, config.sync_period_s, config.bitrate_bit_s)
    shortest_s = bits / (config.bitrate_bit_s * LOAD_LIMIT_PERCENT / 100.0)
    what = f"planned {percent:.0f} % of {config.bitrate_bit_s} bit/s in the worst case, {len(axes)} drives"
    what += f", {len(instruments)} measuring device" if instruments else ""
    if percent <= LOAD_LIMIT_PERCENT:
        return CheckItem("ok", "bus", what)
    advice = f"set sync_period_s to at least {shortest_s:.4f}"
    return CheckItem("fail" if config.pacing == "real" else "warn", "bus", what, advice)


def _twice(axis: Axis, answers: int) -> CheckItem:
    return CheckItem(
        "fail",
        f"J{axis.joint} node {axis.config.node_id}",
        f"{answers} devices answer at this node id",
        "give every drive a node id of its own before anything else",
    )


def _unreachable(axis: Axis, error: DriveError) -> CheckItem:
    return CheckItem(
        "fail",
        f"J{axis.joint} node {axis.config.node_id}",
        f"does not answer: {error.what}",
        "check power, wiring and node id; `servo-gateway scan` shows who is there",
    )
