"""The table of faults of simulated drives, and the reader of scenario files.

    [[fault]]
    kind = "tpdo_lost"
    node = 3
    at_sync = 200      # SYNC at which the fault starts, counted from the first SYNC on the bus
    syncs = 5          # duration in SYNCs; 0 = until the end

Everything that breaks a simulated drive is a row of `KINDS`. A row states where the fault acts, what it does
(`sim.drive_faults`, `sim.wire_faults`), the reaction of the master, when it starts, and its parameters with defaults.
Faults of the master are listed for completeness. Every kind acts in lockstep and in real time; its duration is counted
in SYNCs in both, and delays are in seconds.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

from sim import drive_faults as drives
from sim import wire_faults as wires
from sim.drive_faults import DriveHook
from sim.fake_drive import FakeDrive
from sim.fault import Fault, Kind, Reaction, Starts, Where
from sim.node import PRE_OPERATIONAL, STOPPED
from sim.objects import NO_DATA, NO_OBJECT
from sim.wire_faults import ANSWERS, AT_START, AT_SYNC, HEARTBEAT, RPDO1, SDO_ANSWER, TPDO1, WireHook

MAX_SYNC = 10**9
LONGEST_LINE = 500
ENCODER_FAULT = 0x7305
RATED_TORQUE, MODE, ABORT_OPTION = 0x6076, 0x6060, 0x6007
#: SDO abort code: not possible in the present state of the device.
DEVICE_STATE = 0x08000022
SDO = (SDO_ANSWER,)


class FaultError(ValueError):
    """Scenario file or fault definition that is not valid."""


def _wire(
    touches: tuple[int, ...],
    hook: WireHook,
    reaction: Reaction,
    bound: int | None = None,
    starts: Starts | None = None,
    bound_s: float | None = None,
    **defaults: Any,
) -> Kind:
    return Kind("wire", starts or _start(bound), reaction, bound, hook, touches, defaults, bound_s)


def _drive(
    where: Where,
    hook: DriveHook,
    reaction: Reaction,
    bound: int | None = None,
    starts: Starts | None = None,
    **defaults: Any,
) -> Kind:
    return Kind(where, starts or _start(bound), reaction, bound, hook, (), defaults)


def _start(bound: int | None) -> Starts:
    """Return when a fault starts that does not state it: one that is counted in SYNCs has to start during a run."""
    return "power-up" if bound is None else "any time"


def _master(reaction: Reaction, bound: int | None = None) -> Kind:
    return Kind("master", "any time", reaction, bound, None, (), {})


KINDS: dict[str, Kind] = {
    # TPDOs and SYNC on the wire
    "tpdo_lost": _wire(ANSWERS, wires.lose, "retried", 1, syncs=3),
    "tpdo_gone": _wire(ANSWERS, wires.lose, "stops", 6, syncs=0),
    "tpdo_duplicated": _wire(ANSWERS, wires.send_twice, "goes on", 1, syncs=50),
    "tpdo_delayed": _wire(ANSWERS, wires.send_last, "goes on", 1, syncs=20),
    "tpdo_reordered": _wire(ANSWERS, wires.shuffle, "goes on", 1, node=0, syncs=0),
    "tpdo_late": _wire(ANSWERS, wires.delay, "retried", 1, delay_s=0.0),
    "tpdo_short": _wire(ANSWERS, wires.cut(-1), "retried", 1),
    "tpdo_empty": _wire(ANSWERS, wires.cut(0), "retried", 1),
    "tpdo_torn": _wire((TPDO1,), wires.tear, "retried", 1),
    "tpdo_stuck": _wire(ANSWERS, wires.freeze, "stops", 52, starts="slow motion", syncs=0),  # as a drive at rest may
    "tpdo_random_loss": _wire(ANSWERS, wires.lose_some, "retried", 1, node=0, syncs=0, share=0.002),
    "burst": _wire(ANSWERS, wires.gather, "retried", 1, syncs=2, delay_s=0.025),
    "rpdo_lost": _wire((RPDO1,), wires.lose, "goes on", 1, starts="slow motion"),
    "rpdo_gone": _wire((RPDO1,), wires.lose, "stops", 100, starts="in motion", syncs=0),
    "sync_lost": _wire((AT_SYNC,), wires.lose, "retried", 1, node=0),
    # SDO on the wire
    "sdo_late": _wire(SDO, wires.of_object(wires.delay), "goes on", syncs=0, count=5, delay_s=0.1, index=0),
    "sdo_too_late": _wire(
        SDO, wires.of_object(wires.delay), "goes on", syncs=0, count=1, delay_s=0.8, index=RATED_TORQUE
    ),
    "sdo_lost": _wire(SDO, wires.of_object(wires.lose), "goes on", syncs=0, count=1, index=RATED_TORQUE),
    "sdo_silent": _wire(SDO, wires.of_object(wires.lose), "refuses", syncs=0, index=0),  # no answer
    "sdo_aborted": _wire(SDO, wires.of_object(wires.abort), "refuses", syncs=0, index=MODE, code=DEVICE_STATE),
    "sdo_other_object": _wire(SDO, wires.of_object(wires.other_object), "refuses", syncs=0, index=RATED_TORQUE),
    "sdo_wrong_toggle": _wire(SDO, wires.wrong_toggle, "refuses", syncs=0, count=1),
    "sdo_short": _wire(SDO, wires.cut(4), "refuses", syncs=0),
    # heartbeat, power, NMT
    "heartbeat_lost": _wire((HEARTBEAT,), wires.lose, "stops", starts="in motion", bound_s=0.85, syncs=0),
    "heartbeat_back": _wire((HEARTBEAT,), wires.lose, "stops", starts="in motion", bound_s=0.85, syncs=900),
    "node_killed": _drive("drive", drives.lose_power, "stops", 6),
    "power_cycle": _drive("drive", drives.restart(lambda _index: False), "stops", 2),
    "reboot_keeps_all": _drive("drive", drives.restart(lambda _index: True), "refuses", starts="in brakes"),
    "reboot_keeps_communication": _drive(
        "drive", drives.restart(lambda index: index < 0x2000), "refuses", starts="in brakes"
    ),
    "reboot_keeps_nothing": _drive("drive", drives.restart(lambda _index: False), "refuses", starts="in brakes"),
    "boot_up_frame": _wire((AT_SYNC,), wires.of_node(HEARTBEAT, b"\0"), "stops", 2),
    "nmt_stopped": _drive("drive", drives.enter(STOPPED), "stops", 2),
    "nmt_preoperational": _drive("drive", drives.enter(PRE_OPERATIONAL), "stops", 2, starts="in motion"),
    # EMCY
    "emcy": _wire((AT_SYNC,), wires.emergency(), "stops", 2, code=ENCODER_FAULT),
    "emcy_short": _wire((AT_SYNC,), wires.emergency(size=2), "stops", 2, code=ENCODER_FAULT),
    "emcy_reset": _wire((AT_SYNC,), wires.of_node(wires.EMCY, bytes(8)), "goes on", 1),
    "emcy_storm": _wire((AT_SYNC,), wires.emergency(times=200), "stops", 2, code=ENCODER_FAULT),
    # the drive
    "drive_fault": _drive("drive", drives.raise_fault, "stops", 2, code=ENCODER_FAULT),
    "quick_stop": _drive("drive", drives.quick_stop, "stops", 2),
    "internal_limit": _wire((TPDO1,), wires.status_bit(11, True), "stops", 2, syncs=0),
    "following_error": _wire((TPDO1,), wires.status_bit(13, True), "stops", 2, syncs=0),
    "safe_torque_off": _drive("drive", drives.torque_off, "stops", 2),
    "not_following": _wire((TPDO1,), wires.status_bit(12, False), "stops", 2, starts="in motion", syncs=0),
    "not_remote": _wire((TPDO1,), wires.status_bit(9, False), "stops", 2, syncs=0),
    "warning": _wire((TPDO1,), wires.status_bit(7, True), "goes on", 1, syncs=20),
    "brake_engaged": _drive("mechanics", drives.stick_brake, "stops", 100, starts="in motion"),
    "never_settles": _drive("mechanics", drives.hunt, "stops", starts="any time"),
    "torque_spike": _wire((TPDO1,), wires.add_torque, "stops", 4, starts="load taken over", syncs=0, code=1500),
    # values that the drive reports
    "demand_torque": _drive("drive", drives.show_demand, "finding"),
    "unsigned_torque": _drive("drive", drives.show_no_sign, "finding"),
    "heartbeat_ignored": _drive("drive", drives.ignore_heartbeat, "finding"),
    "wrong_rated": _drive("object", drives.scale_rating(1000), "finding"),  # uNm instead of mNm
    "write_ignored": _drive("object", drives.ignore_writes, "refuses", index=ABORT_OPTION),
    "drive_exchanged": _drive("object", drives.exchange, "goes on", starts="between runs", code=0),
    "rated_zero": _drive("object", drives.scale_rating(0), "refuses"),
    "wrong_vendor": _drive("object", drives.other_vendor, "refuses", code=0),
    "node_missing": _drive("drive", drives.lose_power, "refuses"),  # no device with this node id
    "duplicate_node": _wire((SDO_ANSWER, HEARTBEAT), wires.answer_twice, "refuses", syncs=0),
    "fault_at_start": _drive("drive", drives.raise_fault, "refuses", code=ENCODER_FAULT),
    # strict slaves: conforming
    "strict_inhibit": _drive("object", drives.inhibit_strictly, "goes on", code=100),
    "start_refused": _drive("object", drives.refuse_start, "goes on", delay_s=0.5),
    "cycle_period_set": _drive("object", drives.watch_period, "goes on", code=1000),
    "no_data_abort": _drive("object", drives.lack, "goes on", index=0, code=NO_DATA),
    "tpdo3_on": _drive("object", drives.flood, "goes on", rate_hz=5000.0),
    "foreign_emcy_id": _drive("object", drives.foreign_emcy, "goes on", code=0),
    # makes: objects and habits that differ from drive to drive
    "object_absent": _drive("object", drives.lack, "goes on", index=0x6502, code=NO_OBJECT),
    "object_read_only": _drive("object", drives.fix, "goes on", index=0x6086),
    "object_value": _drive("object", drives.deliver, "goes on", index=0x607A, code=4000),  # a stale target
    "object_range": _drive("object", drives.limit, "goes on", index=0x60C2, subindex=1, low=1, high=20),
    "object_not_mappable": _drive("object", drives.do_not_map, "goes on", index=0x60B2),
    "object_size": _drive("object", drives.resize, "goes on", index=0x60B2, code=4),
    "object_rounded": _drive("object", drives.round_to, "goes on", index=0x6083, code=10),
    "record_short": _drive("object", drives.shorten, "goes on", index=0x1800, code=3),
    "modes_supported": _drive("object", drives.support, "refuses", code=0x43),  # no mode 8
    "status_bits_off": _drive("object", drives.status_bits(False), "goes on", code=1 << 9),
    "status_bits_on": _drive("object", drives.status_bits(True), "stops", code=1 << 11),
    "mode_display_late": _drive("object", drives.show_mode_when_enabled, "goes on"),
    "warning_emcy": _drive("drive", drives.warn, "stops", count=50, code=0x4310),
    "mapping_locked": _drive("object", drives.lock_pdos, "goes on"),
    "period_pair": _drive("object", drives.await_both_periods, "goes on"),
    "slow_enable": _drive("drive", drives.enable_slowly, "goes on", delay_s=0.2),
    "rpdo_at_once": _drive("drive", drives.take_rpdos_at_once, "goes on"),
    "position_wraps": _drive("object", drives.wrap_position, "stops", 100, starts="in motion", code=16),
    "single_turn": _drive("object", drives.forget_turns, "refuses", starts="in brakes"),
    "sync_producer": _drive("drive", drives.produce_sync, "refuses", delay_s=0.1),
    # drives that must not be moved
    "start_never": _drive("object", drives.refuse_start, "refuses", delay_s=math.inf),
    "emcy_disabled": _drive("object", drives.no_emcy, "refuses"),
    "estop_pressed": _drive("object", drives.open_safety_circuit, "refuses"),
    "unreferenced": _drive("object", drives.lose_reference, "refuses"),
    "coasting_stop": _drive("object", drives.coast_on_stops, "refuses", index=0),
    "no_heartbeat": _drive("object", drives.send_no_heartbeat, "refuses"),
    "never_enables": _drive("object", drives.never_enable, "stops"),
    "enables_and_drops": _drive("object", drives.drop_out, "stops", count=3),
    "brake_slips": _drive("mechanics", drives.slip, "finding", starts="any time", speed_rad_s=0.05),
    "brake_falls": _drive("mechanics", drives.fall, "finding", accel_rad_s2=5.0),
    # firmware and brakes that act otherwise than they state
    "delayed_tpdo": _drive("drive", drives.delay_tpdos, "drive test"),
    "every_second_sync": _drive("drive", drives.skip_syncs, "drive test"),
    "old_torque": _drive("drive", drives.delay_torque, "drive test"),
    "delayed_controlword": _drive("drive", drives.delay_controlwords, "drive test", delay_s=0.04),
    "delayed_rpdo": _drive("drive", drives.delay_rpdos, "drive test"),
    "quick_stop_coasts": _drive("object", drives.act_on({(0x605A, 0): 0}), "drive test"),
    "fault_coasts": _drive("object", drives.act_on({(0x605E, 0): 0}), "drive test"),
    "ignores_interpolation": _drive("object", drives.act_on({(0x60C2, 1): 1, (0x60C2, 2): -3}), "drive test"),
    "slow_brake": _drive("mechanics", drives.close_brake_slowly, "finding"),
    # the bus
    "second_master_sync": _wire((AT_SYNC,), wires.of_bus(wires.SYNC, b""), "stops", 20, syncs=0),
    "second_master_nmt": _wire((AT_SYNC,), wires.of_bus(wires.NMT, b"\x01\x7e"), "stops", 20, syncs=0),
    "second_master_sdo": _wire(
        (AT_SYNC,), wires.of_node(wires.SDO_REQUEST, b"\x40\x00\x10" + bytes(5)), "stops", 20, syncs=0
    ),
    "second_master_slow": _wire((AT_START,), wires.sync_slowly, "refuses"),
    "error_frames": _wire((AT_SYNC,), wires.error_frames(0x08, times=5), "goes on", 1, syncs=20),
    "error_passive": _wire(
        (AT_SYNC,),
        wires.error_frames(wires.CONTROLLER_STATE, bytes([0, 0x30, 0, 0, 0, 0, 128, 0])),
        "goes on",
        1,
        syncs=20,
    ),
    "bus_off": _wire((AT_SYNC,), wires.error_frames(wires.BUS_OFF), "stops", 2),
    "strange_frames": _wire((AT_SYNC,), wires.also(wires.strange_frames), "goes on", 1, syncs=20),
    # the master
    "queue_full": _master("goes on", 1),  # transmit queue full (ENOBUFS) temporarily
    "queue_stays_full": _master("drives stop"),  # transmit queue full permanently
    "master_killed": _master("drives stop"),  # SIGKILL
    "master_stalled": _master("drives stop"),  # SIGSTOP for a while
    "disk_full": _master("kept"),  # the disk of the recording
}

#: Parameters that every kind has.
_COMMON = ("node", "at_sync", "syncs", "count", "seed")
_BOUNDS: dict[str, tuple[type, float, float]] = {
    "node": (int, 0, 127),
    "at_sync": (int, 0, MAX_SYNC),
    "syncs": (int, 0, MAX_SYNC),
    "count": (int, 0, MAX_SYNC),
    "delay_s": (float, 0.0, 60.0),
    "index": (int, 0, 0xFFFF),
    "subindex": (int, 0, 0xFF),
    "code": (int, 0, 0xFFFFFFFF),
    "low": (int, -0x80000000, 0xFFFFFFFF),
    "high": (int, -0x80000000, 0xFFFFFFFF),
    "share": (float, 0.0, 1.0),
    "rate_hz": (float, 0.0, 20_000.0),
    "speed_rad_s": (float, 0.0, 1.0),
    "accel_rad_s2": (float, 0.0, 20.0),
    "seed": (int, 0, 2**32 - 1),
}


def fault_of(kind: object, **parameters: Any) -> Fault:
    """Return a fault of a kind, with parameters in place of the defaults of its kind.

    Raises
    ------
    FaultError
        The kind is unknown or one of the master, it has no such parameter, or a value has the wrong type or is out of
        range.
    """
    if not isinstance(kind, str) or kind not in KINDS:
        raise FaultError(f"unknown kind '{kind}' (allowed: {', '.join(KINDS)})")
    about = KINDS[kind]
    if about.where == "master":
        raise FaultError(f"'{kind}' is a fault of the master, which the simulator cannot inject")
    known = {*_COMMON, *about.defaults} | ({"subindex"} if "index" in about.defaults else set())
    values: dict[str, Any] = {}
    for key, value in parameters.items():
        if key not in known:
            raise FaultError(f"unknown key '{key}' of '{kind}' (allowed: {', '.join(sorted(known))})")
        type_, low, high = _BOUNDS[key]
        wrong = isinstance(value, bool) or not isinstance(value, (int, float) if type_ is float else type_)
        if wrong or not low <= value <= high:
            raise FaultError(f"{key} = {value!r} is not allowed (expected: {type_.__name__} in {low} .. {high})")
        values[key] = type_(value)
    return Fault(kind, **{**about.defaults, **values})


def parse_faults(text: str, where: str = "scenario") -> tuple[Fault, ...]:
    """Parse the text of a scenario file into its faults.

    Raises
    ------
    FaultError
        The text is not TOML, or a fault is not valid (`fault_of`).
    """
    if any(len(line) > LONGEST_LINE for line in text.splitlines()):
        raise FaultError(f"{where}: a line is longer than {LONGEST_LINE} characters")
    try:
        tables = tomllib.loads(text)
    except (ValueError, RecursionError, OverflowError) as error:
        raise FaultError(f"{where}: not valid TOML: {error}") from error
    entries = tables.pop("fault", [])
    if tables or not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise FaultError(f"{where}: a scenario may only contain [[fault]] tables")
    faults: list[Fault] = []
    for number, entry in enumerate(cast(list[dict[str, Any]], entries), 1):
        try:
            faults.append(fault_of(**({"kind": None} | entry)))
        except FaultError as error:
            raise FaultError(f"{where}: fault {number}: {error}") from error
    return tuple(faults)


def read_faults(wanted: str | Path) -> tuple[Fault, ...]:
    """Return the faults that are wanted: [NODE:]NAME for one kind with its defaults, else a scenario file.

    Raises
    ------
    FaultError
        The kind is unknown, or the file cannot be read or is not valid.
    """
    named = re.fullmatch(r"(?:(\d+):)?(\w+)", str(wanted))
    if named is not None and (named[1] or named[2] in KINDS):
        return (fault_of(named[2], node=int(named[1] or 0)),)
    try:
        return parse_faults(Path(wanted).read_text(encoding="utf-8"), str(wanted))
    except (OSError, UnicodeDecodeError) as error:
        raise FaultError(f"{wanted}: not [NODE:]NAME of a fault, and as a file it cannot be read: {error}") from error


def act(drives: Iterable[FakeDrive], fault: Fault) -> None:
    """Carry out a fault inside every drive that it concerns."""
    hook = KINDS[fault.kind].hook
    for drive in drives:
        if hook is not None and fault.concerns(drive.node_id):
            hook(drive, fault)
