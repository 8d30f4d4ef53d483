"""Conformance of the services of one drive to CiA 301 and CiA 402-2. The axis is disabled; nothing moves.

An object is written only with the value that it holds, or where the profile allows writing it. A drive that accepts
what it has to refuse therefore stays as it was.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from drives.abort import ABSENT, NO_OBJECT, NO_SUBINDEX
from drives.bus import EMCY_BASE
from drives.cia402 import DISABLE_VOLTAGE, SWITCH_ON, Mode, State, decode_state
from drives.drive import Cia402Drive
from drives.errors import DriveError, SdoAbort
from drives.objects import OBJECTS
from drives.sdo import ONCE
from gateway.result.drive_test import ClauseResult

SDO: Final = "CiA 301 7.2.4 SDO"
EMCY: Final = "CiA 301 7.2.7 EMCY"
HEARTBEAT: Final = "CiA 301 7.2.8.3 heartbeat"
NMT: Final = "CiA 301 7.2.8.2 NMT"
PDO: Final = "CiA 301 7.2.2 PDO"
SYNC: Final = "CiA 301 7.2.5 SYNC"
STORE: Final = "CiA 301 7.5.2.13 store parameters"
RESTORE: Final = "CiA 301 7.5.2.14 restore default parameters"
STATES: Final = "CiA 402-2 8 state machine"
MODES: Final = "CiA 402-2 modes of operation"
#: An index of the area that CiA 301 reserves, and a subindex beyond those of the identity object.
_UNUSED_INDEX: Final = 0x0FFF
_UNUSED_SUBINDEX: Final = 0x7F
_READ_ONLY_ABORTS: Final = frozenset({0x06010002, 0x06010000, 0x08000021, 0x08000022})
_LENGTH_ABORTS: Final = frozenset({0x06070010, 0x06070012, 0x06070013})
_STORE_ABORTS: Final = frozenset({0x08000020, 0x08000021, 0x08000022, 0x06090030, 0x08000000})
_SERVO: Final = 402


class NotTestedError(Exception):
    """The clause does not apply, or testing it would change what the drive holds."""


class ClauseFailedError(Exception):
    """The drive does not do what the clause requires."""


@dataclass(frozen=True, slots=True)
class ServiceCheck:
    """One check of a drive: `run` returns the detail of a pass, or raises."""

    clause: str
    name: str
    run: Callable[[Cia402Drive], str]

    def result(self, drive: Cia402Drive) -> ClauseResult:
        """Run the check; a drive that does not answer has failed it."""
        try:
            return ClauseResult(self.clause, self.name, "pass", self.run(drive))
        except NotTestedError as why:
            return ClauseResult(self.clause, self.name, "not tested", str(why))
        except (ClauseFailedError, DriveError) as error:
            return ClauseResult(self.clause, self.name, "fail", str(error))


def check_services(drive: Cia402Drive) -> list[ClauseResult]:
    """Return the results of all checks of a disabled drive in NMT state PRE-OPERATIONAL."""
    return [check.result(drive) for check in CHECKS]


def _refused(action: Callable[[], object], allowed: frozenset[int], what: str) -> str:
    """Return the abort code with which an access was refused as the standard says."""
    try:
        action()
    except SdoAbort as abort:
        if abort.code in allowed:
            return f"refused with 0x{abort.code:08X}"
        codes = " or ".join(f"0x{code:08X}" for code in sorted(allowed))
        raise ClauseFailedError(f"{what} is refused with 0x{abort.code or 0:08X} instead of {codes}") from None
    raise ClauseFailedError(f"{what} is not refused")


def _not_tested(why: str) -> Callable[[Cia402Drive], str]:
    """Return a check that states why its clause is not tested."""

    def run(_drive: Cia402Drive) -> str:
        raise NotTestedError(why)

    return run


def _optional(drive: Cia402Drive, name: str) -> int:
    value = drive.access.read_optional(OBJECTS[name])
    if value is None:
        raise NotTestedError(f"the drive has no {OBJECTS[name]}")
    return value


def _expedited(drive: Cia402Drive) -> str:
    return f"0x1000 reads 0x{drive.access.read(OBJECTS['device_type'], ONCE):08X}"


def _segmented(drive: Cia402Drive) -> str:
    for index in (0x1008, 0x100A, 0x1009):
        try:
            text = drive.access.sdo.upload(index, 0, ONCE)
        except SdoAbort as abort:
            if abort.code not in ABSENT:
                raise
            continue
        if len(text) > 4:
            return f"0x{index:04X} has {len(text)} bytes"
    raise NotTestedError("the drive has no text of more than 4 bytes")


def _unknown_object(drive: Cia402Drive) -> str:
    what = f"reading 0x{_UNUSED_INDEX:04X}, which does not exist,"
    return _refused(lambda: drive.access.sdo.upload(_UNUSED_INDEX, 0, ONCE), frozenset({NO_OBJECT}), what)


def _unknown_subindex(drive: Cia402Drive) -> str:
    what = f"reading 0x1018:{_UNUSED_SUBINDEX:02X}, which does not exist,"
    return _refused(lambda: drive.access.sdo.upload(0x1018, _UNUSED_SUBINDEX, ONCE), frozenset({NO_SUBINDEX}), what)


def _write_read_only(drive: Cia402Drive) -> str:
    sdo, held = drive.access.sdo, drive.access.read(OBJECTS["device_type"])
    what = "writing 0x1000, which is constant,"
    return _refused(lambda: sdo.write(0x1000, 0, "u32", held, ONCE), _READ_ONLY_ABORTS, what)


def _wrong_length(drive: Cia402Drive) -> str:
    sdo, held = drive.access.sdo, _optional(drive, "producer_heartbeat")
    what = "writing 4 bytes to 0x1017, which has 2,"
    return _refused(lambda: sdo.write(0x1017, 0, "u32", held, ONCE), _LENGTH_ABORTS, what)


def _identity(drive: Cia402Drive) -> str:
    vendor = drive.access.read(OBJECTS["vendor_id"])
    if vendor == 0:
        raise ClauseFailedError("vendor id 0x1018:01 is 0")
    return f"vendor 0x{vendor:08X}"


def _device_type(drive: Cia402Drive) -> str:
    value = drive.access.read(OBJECTS["device_type"])
    if value & 0xFFFF != _SERVO:
        raise ClauseFailedError(f"0x1000 is 0x{value:08X}: device profile {value & 0xFFFF} instead of {_SERVO}")
    return f"0x{value:08X}"


def _error_register(drive: Cia402Drive) -> str:
    value = drive.access.read(OBJECTS["error_register"])
    state = decode_state(drive.statusword())
    if value & 1 and state is not State.FAULT:
        raise ClauseFailedError(f"0x1001 is 0x{value:02X}, a generic error, in state {state}")
    return f"0x1001 is 0x{value:02X}"


def _error_history(drive: Cia402Drive) -> str:
    return f"{_optional(drive, 'error_history_count')} entries in 0x1003"


def _emcy_id(drive: Cia402Drive) -> str:
    value = _optional(drive, "emcy_cob_id")
    if value >> 31 or value & 0x7FF != EMCY_BASE + drive.node_id:
        raise ClauseFailedError(f"0x1014 is 0x{value:08X} instead of 0x{EMCY_BASE + drive.node_id:08X}")
    return f"0x1014 is 0x{value:08X}"


def _consumer(drive: Cia402Drive) -> str:
    return f"0x1016 takes and returns {drive.setup.profile.heartbeat.consumer_ms} ms"


def _mapping(drive: Cia402Drive) -> str:
    return ", ".join(f"{plan.size_bytes} bytes on 0x{plan.cob_id:03X}" for plan in drive.plans) + ", read back"


def _kept(drive: Cia402Drive) -> str:
    changed = [f"{at[0]:04X}:{at[1]:02X} {old:#x} is {now:#x}" for at, old, now in drive.access.changed()]
    if changed:
        raise ClauseFailedError(f"does not keep what was configured: {', '.join(changed)}")
    return "every configured object still holds its value"


def _signature(name: str) -> Callable[[Cia402Drive], str]:
    """Write a wrong signature, which has to be refused, where the profile allows writing the object."""
    index = OBJECTS[name].index

    def run(drive: Cia402Drive) -> str:
        held = _optional(drive, name)
        if not drive.access.may_write(index):
            raise NotTestedError(f"profile {drive.setup.profile.name} does not allow writing 0x{index:04X}")
        refused = _refused(
            lambda: drive.access.sdo.write(index, 1, "u32", 0, ONCE), _STORE_ABORTS, f"a wrong signature in 0x{index:X}"
        )
        return f"capability 0x{held:X}; a wrong signature is {refused}"

    return run


def _capability(name: str) -> Callable[[Cia402Drive], str]:
    def run(drive: Cia402Drive) -> str:
        value = _optional(drive, name)
        read = f"0x{OBJECTS[name].index:X}:01 reads 0x{value:X}"
        if value & ~0x3:
            raise ClauseFailedError(f"{read}: bits 2 to 31 are reserved")
        return read

    return run


def _modes(drive: Cia402Drive) -> str:
    value = _optional(drive, "supported_modes")
    if not value >> (Mode.CYCLIC_SYNC_POSITION.value - 1) & 1:
        raise ClauseFailedError(f"0x6502 is 0x{value:08X}: no cyclic synchronous position, although 0x6060 takes it")
    return f"0x6502 is 0x{value:08X}"


def _mode_display(drive: Cia402Drive) -> str:
    shown = drive.access.read(OBJECTS["mode_display"])
    if drive.setup.profile.state_machine.mode_before_enable and shown != Mode.CYCLIC_SYNC_POSITION.value:
        raise ClauseFailedError(f"0x6061 shows {shown} after 8 was written to 0x6060")
    return f"0x6061 shows {shown}"


def _no_shortcut(drive: Cia402Drive) -> str:
    """SWITCH ON is not a command of SWITCH ON DISABLED; no controlword of this check energises the axis."""
    control, before = OBJECTS["controlword"], decode_state(drive.statusword())
    if before is not State.SWITCH_ON_DISABLED:
        raise NotTestedError(f"the drive is in {before}")
    try:
        drive.access.sdo.write(control.index, control.subindex, control.type, SWITCH_ON)
        after = decode_state(drive.statusword())
    finally:
        drive.access.sdo.write(control.index, control.subindex, control.type, DISABLE_VOLTAGE)
    if after is not State.SWITCH_ON_DISABLED:
        raise ClauseFailedError(f"controlword 0x0007 leads from {before} to {after}")
    return f"controlword 0x0007 leaves {before} unchanged"


CHECKS: Final = (
    ServiceCheck(SDO, "sdo_expedited_upload", _expedited),
    ServiceCheck(SDO, "sdo_segmented_upload", _segmented),
    ServiceCheck(SDO, "sdo_abort_unknown_object", _unknown_object),
    ServiceCheck(SDO, "sdo_abort_unknown_subindex", _unknown_subindex),
    ServiceCheck(SDO, "sdo_abort_write_read_only", _write_read_only),
    ServiceCheck(SDO, "sdo_abort_wrong_length", _wrong_length),
    ServiceCheck(SDO, "sdo_block_transfer", _not_tested("this master does not use block transfer")),
    ServiceCheck("CiA 301 7.5.2.19 identity", "identity", _identity),
    ServiceCheck("CiA 402-2 device type", "device_type", _device_type),
    ServiceCheck("CiA 301 7.5.2.2 error register", "error_register", _error_register),
    ServiceCheck(EMCY, "error_history", _error_history),
    ServiceCheck(EMCY, "emcy_cob_id", _emcy_id),
    ServiceCheck(HEARTBEAT, "heartbeat_consumer", _consumer),
    ServiceCheck(PDO, "pdo_mapping", _mapping),
    ServiceCheck(PDO, "configuration_kept", _kept),
    ServiceCheck(STORE, "store_capability", _capability("store_parameters")),
    ServiceCheck(STORE, "store_wrong_signature", _signature("store_parameters")),
    ServiceCheck(
        STORE,
        "store_parameters",
        _not_tested("storing would replace the parameters that the drive keeps without power"),
    ),
    ServiceCheck(RESTORE, "restore_capability", _capability("restore_parameters")),
    ServiceCheck(RESTORE, "restore_wrong_signature", _signature("restore_parameters")),
    ServiceCheck(RESTORE, "restore_parameters", _not_tested("the defaults would replace the parameters of the drive")),
    ServiceCheck(MODES, "supported_modes", _modes),
    ServiceCheck(MODES, "mode_display", _mode_display),
    ServiceCheck(STATES, "state_machine_no_shortcut", _no_shortcut),
)
