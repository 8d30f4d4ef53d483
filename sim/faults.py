"""Faults of a bus and of a drive: their kinds, and scenario files.

    [[fault]]
    kind = "tpdo_lost"
    node = 3
    at_sync = 200      # SYNC on the bus at which it starts, counted from the first one
    syncs = 5          # how many SYNCs it lasts; 0 = from then on

A fault is implemented where it acts: on the wire (`sim.faulty_wire`), in the drive, or in the drive's objects and
behaviour before a master starts (`sim.quirks`). Faults of the master are listed for completeness. Every kind acts in
lockstep and in real time; its duration is counted in SYNCs in both, and delays are in seconds.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

Where = Literal["wire", "drive", "object", "master"]
Reaction = Literal["goes on", "retried", "stops", "refuses", "finding", "drives stop", "kept"]

#: What each reaction means.
REACTIONS: dict[Reaction, str] = {
    "goes on": "counted and reported, no sample is touched",
    "retried": "the SYNCs concerned are incomplete, are reported, and the samples are taken again",
    "stops": "every axis stops, controlled; what was recorded is kept; nothing resumes by itself",
    "refuses": "nothing moves: typed error, named node and object",
    "finding": "the pre-flight check or the data report it, with a remedy; no value is used without a message",
    "drives stop": "every drive stops itself (heartbeat consumer), whatever the master does",
    "kept": "the run ends with an error, every finished visit is on disk",
}


class FaultError(ValueError):
    """A scenario that cannot be used."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of fault.

    Attributes
    ----------
    where : where it acts; "object": from power-up on, so it has to be armed before a master comes
    reaction : what has to happen
    bound : SYNCs from its start to the master's reaction; None = not by SYNCs (before motion, or in real time)
    meaning : one line
    real : what has to happen in real time, where that differs; None = the same
    bound_s : in real time, seconds from its start to the master's reaction; None = `bound` SYNCs there too
    """

    where: Where
    reaction: Reaction
    bound: int | None
    meaning: str
    real: Reaction | None = None
    bound_s: float | None = None

    def reaction_in(self, pacing: str) -> Reaction:
        """Return what has to happen in lockstep, or in real time ("real")."""
        return self.real if pacing == "real" and self.real is not None else self.reaction


KINDS: dict[str, Kind] = {
    # TPDOs and SYNC on the wire
    "tpdo_lost": Kind("wire", "retried", 1, "answers of a drive to a few SYNCs are lost"),
    "tpdo_gone": Kind("wire", "stops", 6, "a drive answers no SYNC any more"),
    "tpdo_duplicated": Kind("wire", "goes on", 1, "every answer comes twice"),
    "tpdo_delayed": Kind("wire", "goes on", 1, "the answer of one drive comes after all others"),
    "tpdo_reordered": Kind("wire", "goes on", 1, "answers come in changing order"),
    "tpdo_late": Kind("wire", "retried", 1, "the answer comes after the next SYNC"),
    "tpdo_short": Kind("wire", "retried", 1, "the answer is shorter than mapped"),
    "tpdo_empty": Kind("wire", "retried", 1, "the answer has no data"),
    "tpdo_torn": Kind("wire", "retried", 1, "two different answers to one SYNC"),
    "tpdo_stuck": Kind("wire", "stops", 52, "the answers of a drive show old values for ever"),
    "tpdo_random_loss": Kind("wire", "retried", 1, "a share of all answers is lost"),
    "burst": Kind("wire", "retried", 1, "a drive's answers of 25 ms come at once"),
    "rpdo_lost": Kind("wire", "goes on", 1, "a command to one drive is lost while it moves slowly"),
    "rpdo_gone": Kind("wire", "stops", 100, "no command reaches one drive any more"),
    "sync_lost": Kind("wire", "retried", 1, "a SYNC reaches no drive"),
    # SDO on the wire
    "sdo_late": Kind("wire", "goes on", None, "delayed answers within the time-out"),
    "sdo_too_late": Kind("wire", "goes on", None, "one answer after the time-out: requested again, never mistaken"),
    "sdo_lost": Kind("wire", "goes on", None, "one answer is lost, the read is repeated"),
    "sdo_silent": Kind("wire", "refuses", None, "no answer at all"),
    "sdo_aborted": Kind("wire", "refuses", None, "refuses an object"),
    "sdo_other_object": Kind("wire", "refuses", None, "answers for another object"),
    "sdo_wrong_toggle": Kind("wire", "refuses", None, "wrong toggle bit in a segment of a text"),
    "sdo_short": Kind("wire", "refuses", None, "answers of less than eight bytes"),
    # life signs
    "heartbeat_lost": Kind("wire", "stops", None, "the drive's heartbeat is missing", bound_s=0.85),
    "heartbeat_back": Kind("wire", "stops", None, "the drive's heartbeat is missing and comes back", bound_s=0.85),
    "node_killed": Kind("drive", "stops", 6, "the drive is without power"),
    "power_cycle": Kind("drive", "stops", 2, "the drive restarts during a run"),
    "reboot_keeps_all": Kind(
        "drive", "goes on", None, "the drive restarts with its brake applied and keeps all objects"
    ),
    "reboot_keeps_communication": Kind(
        "drive", "refuses", None, "the drive restarts with its brake applied and keeps 0x1000 to 0x1FFF"
    ),
    "reboot_keeps_nothing": Kind(
        "drive", "refuses", None, "the drive restarts with its brake applied, with factory settings"
    ),
    "boot_up_frame": Kind("wire", "stops", 2, "a boot-up frame in the middle of a run"),
    "nmt_stopped": Kind("drive", "stops", 2, "the drive goes to NMT state STOPPED"),
    "nmt_preoperational": Kind("drive", "stops", 2, "the drive falls back to PRE-OPERATIONAL"),
    # EMCY
    "emcy": Kind("wire", "stops", 2, "an emergency message"),
    "emcy_short": Kind("wire", "stops", 2, "an emergency message of two bytes"),
    "emcy_reset": Kind("wire", "goes on", 1, "an emergency message that reports an error as cleared"),
    "emcy_storm": Kind("wire", "stops", 2, "two hundred emergency messages at once"),
    # the drive
    "drive_fault": Kind("drive", "stops", 2, "the drive goes to FAULT"),
    "quick_stop": Kind("drive", "stops", 2, "the drive does a quick stop without a command"),
    "internal_limit": Kind("wire", "stops", 2, "statusword bit 11: a limit of the drive acts"),
    "following_error": Kind("wire", "stops", 2, "statusword bit 13: following error"),
    "safe_torque_off": Kind("drive", "stops", 2, "the safety circuit takes the torque away"),
    "not_following": Kind("wire", "stops", 2, "statusword bit 12 falls: the drive ignores its target"),
    "not_remote": Kind("wire", "stops", 2, "statusword bit 9 falls: a panel has taken the drive"),
    "warning": Kind("wire", "goes on", 1, "statusword bit 7: warning"),
    "brake_engaged": Kind("drive", "stops", 100, "the holding brake falls in under power"),
    "never_settles": Kind("drive", "stops", None, "the position loop hunts: the axis never comes to rest"),
    "torque_spike": Kind("wire", "stops", 4, "the torque jumps and stays, as on contact"),
    # reports of the drive
    "demand_torque": Kind("drive", "finding", None, "0x6077 shows the demand, not the measurement"),
    "unsigned_torque": Kind("drive", "finding", None, "0x6077 has lost its sign"),
    "heartbeat_ignored": Kind("drive", "finding", None, "the drive continues when the master's heartbeat stops"),
    "wrong_rated": Kind("object", "finding", None, "rated torque in uNm instead of mNm"),
    "write_ignored": Kind("object", "refuses", None, "acknowledges a write of an object (0x6007) and keeps its value"),
    "drive_exchanged": Kind(
        "object", "goes on", None, "another drive of the same product: serial number, torque limit"
    ),
    "rated_zero": Kind("object", "refuses", None, "rated torque is zero"),
    "wrong_vendor": Kind("object", "refuses", None, "another make of drive"),
    "node_missing": Kind("wire", "refuses", None, "no device at a node id"),
    "duplicate_node": Kind("wire", "refuses", None, "two devices with one node id"),
    "fault_at_start": Kind("drive", "refuses", None, "the drive is in FAULT before anything begins"),
    # strict slaves: conforming
    "strict_inhibit": Kind("object", "goes on", None, "aborts an inhibit time written while the PDO exists; has 10 ms"),
    "start_refused": Kind("object", "goes on", None, "refuses START while a communication error is active; it clears"),
    "cycle_period_set": Kind("object", "goes on", None, "0x1006 is set; another SYNC period ends OPERATIONAL"),
    "no_data_abort": Kind("object", "goes on", None, "answers 'no data available' for optional objects"),
    "tpdo3_on": Kind("object", "goes on", None, "TPDO3 is on at power-up and sends 5000 frames a second"),
    "foreign_emcy_id": Kind("object", "goes on", None, "0x1014 names another identifier; EMCYs come there"),
    # drives that may not be moved
    "start_never": Kind("object", "refuses", None, "refuses START for ever"),
    "emcy_disabled": Kind("object", "refuses", None, "0x1014 bit 31: sends no EMCY"),
    "estop_pressed": Kind("object", "refuses", None, "the safety circuit is open: 0x60FD bit 24 low, no torque"),
    "unreferenced": Kind("object", "refuses", None, "the encoder has no reference: 0x60FD bit 25 low"),
    "coasting_stop": Kind("object", "refuses", None, "option codes that let the axis coast: 0x605A and 0x605E are 0"),
    "no_heartbeat": Kind("object", "refuses", None, "never sends a heartbeat, whatever 0x1017 says"),
    "never_enables": Kind("object", "stops", None, "stays in SWITCHED ON: bring-up ends, all axes are disabled"),
    "enables_and_drops": Kind("object", "stops", None, "falls back to SWITCHED ON a few SYNCs after each enabling"),
    "brake_slips": Kind("object", "finding", None, "the closed brake lets the axis sink"),
    "brake_falls": Kind("object", "finding", None, "a brake that was opened once lets the axis fall when it closes"),
    # the bus
    "second_master_sync": Kind("wire", "stops", 20, "another master sends SYNC"),
    "second_master_nmt": Kind("wire", "stops", 20, "another master sends NMT commands"),
    "second_master_sdo": Kind("wire", "stops", 20, "another master reads objects"),
    "second_master_slow": Kind("wire", "refuses", None, "another master sends a SYNC every 100 ms"),
    "error_frames": Kind("wire", "goes on", 1, "error frames"),
    "error_passive": Kind("wire", "goes on", 1, "the controller is error passive"),
    "bus_off": Kind("wire", "stops", 2, "the controller is bus-off"),
    "strange_frames": Kind("wire", "goes on", 1, "extended and remote frames of others"),
    # the master
    "queue_full": Kind("master", "goes on", 1, "transmit queue full (ENOBUFS) for a moment"),
    "queue_stays_full": Kind("master", "drives stop", None, "transmit queue full for ever"),
    "master_killed": Kind("master", "drives stop", None, "the master process is killed (SIGKILL)"),
    "master_stalled": Kind("master", "drives stop", None, "the master process is suspended for a while (SIGSTOP)"),
    "disk_full": Kind("master", "kept", None, "the recording's disk is full"),
}

MAX_SYNC = 10**9
LONGEST_LINE = 500


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a scenario.

    Attributes
    ----------
    kind : one of `KINDS`
    node : the node; 0 = every node, or none in particular
    at_sync : SYNC at which it starts
    syncs : how many SYNCs it lasts; 0 = from then on
    count : how many frames it touches at most; 0 = all
    delay_s : of delayed answers; of a burst; until a refused START is obeyed; 0 = the kind's own
    index, subindex : object that an SDO fault is about; index 0 = any
    code : EMCY or SDO abort code; value of the object that a strict slave has set (0x1006, 0x1014), or an exchanged
        drive (0x6072)
    share : of the frames, for random loss
    rate_hz : of a TPDO that sends by itself; 0 = the kind's own
    speed_rad_s : at which a closed brake lets the axis sink; 0 = the kind's own
    accel_rad_s2 : with which an axis falls in its brake; 0 = the kind's own
    seed : of the random choice
    """

    kind: str
    node: int = 0
    at_sync: int = 0
    syncs: int = 1
    count: int = 0
    delay_s: float = 0.0
    index: int = 0
    subindex: int = 0
    code: int = 0
    share: float = 1.0
    rate_hz: float = 0.0
    speed_rad_s: float = 0.0
    accel_rad_s2: float = 0.0
    seed: int = 1

    def active(self, sync: int) -> bool:
        """Whether the fault acts after so many SYNCs."""
        return sync >= self.at_sync and (self.syncs == 0 or sync < self.at_sync + self.syncs)

    def concerns(self, node: int) -> bool:
        """Whether it is about this node."""
        return self.node in (0, node)


_BOUNDS: dict[str, tuple[type, float, float]] = {
    "kind": (str, 0, 0),
    "node": (int, 0, 127),
    "at_sync": (int, 0, MAX_SYNC),
    "syncs": (int, 0, MAX_SYNC),
    "count": (int, 0, MAX_SYNC),
    "delay_s": (float, 0.0, 60.0),
    "index": (int, 0, 0xFFFF),
    "subindex": (int, 0, 0xFF),
    "code": (int, 0, 0xFFFFFFFF),
    "share": (float, 0.0, 1.0),
    "rate_hz": (float, 0.0, 20_000.0),
    "speed_rad_s": (float, 0.0, 1.0),
    "accel_rad_s2": (float, 0.0, 20.0),
    "seed": (int, 0, 2**32 - 1),
}


def fault_from_dict(entry: dict[str, Any], where: str = "fault") -> Fault:
    """A fault from its keys; every key is checked.

    Raises
    ------
    FaultError
        Unknown kind or key, a value of the wrong type or out of range.
    """
    values: dict[str, Any] = {}
    for key, value in entry.items():
        if key not in _BOUNDS:
            raise FaultError(f"{where}: unknown key '{key}'; known are {', '.join(_BOUNDS)}")
        kind, low, high = _BOUNDS[key]
        wrong = isinstance(value, bool) or not isinstance(value, (int, float) if kind is float else kind)
        if wrong or kind is not str and not low <= value <= high:
            raise FaultError(f"{where}: {key} = {value!r} is no {kind.__name__} in {low} .. {high}")
        values[key] = kind(value)
    name = values.get("kind")
    if name not in KINDS:
        raise FaultError(f"{where}: kind '{name}' is unknown; known are {', '.join(KINDS)}")
    if KINDS[name].where == "master":
        raise FaultError(f"{where}: '{name}' happens at the master, not in the simulator")
    return Fault(**values)


def parse_faults(text: str, where: str = "scenario") -> tuple[Fault, ...]:
    """Faults of a scenario file.

    Raises
    ------
    FaultError
        Not TOML, or as `fault_from_dict`.
    """
    if any(len(line) > LONGEST_LINE for line in text.splitlines()):
        raise FaultError(f"{where}: a line of more than {LONGEST_LINE} characters is no fault")
    try:
        tables = tomllib.loads(text)
    except (ValueError, RecursionError, OverflowError) as error:
        raise FaultError(f"{where}: not valid TOML: {error}") from error
    entries = tables.pop("fault", [])
    if tables or not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise FaultError(f"{where}: a scenario holds [[fault]] tables and nothing else")
    tables_of_faults = cast(list[dict[str, Any]], entries)
    return tuple(fault_from_dict(entry, f"{where}: fault {number}") for number, entry in enumerate(tables_of_faults, 1))


def read_faults(path: Path) -> tuple[Fault, ...]:
    """Faults of a scenario file on disk."""
    try:
        return parse_faults(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise FaultError(f"{path}: cannot be read: {error}") from error
