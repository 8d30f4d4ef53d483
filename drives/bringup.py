"""Bring up the nodes of one arm: from the first question to a configuration that was read back.

The order of the functions is that in which they run: `CONNECTING`, which writes nothing, `CONFIGURING`, and in it
`SETTINGS` for each drive. `servo-gateway check -v` prints the first line of each.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final, NoReturn

from drives import drive_limits, other_pdos
from drives.abort import ABSENT
from drives.access import NodeAccess, ObjectAccess
from drives.bus import EMCY_BASE
from drives.bus_spec import NETWORKS
from drives.busload import load_percent
from drives.cia402 import AT_REST, FOLLOWING, Mode, decode_state, describe
from drives.discovery import FREE_S, count_answers, is_simulator, nmt_states, read_identity, refuse_foreign, require_one
from drives.drive import POLL_S, Cia402Drive
from drives.errors import (
    BusOverload,
    ConfigurationRefused,
    DriveError,
    DriveFault,
    SdoAbort,
    raise_failures,
)
from drives.heartbeat import NmtCommand, rounded_time, send_nmt
from drives.instrument import Instrument
from drives.ledger import KnownDevice, without_shared_serials
from drives.nodes import Node, Nodes
from drives.objects import OBJECTS, RPDO_MAPPING
from drives.pdo import OFFSETS, Step
from drives.scaling import read_constants

_SYNC_PRODUCER: Final = 1 << 30
#: Quick stop options (0x605A) with which the drive goes to SWITCH ON DISABLED at the end of its quick stop (CiA 402-2).
ENDING_OPTIONS: Final = (1, 2, 3)
#: The one that is written for a run where the drive holds another one: quick stop ramp 0x6085.
RAMP_OPTION: Final = 2
#: Exponents of 0x60C2:02 in the order in which they are tried after the drive's own.
PERIOD_EXPONENTS: Final = (-3, -4, -5, -6, -2, -1)
#: 0x1014: the emergency object does not exist; and: it has an identifier of 29 bits.
_EMCY_OFF: Final = 1 << 31
_LONG_ID: Final = 1 << 29

# -- connecting: nothing is written ------------------------------------------------------------------------------------


def listen_for_masters(nodes: Nodes) -> None:
    """Listen whether another master is active on the bus, before anything is sent."""
    refuse_foreign(nodes.bus, max(FREE_S, 3.0 * nodes.timing.period_s))


def identify(nodes: Nodes, *, wakes: bool = True) -> None:
    """Ask each node id how many devices answer, read each identity, and compare it with profile and cell.

    Failures of nodes are in `Nodes.failures_found`. `wakes`: as `count_answers`.
    """
    timeout_s = max(setup.profile.sdo.timeout_s for setup in nodes.setups)
    answers = count_answers(nodes.bus, nodes.node_ids, timeout_s, wakes=wakes)
    states = nmt_states(nodes.bus, [node_id for node_id, number in answers.items() if number == 0])
    nodes.drives = tuple(Cia402Drive(nodes.bus, setup, nodes.ledger) for setup in nodes.setups)
    nodes.instruments = tuple(Instrument(nodes.bus, setup, nodes.ledger) for setup in nodes.options.instruments)

    def compare(node: Node) -> None:
        require_one(node.node_id, answers[node.node_id], states.get(node.node_id))
        node.identity = read_identity(node.access.sdo)
        node.access.device = KnownDevice.of(node.identity, nodes.bus.spec.name)
        node.check_identity()

    nodes.failures_found = nodes.failures(compare, nodes.all)
    devices = without_shared_serials([node.access.device for node in nodes.all])
    for node, device in zip(nodes.all, devices, strict=True):
        node.access.device = device


def admit(nodes: Nodes) -> None:
    """Refuse a real drive in lockstep, and on a network that any computer can write to."""
    lockstep = nodes.timing.pacing == "lockstep"
    network = nodes.bus.spec.interface in NETWORKS and not nodes.options.allow_real_drive

    def refuse_real(node: Node) -> None:
        if not (lockstep or network) or is_simulator(node.access.sdo):
            return
        what = f"is not a simulator (object 0x5FFE), and any computer on {nodes.bus.spec} can write frames to it"
        advice = "connect it through its own CAN adapter, or accept the risk with allow_real_drive = true for this bus"
        if lockstep:
            what = "is not a simulator (object 0x5FFE): in lockstep it would receive SYNC as fast as it responds"
            advice = 'write pacing = "real" for this bus in the cell'
        raise ConfigurationRefused(what, node=node.node_id, advice=advice)

    nodes.each(refuse_real)


def receive_emergencies(nodes: Nodes) -> None:
    """Receive the emergency messages of each drive (0x1014); refuse one that sends none."""
    taken = {can_id for node in nodes.all for can_id, _ in node.answers}

    def receive(drive: Cia402Drive) -> None:
        standard = EMCY_BASE + drive.node_id
        can_id = _emergency_id(drive.access) or standard
        if can_id in taken:
            what = f"EMCY messages use the identifier {can_id:03X}, which another message also uses"
            drive.access.refuse(OBJECTS["emcy_cob_id"], what, f"set 0x1014 to {standard:#x} in the drive")
        taken.add(can_id)
        nodes.emcy.listen(nodes.bus, drive.node_id, can_id)

    raise_failures(nodes.failures(receive, nodes.drives))


def _emergency_id(access: NodeAccess) -> int | None:
    """Return the CAN id of the emergency messages of a node; None = not stated, the standard identifier applies."""
    entry, standard = OBJECTS["emcy_cob_id"], f"set 0x1014 to {EMCY_BASE + access.node_id:#x} in the drive"
    cob_id = access.read_readable(entry)
    if cob_id is None:
        return None
    if cob_id & _EMCY_OFF:
        what = f"EMCY messages are switched off (0x1014 = {cob_id:#010x}): a fault would not be explained"
        access.refuse(entry, what, standard)
    if cob_id & _LONG_ID or not 0x080 < cob_id & 0x7FF < 0x780:
        what = f"EMCY messages use the identifier {cob_id:#010x}, which this master does not receive"
        access.refuse(entry, what, standard)
    return cob_id & 0x7FF


# -- configuring -------------------------------------------------------------------------------------------------------


def take_over_applied(nodes: Nodes) -> None:
    """Take the values of `config apply` as the originals; refuse a node whose originals are not certain."""
    nodes.each(lambda node: node.access.refuse_unfinished())
    nodes.each(lambda node: node.access.refuse_renamed())
    nodes.each(lambda node: node.access.adopt_applied())


def survey_pdos(nodes: Nodes) -> None:
    """Read which PDOs are valid that the exchange does not use."""

    def survey(node: Node) -> None:
        node.other_pdos = other_pdos.other_pdos(node.access, {plan.communication for plan in node.plans})
        node.left_pdos = tuple(pdo for pdo in node.other_pdos if not pdo.may_be_switched_off)

    nodes.each(survey)


def check_load(nodes: Nodes) -> None:
    """Refuse a worst-case bus load above the limit (real time)."""
    spec, allowed, bits = nodes.bus.spec, nodes.options.load_limit_percent, nodes.cycle_bits
    load = load_percent(bits, nodes.timing.period_s, spec.bitrate_bit_s)
    if nodes.timing.pacing == "real" and load > allowed:
        period_s = bits / (spec.bitrate_bit_s * allowed / 100.0)
        what = f"the exchange would fill {load:.0f} % of {spec} in the worst case, {allowed:.0f} % are allowed"
        raise BusOverload(what, advice=f"set sync_period_s to at least {math.ceil(period_s * 1e4) / 1e4:.4f}")


def set_up(nodes: Nodes) -> None:
    """Read and write the settings of each node; everything is read back."""

    def settle(node: Node) -> None:
        if isinstance(node, Instrument):
            for setting in DEVICE_SETTINGS:
                setting(node, nodes.timing.period_s)
            return
        for setting in SETTINGS:
            setting(node, nodes.timing.period_s)

    nodes.each(settle)


# -- settings of one node, in their order ------------------------------------------------------------------------------


def check_disabled(drive: Cia402Drive, _period_s: float) -> None:
    """Refuse a drive that is already enabled."""
    refuse_enabled(drive.access)


def refuse_enabled(access: ObjectAccess) -> None:
    """Refuse a drive that is enabled; raises `DriveFault`."""
    status = access.read(OBJECTS["statusword"])
    if decode_state(status) not in AT_REST:
        raise DriveFault(
            f"is in {describe(status)} before this master enabled it",
            node=access.node_id,
            index=0x6041,
            code=status,
            advice="another master controls it, or a run was interrupted: disable it with `servo-gateway restore CELL`",
        )


def read_scale(drive: Cia402Drive, period_s: float) -> None:
    """Read rated values and encoder resolution (scaling of the profile)."""
    drive.set_scale(read_constants(drive.setup.profile, drive.access.read, drive.node_id), period_s)


def check_units(device: Instrument, _period_s: float) -> None:
    """Compare the units of a measuring device with the cell (0x6131, 0x6132)."""
    device.check_units()


def check_sync(node: Node, _period_s: float) -> None:
    """Refuse a node that takes SYNC with another identifier or a counter, or produces it (0x1005, 0x1019)."""
    access = node.access
    cob_id = access.read_readable(OBJECTS["sync_cob_id"])
    if cob_id is not None and (cob_id & 0x7FF != 0x080 or cob_id & _SYNC_PRODUCER):
        what = f"SYNC COB-ID is {cob_id:#010x}: it must be 0x80, and the drive must not produce SYNC"
        access.refuse(OBJECTS["sync_cob_id"], what, "set 0x1005 to 0x80")
    overflow = access.read_readable(OBJECTS["sync_counter_overflow"])
    if overflow:
        what = f"expects SYNC frames with a counter (0x1019 = {overflow})"
        access.refuse(OBJECTS["sync_counter_overflow"], what, "set 0x1019 to 0")


def leave_operational(node: Node, _period_s: float) -> None:
    """Command NMT state PRE-OPERATIONAL, in which no PDO is sent or taken."""
    send_nmt(node.access.bus, NmtCommand.ENTER_PREOPERATIONAL, node.node_id)


def clear_offsets(drive: Cia402Drive, _period_s: float) -> None:
    """Write 0 to the velocity and torque offsets (0x60B1, 0x60B2) where this run or an earlier master uses them."""
    access, setup = drive.access, drive.setup
    for name, entry in OFFSETS.items():
        if name in setup.offsets or access.is_in_ledger(entry.index, RPDO_MAPPING + 1) or access.read_readable(entry):
            access.write(entry, 0, "clear the offset of an earlier run")


def settle_sync_period(node: Node, period_s: float) -> None:
    """End the node's own supervision of the SYNC period (0x1006), since SYNC pauses while nothing moves.

    The object is set to 0, or to our period where the node does not take 0.

    Raises
    ------
    ConfigurationRefused
        It waits for another period, and the profile does not allow changing that.
    SdoError
        A transfer failed.
    """
    access, entry = node.access, OBJECTS["communication_cycle_period"]
    period_us = round(period_s * 1e6)
    held_us = access.read_readable(entry)
    if not held_us:
        return
    if not access.may_write(entry.index):
        if held_us != period_us:
            what = f"waits for a SYNC every {held_us} us, the master sends one every {period_us} us"
            access.refuse(entry, what, "set 0x1006 to 0 in the drive, or add 0x1006 to write.allow")
        return
    reason = "SYNC is produced by the master with its own period"
    try:
        access.write(entry, 0, reason)
    except SdoAbort:
        access.write(entry, period_us, reason)


def switch_off_pdos(node: Node, _period_s: float) -> None:
    """Switch off the PDOs that the exchange does not use; refuse one that stays on and carries a controlword."""
    node.left_pdos = tuple(pdo for pdo in node.other_pdos if not other_pdos.switch_off(node.access, pdo))


def map_pdos(node: Node, _period_s: float) -> None:
    """Map the PDOs of the exchange (0x1400, 0x1600, 0x1800, 0x1A00 and following)."""
    for plan in node.plans:
        node.access.map_pdo(plan)


def limit_position(drive: Cia402Drive, _period_s: float) -> None:
    """Narrow the drive's own position limits to those of the axis (0x607D), where profile and drive allow it."""
    if drive.setup.position_limit_rad is not None:
        drive_limits.write_position_limits(drive.access, drive.limit_count, drive.scale.constants.counts_per_revolution)


def limit_torque(drive: Cia402Drive, _period_s: float) -> None:
    """Lower the drive's own torque limit to what the arm can need (0x6072), where profile and drive allow it."""
    rated_nm = drive.setup.profile.rated_torque_nm(drive.access.read)
    need_nm = drive.setup.torque_limit_nm
    permille = None if need_nm is None or rated_nm is None else math.ceil(1000.0 * need_nm / rated_nm - 1e-9)
    drive_limits.limit_torque(drive.access, permille)


def set_mode(drive: Cia402Drive, _period_s: float) -> None:
    """Set the cyclic mode of the profile (0x6060), and refuse a drive that shows another (0x6061).

    Some drives show 0 until they are enabled: enabling reads it again from every drive.
    """
    access, mode, kind = drive.access, drive.mode, OBJECTS["interpolation_kind"]
    if mode is Mode.INTERPOLATED_POSITION and access.read_readable(kind):
        access.write(kind, 0, "linear interpolation")
    try:
        access.write(OBJECTS["mode"], mode.value, f"mode {mode}")
    except SdoAbort as abort:
        if abort.code not in ABSENT:
            others = " or ".join(f"cyclic_mode = {each.value}" for each in FOLLOWING if each is not mode)
            abort.advice = f"enable mode {mode.value} in the drive, or set {others} in [state_machine] of its profile"
        raise
    check_mode(drive, access.profile.state_machine.transition_timeout_s)


def check_mode(drive: Cia402Drive, wait_s: float = 0.0) -> None:
    """Refuse a drive that still shows another mode (0x6061) after a time; 0 is none: see `set_mode`."""
    deadline_s = time.monotonic() + wait_s
    while (shown := drive.access.read(OBJECTS["mode_display"])) not in (0, drive.mode.value):
        if time.monotonic() >= deadline_s:
            refuse_mode(drive.access, drive.mode, shown)
        drive.access.bus.listen(POLL_S)


def refuse_mode(access: ObjectAccess, mode: Mode, shown: int | None) -> NoReturn:
    """Refuse a drive whose 0x6061 shows another mode, or None where it did not answer."""
    advice = "the drive does not support this mode in its present setting: see 0x6502"
    what = (
        f"shows mode {shown} instead of {mode.value}" if shown is not None else f"cannot be read; {mode.value} was set"
    )
    access.refuse(OBJECTS["mode_display"], what, advice)


def set_interpolation_period(drive: Cia402Drive, period_s: float) -> None:
    """Set the interpolation period to the SYNC period (0x60C2); where it may not be written, it has to be that already.

    The exponent of the drive is kept where the period is a whole number in it; else others are tried. Exponent and
    value are both written, in this order, if one of them differs: some drives apply a value only then.

    Raises
    ------
    ConfigurationRefused
        The drive interpolates over another period, and the profile does not allow changing that.
    SdoError
        A transfer failed.
    """
    access = drive.access
    value_entry, exponent_entry = OBJECTS["interpolation_time_value"], OBJECTS["interpolation_time_index"]
    held = access.read_optional(value_entry)
    if held is None:
        return
    if not access.may_write(value_entry.index):
        check_interpolation_period(access, period_s)
        return
    reason, own = "interpolation over one SYNC period", access.read(exponent_entry)
    refusals: list[SdoAbort | ConfigurationRefused] = []
    for value, exponent in decimal_periods(period_s, own):
        exponent_step = Step(*exponent_entry.address, exponent_entry.type, exponent, reason)
        value_step = Step(*value_entry.address, value_entry.type, value, reason)
        try:
            if (value, exponent) != (held, own):
                access.note_steps([exponent_step, value_step])
                with suppress(SdoAbort):  # a fixed exponent; `write` refuses where it is another one
                    access.write_step(exponent_step)
            access.write(exponent_entry, exponent, reason)
            if (value, exponent) != (held, own):
                access.write_step(value_step)
            access.write(value_entry, value, reason)
            return
        except (SdoAbort, ConfigurationRefused) as error:
            refusals.append(error)
    raise refusals[0]


def check_interpolation_period(access: NodeAccess, period_s: float) -> None:
    """Refuse a drive whose interpolation period (0x60C2) is not the SYNC period; raises `ConfigurationRefused`."""
    entry = OBJECTS["interpolation_time_value"]
    value = access.read_optional(entry)
    if value is None:
        return
    held_s = value * 10.0 ** access.read(OBJECTS["interpolation_time_index"])
    if not math.isclose(held_s, period_s, rel_tol=1e-6):
        what = f"the drive interpolates over {held_s:g} s, the master sends a SYNC every {period_s:g} s"
        access.refuse(entry, what, "set 0x60C2 to the SYNC period in the drive, or add 0x60C2 to write.allow")


def decimal_periods(seconds: float, own_exponent: int = PERIOD_EXPONENTS[0]) -> tuple[tuple[int, int], ...]:
    """Return a period as pairs of value and decimal exponent of 0x60C2, e.g. 0.004 -> (4, -3), (40, -4).

    Parameters
    ----------
    seconds : float
    own_exponent : int
        Exponent that the drive holds; it comes first.

    Raises
    ------
    ConfigurationRefused
        It is not an integer of at most 255 times a power of ten.
    """
    exponents = dict.fromkeys((own_exponent, *PERIOD_EXPONENTS))
    values = [(seconds / 10.0**exponent, exponent) for exponent in exponents]
    pairs = [
        (round(value), exponent)
        for value, exponent in values
        if 1 <= round(value) <= 255 and abs(value - round(value)) < 1e-9 * value
    ]
    if not pairs:
        what = f"SYNC period {seconds} s cannot be written as 0x60C2"
        advice = "choose a period such as 0.004 s or 0.0025 s"
        raise ConfigurationRefused(what, index=0x60C2, subindex=1, advice=advice)
    return tuple(pairs)


def set_heartbeat(drive: Cia402Drive, _period_s: float) -> None:
    """Set the period of the drive's heartbeat (0x1017), where the profile states one; with node guarding there is none.

    A node with a heartbeat does not answer node guarding (CiA 301, 7.2.8.3).
    """
    heartbeat, entry = drive.setup.profile.heartbeat, OBJECTS["producer_heartbeat"]
    if heartbeat.producer_ms is not None:
        rounded = rounded_time(heartbeat.producer_ms, heartbeat.producer_ms)
        drive.access.write(entry, heartbeat.producer_ms, "heartbeat of the drive", rounded=rounded)
    elif heartbeat.watchdog == "node guarding" and drive.access.read_readable(entry):
        drive.access.write(entry, 0, "node guarding instead of a heartbeat")


def settle_quick_stop(drive: Cia402Drive, _period_s: float) -> None:
    """Set quick stop option 2 where the drive's own does not end in SWITCH ON DISABLED (0x605A: 1 to 3 do).

    With 5 to 8 the drive stays in QUICK STOP ACTIVE, from where the next controlword of the motion would enable it
    again (transition 16) although it has stopped by itself. With 0 it coasts.

    Raises
    ------
    ConfigurationRefused
        The drive holds another option, and it cannot be written.
    SdoError
        A transfer failed.
    """
    access, entry = drive.access, OBJECTS["quick_stop_option"]
    option = access.read_optional(entry)
    if option is None:
        return
    ends = option in ENDING_OPTIONS
    if not access.may_write(entry.index):
        if not ends:
            advice = "set 1, 2 or 3 in the drive, or add 0x605A to write.allow of its profile"
            access.refuse(entry, f"holds {option}: a quick stop does not end in SWITCH ON DISABLED", advice)
        return
    try:
        access.write(entry, option if ends else RAMP_OPTION, "a quick stop ends in SWITCH ON DISABLED")
    except SdoAbort as abort:
        what = (
            f"holds {option} and refuses {RAMP_OPTION} ({abort.what}): a quick stop does not end in SWITCH ON DISABLED"
        )
        access.refuse(
            entry, what, "set 1, 2 or 3 with the maker's tool; this drive cannot be moved with another option"
        )


def set_abort_connection(drive: Cia402Drive, _period_s: float) -> None:
    """Set the reaction to a lost master (0x6007), where the drive has one to set."""
    option = drive.setup.profile.heartbeat.abort_connection
    if option is not None:
        reason = "reaction of the drive when the master's heartbeat stops"
        drive.access.write(OBJECTS["abort_connection_option"], option, reason)


def disarm(drive: Cia402Drive, _period_s: float) -> None:
    """End the drive's monitoring of the master until it is enabled (0x1016, or 0x100C and 0x100D)."""
    drive.disarm()


# -- order -------------------------------------------------------------------------------------------------------------

CONNECTING: Final[tuple[Callable[[Nodes], None], ...]] = (
    listen_for_masters,
    identify,
    admit,
    receive_emergencies,
)
CONFIGURING: Final[tuple[Callable[[Nodes], None], ...]] = (
    take_over_applied,
    survey_pdos,
    check_load,
    set_up,
    check_load,  # with the PDOs that could not be switched off
)
SETTINGS: Final[tuple[Callable[[Cia402Drive, float], None], ...]] = (
    check_disabled,
    read_scale,
    check_sync,
    leave_operational,
    clear_offsets,
    settle_sync_period,
    switch_off_pdos,
    map_pdos,
    limit_position,
    limit_torque,
    set_mode,
    set_interpolation_period,
    set_heartbeat,
    settle_quick_stop,
    set_abort_connection,
    disarm,
)
DEVICE_SETTINGS: Final[tuple[Callable[[Instrument, float], None], ...]] = (
    check_sync,
    check_units,
    leave_operational,
    settle_sync_period,
    switch_off_pdos,
    map_pdos,
)


def connect(nodes: Nodes) -> None:
    """Find every node and compare it with its profile; no object is written.

    Raises
    ------
    NodeMissing, DuplicateNode, IdentityMismatch, SeveralFailures
        All problems of all nodes at once.
    ConfigurationRefused
        Lockstep, or a network as the bus, with a real drive; emergency messages switched off.
    ForeignMaster
        Another master is active on the bus; nothing was sent.
    """
    nodes.close()
    try:
        for step in CONNECTING:
            step(nodes)
            raise_failures(nodes.failures_found)
    except DriveError:
        nodes.close()
        raise


def connect_for_restore(nodes: Nodes) -> None:
    """Connect as `connect` does, without nodes that do not answer or differ: `Nodes.failures_found`.

    Raises
    ------
    ForeignMaster
        Another master is active on the bus; nothing was sent.
    """
    nodes.close()
    listen_for_masters(nodes)
    identify(nodes)
    absent = {failure.node for failure in nodes.failures_found}
    for node in nodes.all:
        if node.node_id in absent:
            node.access.sdo.close()
    nodes.drives = tuple(drive for drive in nodes.drives if drive.node_id not in absent)
    nodes.instruments = tuple(device for device in nodes.instruments if device.node_id not in absent)


def configure(nodes: Nodes) -> None:
    """Map the PDOs, set mode, period, heartbeats and the reaction to a lost master; everything is read back.

    Raises
    ------
    BusOverload
        Real time: the planned bus load exceeds the limit.
    SeveralFailures or DriveError
        Failures of all nodes at once.
    """
    for step in CONFIGURING:
        step(nodes)
    nodes.ledger.settle()


def steps() -> tuple[str, ...]:
    """Return what bring-up does, in its order, one line each."""
    order = [each for step in (*CONNECTING, *CONFIGURING) for each in (SETTINGS if step is set_up else (step,))]
    return tuple(dict.fromkeys((each.__doc__ or "").splitlines()[0] for each in order))
