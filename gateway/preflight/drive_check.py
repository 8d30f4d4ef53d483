"""Pre-flight check: read the drives and assess them. Nothing is written, nothing moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from drives.abort import ABSENT
from drives.bringup import identify, listen_for_masters
from drives.busload import LOAD_LIMIT_PERCENT, cycle_bits_worst, load_percent
from drives.errors import DriveError, IdentityMismatch, SdoAbort, SdoProtocolError, raise_failures
from drives.instrument import InstrumentSetup
from drives.ledger import KnownDevice, WriteLedger
from drives.nodes import Nodes
from drives.objects import OBJECTS, object_name
from drives.pdo import rpdo_plans, tpdo_plans
from drives.profile import DriveProfile
from drives.sdo import SdoClient
from drives.values import Identity
from gateway.cell.config import ArmConfig, BusConfig
from gateway.errors import FindingFailed
from gateway.preflight.coasting import judge_coasting
from gateway.preflight.rules import (
    Address,
    Axis,
    Readings,
    judge_identity,
    judge_place,
    judge_ranges,
    judge_settings,
    judge_state,
    used_objects,
)
from gateway.preflight.swap import SeenDrive, judge_places
from gateway.result.result import Finding

#: Objects read from every drive: state.
READ_LIVE: Final = ("statusword", "position", "digital_inputs", "torque_offset", "error_code")
#: Settings that have to be readable; settings whose values are checked where they are readable; and further ones.
NEEDED: Final = ("quick_stop_option", "fault_reaction_option")
CHECKED: Final = (
    "polarity",
    "gear_motor_revolutions",
    "gear_shaft_revolutions",
    "feed_constant_feed",
    "feed_constant_revolutions",
    "position_offset",
    "max_torque",
    "max_current",
    "positive_torque_limit",
    "negative_torque_limit",
)
FURTHER: Final = (
    "shutdown_option",
    "disable_operation_option",
    "halt_option",
    "following_error_window",
    "following_error_timeout",
    "rated_current",
    "rated_torque",
    "position_range_min",
    "position_range_max",
    "home_offset",
    "position_limit_min",
    "position_limit_max",
    "max_profile_velocity",
    "max_motor_speed",
    "profile_deceleration",
    "quick_stop_deceleration",
    "encoder_increments",
    "encoder_revolutions",
    "supported_modes",
)


def addresses(profile: DriveProfile) -> dict[Address, str]:
    """Return the objects to read, with their types, for a drive of this profile."""
    names = (*READ_LIVE, *NEEDED, *profile.loss_objects, *CHECKED, *FURTHER)
    wanted = {OBJECTS[name].address: OBJECTS[name].type for name in names}
    return wanted | used_objects(profile) | _references(profile)


def _references(profile: DriveProfile) -> dict[Address, str]:
    """Return the objects that the profile names, with their types."""
    conditions = [condition.object for condition in profile.conditions]
    references = (profile.torque.object, *profile.constant_objects, *conditions)
    return {(reference.index, reference.subindex): reference.type for reference in references}


def live_addresses(profile: DriveProfile) -> frozenset[Address]:
    """Return the objects of `addresses` that vary in operation: state, commands, position, torque."""
    shown = [profile.torque.object, *(condition.object for condition in profile.conditions)]
    named = {OBJECTS[name].address for name in READ_LIVE}
    return frozenset(named | used_objects(profile).keys() | {(each.index, each.subindex) for each in shown})


def read_objects(sdo: SdoClient, profile: DriveProfile) -> tuple[Readings, dict[Address, str]]:
    """Read every relevant object.

    Returns
    -------
    readings : mapping
        (index, subindex) -> value; None if the drive does not have the object.
    unread : dict
        (index, subindex) -> why an object that only informs could not be read; it is not in `readings`.

    Raises
    ------
    SdoError
        The drive does not answer, or refuses an object that is needed.
    """
    # without these a drive is not moved; the others only inform
    names = ("statusword", "position", *NEEDED, *profile.loss_objects)
    needed = frozenset(_references(profile)) | {OBJECTS[name].address for name in names}
    readings, unread = dict[Address, int | None](), dict[Address, str]()
    for address, kind in addresses(profile).items():
        try:
            readings[address] = sdo.read(*address, kind)
        except (SdoAbort, SdoProtocolError) as error:
            if isinstance(error, SdoAbort) and error.code in ABSENT:
                readings[address] = None
            elif address in needed:
                raise
            else:
                unread[address] = error.what
    return readings, unread


def as_left(readings: Readings, identity: Identity, ledger: WriteLedger, bus: str | None = None) -> Readings:
    """Return the objects of one drive with the original values of those that the gateway has written.

    They are written again whenever the drives are configured.
    """
    kept = dict(readings)
    for entry in ledger.of(KnownDevice.of(identity, bus)):
        held = kept.get(entry.address)
        if held is not None and entry.is_own(held) and entry.writer == "run":
            kept[entry.address] = entry.old
    return kept


def check_arm(arm: ArmConfig, nodes: Nodes) -> list[Finding]:
    """Find and check the drives of an arm; one that cannot be used is a failing item, the others are still read.

    Swapped drives are reported before the limit violations that result from the swap. Nothing is written, and a drive
    in NMT state STOPPED stays there.

    Parameters
    ----------
    arm : ArmConfig
    nodes : Nodes

    Raises
    ------
    ForeignMaster
        Another master is active: requests beside it could stop its arm.
    """
    listen_for_masters(nodes)
    identify(nodes, wakes=False)
    unusable = {each.node: each for each in nodes.failures_found if not isinstance(each, IdentityMismatch)}
    seen, failures = _read_drives(arm, nodes, unusable)
    return [*(_unreachable(axis, error) for axis, error in failures), *judge_drives(arm, seen)[0]]


def look_over(arm: ArmConfig, nodes: Nodes) -> tuple[list[Finding], tuple[Readings, ...]]:
    """Read and assess connected drives.

    Parameters
    ----------
    arm : ArmConfig
    nodes : Nodes
        Connected, not configured.

    Returns
    -------
    list of Finding
        Failing items that no later step refuses. A drive in fault or a joint outside its limits is refused later, when
        the drives are enabled or moved.
    tuple of Readings, one per axis
        (index, subindex) -> value before any write of the gateway; None if the drive has no such object.

    Raises
    ------
    SdoError, SeveralFailures
        Some drives do not answer or refuse an object; the error lists all of them.
    """
    seen, failures = _read_drives(arm, nodes, {})
    raise_failures([error for _, error in failures])
    return judge_drives(arm, seen)[1], tuple(drive.readings for drive in seen)


def _read_drives(
    arm: ArmConfig, nodes: Nodes, unusable: Mapping[int | None, DriveError]
) -> tuple[list[SeenDrive], list[tuple[Axis, DriveError]]]:
    """Read all drives but those that are known to be unusable; return what was read, and the failures."""
    seen: list[SeenDrive] = []
    failures: list[tuple[Axis, DriveError]] = []
    for joint, (config, drive) in enumerate(zip(arm.axis, nodes.drives, strict=True), start=1):
        axis = Axis(joint, config, drive.setup.profile)
        try:
            if (failure := unusable.get(drive.node_id)) is not None:
                raise failure
            readings, unread = read_objects(drive.access.sdo, axis.profile)
            as_it_was = as_left(readings, drive.identity, nodes.ledger, nodes.bus.spec.name)
            seen.append(SeenDrive(axis, drive.identity, as_it_was, unread))
        except DriveError as error:
            failures.append((axis, error))
    return seen, failures


def judge_drives(arm: ArmConfig, seen: Sequence[SeenDrive]) -> tuple[list[Finding], list[Finding]]:
    """Assess drives that were read, swapped drives first; also return the failing items as `look_over` does."""
    items = judge_places(arm, seen)
    refusing = [item for item in items if item.severity == "fail"]
    checked = {OBJECTS[name].address for name in CHECKED}
    for drive in seen:
        axis, readings = drive.axis, drive.readings
        items += [*judge_identity(axis, drive.identity), *judge_state(axis, readings)]
        items += judge_place(axis, arm, readings)
        for address, why in drive.unread.items():
            advice = "compare it with the manual: it is not checked" if address in checked else ""
            items.append(axis.item("warn" if advice else "info", address, f"not readable: {why}", advice))
        settings = [
            *judge_settings(axis, readings),
            *judge_coasting(axis, readings),
            *judge_ranges(axis, arm, readings),
        ]
        items += settings
        refusing += [item for item in settings if item.severity == "fail"]
    return items, refusing


def require_passed(items: Sequence[Finding], otherwise: str) -> None:
    """Raise an error if an item fails.

    Parameters
    ----------
    items : sequence of Finding
    otherwise : str
        Consequence of a failing item, such as `nothing is measured`.

    Raises
    ------
    FindingFailed
        The first failing item, and how many more there are.
    """
    failed = [item for item in items if item.severity == "fail"]
    if failed:
        first, more = failed[0], f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise FindingFailed(f"{otherwise}: {first.where}: {first.what}; {first.advice}{more}")


def judge_bus_load(
    config: BusConfig, axes: Sequence[tuple[int, DriveProfile]], instruments: Sequence[InstrumentSetup] = ()
) -> Finding:
    """Return the worst-case bus load of the planned exchange of all nodes.

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
    Finding
        Failing above `LOAD_LIMIT_PERCENT` in real time; in lockstep there is no limit.
    """
    sizes = [0]
    for node_id, profile in axes:
        plans = (*rpdo_plans(profile, node_id), *tpdo_plans(profile, node_id)[0])
        sizes += [plan.size_bytes for plan in plans]
    sizes += [plan.size_bytes for setup in instruments for plan in setup.plans()]
    bits = cycle_bits_worst(sizes)
    percent = load_percent(bits, config.sync_period_s, config.bitrate_bit_s)
    shortest_s = bits / (config.bitrate_bit_s * LOAD_LIMIT_PERCENT / 100.0)
    what = f"planned {percent:.0f} % of {config.bitrate_bit_s} bit/s in the worst case, {len(axes)} drives"
    what += f", {len(instruments)} measuring device" if instruments else ""
    if percent <= LOAD_LIMIT_PERCENT:
        return Finding("ok", "bus", what)
    advice = f"set sync_period_s to at least {shortest_s:.4f}"
    return Finding("fail" if config.pacing == "real" else "warn", "bus", what, advice)


def _unreachable(axis: Axis, error: DriveError) -> Finding:
    where = f"J{axis.joint} node {axis.config.node_id}"
    if isinstance(error, SdoAbort) and error.index is not None:
        place = f"{where}:{object_name(error.index, error.subindex or 0)}"
        return Finding("fail", place, f"cannot be read: {error.what}", error.advice)
    return Finding("fail", where, error.what, f"{error.advice}; `servo-gateway scan` lists the nodes on the bus")
