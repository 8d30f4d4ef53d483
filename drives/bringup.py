"""Read and configure a CiA 402 drive before it takes part in the SYNC exchange."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from typing import Final, NoReturn, Protocol

from drives.access import Entry, NodeAccess, ObjectAccess
from drives.cia402 import AT_REST, Mode, decode_state, describe
from drives.errors import ConfigurationRefused, DriveFault, IdentityMismatch, SdoAbort, SdoProtocolError
from drives.objects import OBJECTS
from drives.pdo import Step
from drives.profile import CountsFromObjects, DriveProfile, Rated
from drives.scaling import Constants
from drives.sdo import SdoClient
from drives.values import Identity

#: Time between two readings of what a drive takes a moment to do.
POLL_S: Final = 0.005
_SYNC_PRODUCER: Final = 1 << 30
#: Quick stop options (0x605A) with which the drive goes to SWITCH ON DISABLED at the end of its quick stop (CiA 402-2).
ENDING_OPTIONS: Final = (1, 2, 3)
#: The one that is written for a run where the drive holds another one: quick stop ramp 0x6085.
RAMP_OPTION: Final = 2
#: Exponents of 0x60C2:02 in the order in which they are tried after the drive's own.
PERIOD_EXPONENTS: Final = (-3, -4, -5, -6, -2, -1)
#: Value of object 0x5FFE of a simulated node.
SIMULATOR_NAME: Final = "servo-sim"
#: 0x1014: the emergency object does not exist; and: it has an identifier of 29 bits.
_EMCY_OFF: Final = 1 << 31
_LONG_ID: Final = 1 << 29


def read_identity(sdo: SdoClient) -> Identity:
    """Read identity and version objects of a node; an object that it does not have, or refuses, is None."""

    def number(name: str) -> int | None:
        entry = OBJECTS[name]
        try:
            return sdo.read(entry.index, entry.subindex, entry.type)
        except (SdoAbort, SdoProtocolError):
            return None

    def text(name: str) -> str | None:
        try:
            return sdo.read_text(OBJECTS[name].index)
        except SdoAbort:
            return None

    return Identity(
        node_id=sdo.node_id,
        device_type=number("device_type"),
        vendor_id=number("vendor_id"),
        product_code=number("product_code"),
        revision=number("revision"),
        serial_number=number("serial_number"),
        name=text("device_name"),
        hardware_version=text("hardware_version"),
        software_version=text("software_version"),
    )


def is_simulator(sdo: SdoClient) -> bool:
    """Return whether a node reports that it is simulated; a node without the object counts as real.

    Raises
    ------
    SdoTimeout, SdoProtocolError
        The node does not respond.
    """
    entry = OBJECTS["simulator_name"]
    try:
        return sdo.read_text(entry.index, entry.subindex) == SIMULATOR_NAME
    except SdoAbort:
        return False


def emergency_id(access: NodeAccess) -> int | None:
    """CAN id of the emergency messages of a node (0x1014); None = not stated, the standard identifier applies.

    Raises
    ------
    ConfigurationRefused
        It sends none, or with an id that is not listened to.
    """
    entry = OBJECTS["emcy_cob_id"]
    cob_id = access.read_optional(entry)
    if cob_id is None:
        return None
    if cob_id & _EMCY_OFF:
        what = f"EMCY messages are switched off (0x1014 = {cob_id:#010x}): a fault would not be explained"
        access.refuse(entry, what, f"set 0x1014 to {0x80 + access.node_id:#x} in the drive")
    if cob_id & _LONG_ID or not 0x080 < cob_id & 0x7FF < 0x780:
        what = f"EMCY messages use the identifier {cob_id:#010x}, which this master does not receive"
        access.refuse(entry, what, f"set 0x1014 to {0x80 + access.node_id:#x} in the drive")
    return cob_id & 0x7FF


def check_identity(identity: Identity, profile: DriveProfile) -> None:
    """Compare the identity of a device with its profile.

    Raises
    ------
    IdentityMismatch
        Vendor, product, firmware or device type differ; one error lists all differences.
    """
    problems = identity.mismatches(profile)
    if identity.device_type is not None and not identity.is_drive:
        problems.append(f"device type {identity.device_type:#010x} is not a CiA 402 drive")
    if problems:
        raise IdentityMismatch(
            f"{'; '.join(problems)} (profile {profile.name})",
            node=identity.node_id,
            index=0x1018,
            subindex=1,
            advice="check wiring and node ids, or choose the profile of this drive and firmware",
        )


def check_at_rest(access: ObjectAccess) -> None:
    """Refuse a drive that is already enabled.

    Raises
    ------
    DriveFault
        The drive is enabled.
    """
    status = access.read(OBJECTS["statusword"])
    if decode_state(status) not in AT_REST:
        raise DriveFault(
            f"is in {describe(status)} before this master enabled it",
            node=access.node_id,
            index=0x6041,
            code=status,
            advice="another master controls it, or a run was interrupted: disable it with `servo-gateway restore CELL`",
        )


class Readable(Protocol):
    """Source of a drive's constants: the drive itself, or its recorded SDO responses."""

    @property
    def profile(self) -> DriveProfile:
        """Return the drive's profile."""
        ...

    def read(self, entry: Entry, /) -> int:
        """Return the value of an object."""
        ...

    def refuse(self, entry: Entry, what: str, advice: str, /) -> NoReturn:
        """Raise `ConfigurationRefused` about an object."""
        ...


def read_constants(access: Readable) -> Constants:
    """Read the constants that the profile takes from the drive: rated values and encoder resolution.

    Raises
    ------
    ConfigurationRefused
        A value of zero.
    SdoError
        An object cannot be read.
    """
    profile = access.profile
    return Constants(
        torque_rated=_rated(access, profile.torque.rated),
        current_rated_a=None if profile.current is None else _rated(access, profile.current.rated),
        offset_rated=None if profile.torque_offset is None else _rated(access, profile.torque_offset.rated),
        counts_per_revolution=read_resolution(access),
    )


def read_resolution(access: Readable) -> float:
    """Return the position counts of one motor revolution; raises as `read_constants`."""
    counts = access.profile.position.counts_per_revolution
    if not isinstance(counts, CountsFromObjects):
        return counts.value
    per = 1 if counts.per is None else access.read(counts.per)
    if counts.per is not None and per == 0:
        access.refuse(counts.per, "is 0", "set the encoder resolution in the drive")
    return access.read(counts.object) / per


def _rated(access: Readable, rated: Rated | None) -> float | None:
    if rated is None or rated.object is None or rated.unit is None:
        return None if rated is None else rated.value
    raw = access.read(rated.object)
    if raw <= 0:
        access.refuse(rated.object, f"the rated value is {raw}", "set it in the drive, or give it in the profile")
    return raw * rated.unit


def check_sync(access: NodeAccess) -> None:
    """Check that the drive consumes SYNC with the standard identifier and without a counter.

    Raises
    ------
    ConfigurationRefused
        The drive expects another SYNC identifier, or produces SYNC itself.
    """
    cob_id = access.read_optional(OBJECTS["sync_cob_id"])
    if cob_id is not None and (cob_id & 0x7FF != 0x080 or cob_id & _SYNC_PRODUCER):
        what = f"SYNC COB-ID is {cob_id:#010x}: it must be 0x80, and the drive must not produce SYNC"
        access.refuse(OBJECTS["sync_cob_id"], what, "set 0x1005 to 0x80")
    overflow = access.read_optional(OBJECTS["sync_counter_overflow"])
    if overflow:
        access.refuse(
            OBJECTS["sync_counter_overflow"],
            f"expects SYNC frames with a counter (0x1019 = {overflow})",
            "set 0x1019 to 0",
        )


def settle_sync_period(access: NodeAccess, sync_period_s: float) -> None:
    """Make sure that a node does not supervise a SYNC period (0x1006) that differs from the master's.

    SYNC pauses while nothing moves; a node that supervises the period would raise a communication error then. The
    object is set to 0 (no supervision), or to our period where the node does not take 0.

    Raises
    ------
    ConfigurationRefused
        It waits for another period, and the profile does not allow changing that.
    SdoError
        A transfer failed.
    """
    entry = OBJECTS["communication_cycle_period"]
    period_us = round(sync_period_s * 1e6)
    found_us = access.read_optional(entry)
    if not found_us:
        return
    if not access.may_write(entry.index):
        if found_us != period_us:
            what = f"waits for a SYNC every {found_us} us, the master sends one every {period_us} us"
            access.refuse(entry, what, "set 0x1006 to 0 in the drive, or add 0x1006 to write.allow")
        return
    reason = "SYNC is produced by the master with its own period"
    try:
        access.write(entry, 0, reason)
    except SdoAbort:
        access.write(entry, period_us, reason)


def settle_quick_stop(access: NodeAccess) -> None:
    """Write quick stop option 2 (0x605A) where the drive's own does not end in SWITCH ON DISABLED (1 to 3 do).

    With 5 to 8 the drive stays in QUICK STOP ACTIVE, from where the next controlword of the motion would enable it
    again (transition 16) although it has stopped by itself. With 0 it coasts.

    Raises
    ------
    ConfigurationRefused
        The drive holds another option, and it cannot be written.
    SdoError
        A transfer failed.
    """
    entry = OBJECTS["quick_stop_option"]
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


def set_mode(access: ObjectAccess, mode: Mode) -> None:
    """Set the mode of operation; wait for it in 0x6061 if the drive displays it before it is enabled."""
    access.write(OBJECTS["mode"], mode.value, f"mode {mode.name.lower().replace('_', ' ')}")
    if access.profile.state_machine.mode_before_enable:
        check_mode(access, mode)


def check_mode(access: ObjectAccess, mode: Mode) -> None:
    """Wait until 0x6061 (modes of operation display) shows a mode.

    Raises
    ------
    ConfigurationRefused
        It does not.
    """
    deadline = time.monotonic() + access.profile.state_machine.transition_timeout_s
    while (shown := access.read(OBJECTS["mode_display"])) != mode.value:
        if time.monotonic() > deadline:
            refuse_mode(access, mode, shown)
        access.bus.listen(POLL_S)


def refuse_mode(access: ObjectAccess, mode: Mode, shown: int | None) -> NoReturn:
    """Refuse a drive whose 0x6061 shows another mode, or None where it did not answer."""
    advice = "the drive does not support this mode in its present setting: see 0x6502"
    if shown == 0 and access.profile.state_machine.mode_before_enable:
        advice += "; if it shows 0 until it is enabled, set mode_before_enable = false in the profile"
    what = (
        f"shows mode {shown} instead of {mode.value}" if shown is not None else f"cannot be read; {mode.value} was set"
    )
    access.refuse(OBJECTS["mode_display"], what, advice)


def set_interpolation_period(access: NodeAccess, sync_period_s: float) -> None:
    """Set the interpolation period (0x60C2) to the SYNC period; where it may not be written, it has to be that already.

    The exponent of the drive is kept where the period is a whole number in it; else others are tried. Exponent and
    value are both written, in this order, if one of them differs: some drives apply a value only then.

    Raises
    ------
    ConfigurationRefused
        The drive interpolates over another period, and the profile does not allow changing that.
    SdoError
        A transfer failed.
    """
    value_entry, exponent_entry = OBJECTS["interpolation_time_value"], OBJECTS["interpolation_time_index"]
    held = access.read_optional(value_entry)
    if held is None:
        return
    if not access.may_write(value_entry.index):
        check_interpolation_period(access, sync_period_s)
        return
    reason, own = "interpolation over one SYNC period", access.read(exponent_entry)
    refusals: list[SdoAbort | ConfigurationRefused] = []
    for value, exponent in decimal_periods(sync_period_s, own):
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


def check_interpolation_period(access: NodeAccess, sync_period_s: float) -> None:
    """Refuse a drive whose interpolation period (0x60C2) is not the SYNC period.

    Raises
    ------
    ConfigurationRefused
    """
    entry = OBJECTS["interpolation_time_value"]
    value = access.read_optional(entry)
    if value is None:
        return
    held_s = value * 10.0 ** access.read(OBJECTS["interpolation_time_index"])
    if not math.isclose(held_s, sync_period_s, rel_tol=1e-6):
        what = f"the drive interpolates over {held_s:g} s, the master sends a SYNC every {sync_period_s:g} s"
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
