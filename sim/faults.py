"""Kinds of bus and drive faults that the simulator injects, and the reader of scenario files.

    [[fault]]
    kind = "tpdo_lost"
    node = 3
    at_sync = 200      # SYNC at which the fault starts, counted from the first SYNC on the bus
    syncs = 5          # duration in SYNCs; 0 = until the end

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
    "goes on": "the fault is counted and reported; all samples stay valid",
    "retried": "the SYNCs concerned are reported as incomplete and their samples are measured again",
    "stops": "every axis makes a controlled stop; recorded data is kept; motion does not resume by itself",
    "refuses": "no axis moves; an error names the node and the object",
    "finding": "the pre-flight check or the data quality report shows a finding with a remedy",
    "drives stop": "every drive stops by itself (heartbeat consumer), whatever the master does",
    "kept": "the run ends with an error; every finished pose visit is on disk",
}


class FaultError(ValueError):
    """Scenario file or fault definition that is not valid."""


@dataclass(frozen=True, slots=True)
class Kind:
    """Kind of fault, with the reaction that the master must show.

    Attributes
    ----------
    where : place of the injection; "object": acts from power-up on, so it is injected before a master connects
    reaction : required reaction
    bound : SYNCs allowed from the start to the reaction; None = not counted in SYNCs (before motion, or in real time)
    meaning : description in one line
    real : required reaction with real-time pacing if it differs; None = as `reaction`
    bound_s : with real-time pacing, time allowed from the start to the reaction [s]; None = `bound` SYNCs
    """

    where: Where
    reaction: Reaction
    bound: int | None
    meaning: str
    real: Reaction | None = None
    bound_s: float | None = None

    def reaction_in(self, pacing: str) -> Reaction:
        """Return the required reaction for the given pacing ("lockstep" or "real")."""
        return self.real if pacing == "real" and self.real is not None else self.reaction


KINDS: dict[str, Kind] = {
    # TPDOs and SYNC on the wire
    "tpdo_lost": Kind("wire", "retried", 1, "TPDOs of one drive are lost for a few SYNCs"),
    "tpdo_gone": Kind("wire", "stops", 6, "one drive stops sending its TPDOs"),
    "tpdo_duplicated": Kind("wire", "goes on", 1, "every TPDO is sent twice"),
    "tpdo_delayed": Kind("wire", "goes on", 1, "the TPDO of one drive arrives after all others"),
    "tpdo_reordered": Kind("wire", "goes on", 1, "TPDOs arrive in changing order"),
    "tpdo_late": Kind("wire", "retried", 1, "a TPDO arrives after the next SYNC"),
    "tpdo_short": Kind("wire", "retried", 1, "a TPDO is shorter than its mapping"),
    "tpdo_empty": Kind("wire", "retried", 1, "a TPDO has no data bytes"),
    "tpdo_torn": Kind("wire", "retried", 1, "two TPDOs with different data follow one SYNC"),
    "tpdo_stuck": Kind("wire", "stops", 52, "the TPDOs of one drive repeat old values permanently"),
    "tpdo_random_loss": Kind("wire", "retried", 1, "a random share of all TPDOs is lost"),
    "burst": Kind("wire", "retried", 1, "the TPDOs of one drive are held for 25 ms and then sent at once"),
    "rpdo_lost": Kind("wire", "goes on", 1, "an RPDO to one drive is lost during slow motion"),
    "rpdo_gone": Kind("wire", "stops", 100, "one drive receives no RPDOs any more"),
    "sync_lost": Kind("wire", "retried", 1, "a SYNC is lost for all drives"),
    # SDO on the wire
    "sdo_late": Kind("wire", "goes on", None, "SDO responses are delayed within the time-out"),
    "sdo_too_late": Kind("wire", "goes on", None, "an SDO response arrives after its time-out; repeated"),
    "sdo_lost": Kind("wire", "goes on", None, "one SDO response is lost; the request is repeated"),
    "sdo_silent": Kind("wire", "refuses", None, "the drive does not respond to SDO requests"),
    "sdo_aborted": Kind("wire", "refuses", None, "the drive aborts the access to an object"),
    "sdo_other_object": Kind("wire", "refuses", None, "the SDO response names another object"),
    "sdo_wrong_toggle": Kind("wire", "refuses", None, "wrong toggle bit in a segmented SDO transfer"),
    "sdo_short": Kind("wire", "refuses", None, "SDO responses of less than eight bytes"),
    # heartbeat, power, NMT
    "heartbeat_lost": Kind("wire", "stops", None, "the drive's heartbeat stops", bound_s=0.85),
    "heartbeat_back": Kind("wire", "stops", None, "the drive's heartbeat stops and starts again", bound_s=0.85),
    "node_killed": Kind("drive", "stops", 6, "the drive loses power"),
    "power_cycle": Kind("drive", "stops", 2, "the drive restarts during a run"),
    "reboot_keeps_all": Kind(
        "drive", "refuses", None, "the drive restarts with its brake applied and keeps all objects"
    ),
    "reboot_keeps_communication": Kind(
        "drive", "refuses", None, "the drive restarts with its brake applied and keeps 0x1000 to 0x1FFF"
    ),
    "reboot_keeps_nothing": Kind(
        "drive", "refuses", None, "the drive restarts with its brake applied, with factory settings"
    ),
    "boot_up_frame": Kind("wire", "stops", 2, "a boot-up message during a run"),
    "nmt_stopped": Kind("drive", "stops", 2, "the drive goes to NMT state STOPPED"),
    "nmt_preoperational": Kind("drive", "stops", 2, "the drive changes to PRE-OPERATIONAL"),
    # EMCY
    "emcy": Kind("wire", "stops", 2, "an EMCY message"),
    "emcy_short": Kind("wire", "stops", 2, "an EMCY message of two bytes"),
    "emcy_reset": Kind("wire", "goes on", 1, "an EMCY message that reports an error reset"),
    "emcy_storm": Kind("wire", "stops", 2, "two hundred EMCY messages at once"),
    # the drive
    "drive_fault": Kind("drive", "stops", 2, "the drive goes to FAULT"),
    "quick_stop": Kind("drive", "stops", 2, "the drive makes a quick stop without a command"),
    "internal_limit": Kind("wire", "stops", 2, "statusword bit 11 set: internal limit active"),
    "following_error": Kind("wire", "stops", 2, "statusword bit 13 set: following error"),
    "safe_torque_off": Kind("drive", "stops", 2, "the safety circuit switches the torque off (STO)"),
    "not_following": Kind("wire", "stops", 2, "statusword bit 12 cleared: the drive does not follow its target"),
    "not_remote": Kind("wire", "stops", 2, "statusword bit 9 cleared: local control, the controlword is ignored"),
    "warning": Kind("wire", "goes on", 1, "statusword bit 7 set: warning"),
    "brake_engaged": Kind("drive", "stops", 100, "the holding brake closes while the drive is enabled"),
    "never_settles": Kind("drive", "stops", None, "the position loop oscillates: the axis does not come to rest"),
    "torque_spike": Kind("wire", "stops", 4, "the torque steps and stays, as on contact"),
    # values that the drive reports
    "demand_torque": Kind("drive", "finding", None, "0x6077 reports the torque demand instead of the measured torque"),
    "unsigned_torque": Kind("drive", "finding", None, "0x6077 reports the torque without its sign"),
    "heartbeat_ignored": Kind("drive", "finding", None, "the drive keeps running when the master's heartbeat stops"),
    "wrong_rated": Kind("object", "finding", None, "the rated torque is stored in uNm instead of mNm"),
    "write_ignored": Kind("object", "refuses", None, "a write of an object (0x6007) is confirmed without effect"),
    "drive_exchanged": Kind(
        "object", "goes on", None, "another drive of the same product: serial number, torque limit"
    ),
    "rated_zero": Kind("object", "refuses", None, "the rated torque is zero"),
    "wrong_vendor": Kind("object", "refuses", None, "a drive of another vendor"),
    "node_missing": Kind("wire", "refuses", None, "no device responds at a node id"),
    "duplicate_node": Kind("wire", "refuses", None, "two devices with one node id"),
    "fault_at_start": Kind("drive", "refuses", None, "the drive is in FAULT before the start"),
    # strict slaves: conforming
    "strict_inhibit": Kind("object", "goes on", None, "inhibit time 10 ms, not writable while the PDO is valid"),
    "start_refused": Kind("object", "goes on", None, "START is refused until a communication error has cleared"),
    "cycle_period_set": Kind("object", "goes on", None, "0x1006 is set; a different SYNC period ends OPERATIONAL"),
    "no_data_abort": Kind("object", "goes on", None, "optional objects are aborted with 'no data available'"),
    "tpdo3_on": Kind("object", "goes on", None, "TPDO3 is valid at power-up and is sent 5000 times per second"),
    "foreign_emcy_id": Kind("object", "goes on", None, "0x1014 names another identifier, on which EMCYs are sent"),
    # drives that must not be moved
    "start_never": Kind("object", "refuses", None, "START is always refused"),
    "emcy_disabled": Kind("object", "refuses", None, "0x1014 bit 31 set: the drive sends no EMCY"),
    "estop_pressed": Kind("object", "refuses", None, "the safety circuit is open: 0x60FD bit 24 low, no torque"),
    "unreferenced": Kind("object", "refuses", None, "the encoder has no reference: 0x60FD bit 25 low"),
    "coasting_stop": Kind("object", "refuses", None, "0x605A and 0x605E are 0: the axis coasts on a stop"),
    "no_heartbeat": Kind("object", "refuses", None, "the drive sends no heartbeat, whatever 0x1017 holds"),
    "never_enables": Kind("object", "stops", None, "the drive stays in SWITCHED ON when it is enabled"),
    "enables_and_drops": Kind("object", "stops", None, "falls back to SWITCHED ON a few SYNCs after enabling"),
    "brake_slips": Kind("object", "finding", None, "the axis drops slowly with the brake closed"),
    "brake_falls": Kind("object", "finding", None, "the brake does not hold the axis after it was opened once"),
    # the bus
    "second_master_sync": Kind("wire", "stops", 20, "another master sends SYNC"),
    "second_master_nmt": Kind("wire", "stops", 20, "another master sends NMT commands"),
    "second_master_sdo": Kind("wire", "stops", 20, "another master reads objects"),
    "second_master_slow": Kind("wire", "refuses", None, "another master sends a SYNC every 100 ms"),
    "error_frames": Kind("wire", "goes on", 1, "error frames"),
    "error_passive": Kind("wire", "goes on", 1, "the CAN controller is error passive"),
    "bus_off": Kind("wire", "stops", 2, "the CAN controller is bus-off"),
    "strange_frames": Kind("wire", "goes on", 1, "extended and remote frames of other devices"),
    # the master
    "queue_full": Kind("master", "goes on", 1, "transmit queue full (ENOBUFS) temporarily"),
    "queue_stays_full": Kind("master", "drives stop", None, "transmit queue full permanently"),
    "master_killed": Kind("master", "drives stop", None, "the master process is killed (SIGKILL)"),
    "master_stalled": Kind("master", "drives stop", None, "the master process is suspended for a while (SIGSTOP)"),
    "disk_full": Kind("master", "kept", None, "the disk of the recording is full"),
}

MAX_SYNC = 10**9
LONGEST_LINE = 500


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a scenario. A value of 0 selects the default of the kind unless stated otherwise.

    Attributes
    ----------
    kind : one of `KINDS`
    node : node id; 0 = every node, or no node in particular
    at_sync : SYNC at which the fault starts
    syncs : duration in SYNCs; 0 = until the end
    count : maximum number of affected frames, 0 = all; SYNCs until `enables_and_drops` acts
    delay_s : delay of responses, duration of a burst, or time until a refused START is obeyed [s]
    index, subindex : object that the fault affects; index 0 = any object of the kind
    code : EMCY code, SDO abort code, or value of the affected object (0x1006, 0x1014, 0x6072)
    share : share of frames that are lost at random, 0 to 1
    rate_hz : rate of a flooding TPDO [Hz]
    speed_rad_s : speed at which the axis drops with its brake closed [rad/s]
    accel_rad_s2 : acceleration with which the axis falls with its brake closed [rad/s2]
    seed : seed of the random choice
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
        """Return whether the fault is active at SYNC number `sync`."""
        return sync >= self.at_sync and (self.syncs == 0 or sync < self.at_sync + self.syncs)

    def concerns(self, node: int) -> bool:
        """Return whether the fault affects this node."""
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
    """Build a fault from the keys of one [[fault]] table.

    Raises
    ------
    FaultError
        A kind or key is unknown, or a value has the wrong type or is out of range.
    """
    values: dict[str, Any] = {}
    for key, value in entry.items():
        if key not in _BOUNDS:
            raise FaultError(f"{where}: unknown key '{key}' (allowed: {', '.join(_BOUNDS)})")
        kind, low, high = _BOUNDS[key]
        wrong = isinstance(value, bool) or not isinstance(value, (int, float) if kind is float else kind)
        if wrong or kind is not str and not low <= value <= high:
            raise FaultError(
                f"{where}: {key} = {value!r} is not allowed (expected: {kind.__name__} in {low} .. {high})"
            )
        values[key] = kind(value)
    name = values.get("kind")
    if name not in KINDS:
        raise FaultError(f"{where}: unknown kind '{name}' (allowed: {', '.join(KINDS)})")
    if KINDS[name].where == "master":
        raise FaultError(f"{where}: '{name}' is a fault of the master, which the simulator cannot inject")
    return Fault(**values)


def parse_faults(text: str, where: str = "scenario") -> tuple[Fault, ...]:
    """Parse the text of a scenario file into its faults.

    Raises
    ------
    FaultError
        The text is not TOML, or a fault is not valid (`fault_from_dict`).
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
    tables_of_faults = cast(list[dict[str, Any]], entries)
    return tuple(fault_from_dict(entry, f"{where}: fault {number}") for number, entry in enumerate(tables_of_faults, 1))


def read_faults(path: Path) -> tuple[Fault, ...]:
    """Read the faults of a scenario file."""
    try:
        return parse_faults(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise FaultError(f"{path}: cannot be read: {error}") from error
