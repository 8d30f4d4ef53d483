"""What has to be said and counted of each kind of fault: one table, judged by `benchmarks.chaos.judging`.

The reaction of a kind is in `sim.faults.KINDS`. This table holds the error, its rule, its text and the node that it
names, and the counters that have to show it where nothing stops.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

from drives.errors import (
    BrakeDropped,
    BusOff,
    ConfigurationRefused,
    DriveFault,
    DriveRebooted,
    DuplicateNode,
    ForeignMaster,
    HeartbeatLost,
    IdentityMismatch,
    IncompleteEpochs,
    NodeMissing,
    NotOperational,
    SdoAbort,
    SdoProtocolError,
    TransitionTimeout,
)
from gateway.errors import FindingFailed, LimitExceeded, PoseNeverSettles

#: Whom a message has to name: the node (or its joint), by number and in words; none, where the whole bus is meant.
Named = Literal["node", "joint", "id", "no node"]
#: Number of CAN ids of SDO requests before the one of node 0.
SDO_REQUEST = 0x600


@dataclass(frozen=True, slots=True)
class Count:
    """A counter that has to show a fault.

    Attributes
    ----------
    name : of a counter of `benchmarks.chaos.evidence`
    least : it shows at least that
    share : it shows at least this share of the frames that the fault has touched
    most : it shows at most that
    """

    name: str
    least: float = 0.0
    share: float = 0.0
    most: float | None = None


@dataclass(frozen=True, slots=True)
class Stated:
    """Expected report of a kind of fault.

    Attributes
    ----------
    error : class of the error, exactly; None = nothing is raised
    says : regular expression that its words match
    rule : of `gateway.motion.reactions.REACTIONS` whose remedy it ends with; "" = none
    named : node, joint or id that it names
    counts : counters where nothing is raised
    real : counters in real time, where they differ
    """

    error: type[BaseException] | None = None
    says: str = ""
    rule: str = ""
    named: Named = "node"
    counts: tuple[Count, ...] = ()
    real: tuple[Count, ...] | None = None

    def counts_in(self, pacing: str) -> tuple[Count, ...]:
        """Counters that have to show the fault."""
        return self.real if pacing == "real" and self.real is not None else self.counts


#: In lockstep, where every drive is waited for, nothing else than what is stated may be incomplete.
_COMPLETE = Count("incomplete", most=0)
_GAPS = Count("incomplete", least=1)
_UNANSWERED = "left 5 SYNCs in a row unanswered"
_EMERGENCY = r"sent an emergency: 0x7305, encoder signal faulty"
_BEHIND = r"was commanded to move by -?0\.04\d rad but has moved by -?0\.0\d\d rad"
_EMCY_RESET = (Count("emcy", share=1.0), Count("emcy of the node", share=1.0), Count("emcy of an error", most=0))

STATED: Final[Mapping[str, Stated]] = MappingProxyType(
    {
        # TPDOs and SYNC on the wire
        "tpdo_lost": Stated(counts=(Count("incomplete", least=3, most=3),), real=(Count("incomplete", least=3),)),
        "tpdo_gone": Stated(IncompleteEpochs, _UNANSWERED, "silent"),
        "tpdo_duplicated": Stated(
            counts=(Count("duplicate", share=0.95), _COMPLETE), real=(Count("duplicate", share=0.9),)
        ),
        # delayed but in time is regular: nothing may be counted
        "tpdo_delayed": Stated(counts=(_COMPLETE, Count("delayed", most=0)), real=()),
        "tpdo_reordered": Stated(counts=(_COMPLETE, Count("delayed", most=0), Count("ambiguous", most=0)), real=()),
        "tpdo_late": Stated(counts=(_GAPS, Count("delayed or unsure", least=1))),
        "tpdo_short": Stated(counts=(_GAPS, Count("wrong_length", share=1.0))),
        "tpdo_empty": Stated(counts=(_GAPS, Count("wrong_length", share=1.0))),
        "tpdo_torn": Stated(counts=(_GAPS, Count("ambiguous", share=1.0))),
        "tpdo_stuck": Stated(
            DriveFault, r"repeats position -?\d+, torque -?\d+ since \d+ SYNCs; SDO reports position", "stale"
        ),
        "tpdo_random_loss": Stated(counts=(_GAPS,)),
        "burst": Stated(counts=(_GAPS, Count("delayed or unsure", least=1))),
        # a command that a drive does not receive is not reported; what counts is that no sample is touched
        "rpdo_lost": Stated(counts=(_COMPLETE,), real=()),
        "rpdo_gone": Stated(LimitExceeded, _BEHIND, "stays_behind", "joint"),
        "sync_lost": Stated(counts=(Count("incomplete", least=1, most=1),), real=(_GAPS,)),
        # SDO on the wire
        "sdo_late": Stated(counts=(Count("sdo longest ms", least=95), Count("sdo timeouts", most=0))),
        "sdo_too_late": Stated(counts=(Count("sdo timeouts", least=1), Count("sdo delayed", least=1))),
        "sdo_lost": Stated(counts=(Count("sdo timeouts", least=1),)),
        "sdo_silent": Stated(NodeMissing, "does not respond to SDO requests.*reports PREOPERATIONAL"),
        "sdo_aborted": Stated(SdoAbort, r"6060:00.*0x08000022"),
        "sdo_other_object": Stated(SdoProtocolError, r"6076:00.*none of them to this request"),
        "sdo_wrong_toggle": Stated(SdoProtocolError, "wrong toggle bit in a segment"),
        "sdo_short": Stated(NodeMissing, "does not respond to SDO requests.*reports PREOPERATIONAL"),
        # life signs
        "heartbeat_lost": Stated(HeartbeatLost, "its heartbeat stopped", "heartbeat_lost"),
        "heartbeat_back": Stated(HeartbeatLost, "its heartbeat stopped", "heartbeat_lost"),
        "node_killed": Stated(IncompleteEpochs, _UNANSWERED, "silent"),
        "power_cycle": Stated(DriveRebooted, "booted during the run", "booted"),
        "reboot_keeps_all": Stated(DriveRebooted, "restarted .boot-up message. after it was configured"),
        "reboot_keeps_communication": Stated(ConfigurationRefused, r"6060:00.*0x8 was configured, 0x0 is read now"),
        "reboot_keeps_nothing": Stated(ConfigurationRefused, r"RPDO1 .* since it was configured"),
        "boot_up_frame": Stated(DriveRebooted, "booted during the run", "booted"),
        "nmt_stopped": Stated(NotOperational, "left OPERATIONAL: its heartbeat shows STOPPED", "left_operational"),
        "nmt_preoperational": Stated(
            NotOperational, "left OPERATIONAL: its heartbeat shows PREOPERATIONAL", "left_operational"
        ),
        # EMCY
        "emcy": Stated(DriveFault, _EMERGENCY, "emergency"),
        "emcy_short": Stated(DriveFault, _EMERGENCY, "emergency"),
        "emcy_reset": Stated(counts=(*_EMCY_RESET, _COMPLETE), real=_EMCY_RESET),
        "emcy_storm": Stated(DriveFault, _EMERGENCY, "emergency"),
        # the drive
        "drive_fault": Stated(DriveFault, "left OPERATION ENABLED: FAULT.*encoder signal faulty", "left_enabled"),
        "quick_stop": Stated(DriveFault, "left OPERATION ENABLED: QUICK STOP ACTIVE", "left_enabled"),
        "internal_limit": Stated(DriveFault, "a limit inside the drive acts", "internal_limit"),
        "following_error": Stated(DriveFault, "following error in the drive", "following_error"),
        "safe_torque_off": Stated(DriveFault, "left OPERATION ENABLED: SWITCH ON DISABLED", "left_enabled"),
        "not_following": Stated(DriveFault, "does not follow its target", "not_following"),
        "not_remote": Stated(DriveFault, "no longer under remote control", "not_remote"),
        "warning": Stated(counts=(Count("warnings", share=0.9), _COMPLETE), real=(Count("warnings", share=0.9),)),
        "brake_engaged": Stated(LimitExceeded, _BEHIND, "stays_behind", "joint"),
        "never_settles": Stated(PoseNeverSettles, r"pose \d does not settle within", "never_settles", "joint"),
        "torque_spike": Stated(LimitExceeded, r"the torque has jumped by \d+ Nm", "contact", "joint"),
        # what the drive says about itself
        "demand_torque": Stated(None, r"equals the demand 6074:00"),
        "unsigned_torque": Stated(None, r"never changes its sign, while the demand 6074:00"),
        "heartbeat_ignored": Stated(None, r"continued to move without the master's heartbeat"),
        "wrong_rated": Stated(FindingFailed, r"6072:00.*rated torque in another unit"),
        "write_ignored": Stated(ConfigurationRefused, r"6007:00.*was written, but .* is read back"),
        "drive_exchanged": Stated(
            counts=(Count("torque limits raised", most=0), _COMPLETE), real=(Count("torque limits raised", most=0),)
        ),
        "rated_zero": Stated(ConfigurationRefused, r"6076:00.*rated value is 0"),
        "wrong_vendor": Stated(IdentityMismatch, r"1018:01.*vendor id is 0x[0-9A-F]+ instead of"),
        "node_missing": Stated(NodeMissing, "no device answers"),
        "duplicate_node": Stated(DuplicateNode, "2 devices answer at this node id"),
        "fault_at_start": Stated(DriveFault, "is in FAULT.*0x7305, encoder signal faulty"),
        # strict slaves
        "strict_inhibit": Stated(counts=(_COMPLETE,), real=()),
        "start_refused": Stated(
            counts=(Count("emcy of an error", least=1), _COMPLETE), real=(Count("emcy of an error", least=1),)
        ),
        "cycle_period_set": Stated(
            counts=(Count("ledger 1006", least=1), _COMPLETE), real=(Count("ledger 1006", least=1),)
        ),
        "no_data_abort": Stated(counts=(Count("sdo aborts", least=1), _COMPLETE), real=(Count("sdo aborts", least=1),)),
        "tpdo3_on": Stated(
            counts=(Count("ledger 1802", least=1), Count("tpdo3 on", most=0), _COMPLETE),
            real=(Count("ledger 1802", least=1), Count("tpdo3 on", most=0)),
        ),
        "foreign_emcy_id": Stated(
            counts=(Count("emcy of the node", least=1), _COMPLETE), real=(Count("emcy of the node", least=1),)
        ),
        # makes
        **{
            kind: Stated(counts=(_COMPLETE,), real=())
            for kind in (
                *("object_read_only", "object_value", "object_range", "object_not_mappable", "object_size"),
                *("object_rounded", "record_short", "status_bits_off", "mode_display_late"),
                *("mapping_locked", "period_pair", "slow_enable", "rpdo_at_once"),
            )
        },
        "object_absent": Stated(counts=(Count("sdo aborts", least=1), _COMPLETE), real=(Count("sdo aborts", least=1),)),
        "modes_supported": Stated(FindingFailed, "no cyclic synchronous position mode"),
        # of a drive whose profile does not say that they mean nothing
        "status_bits_on": Stated(DriveFault, "a limit inside the drive acts", "internal_limit"),
        "warning_emcy": Stated(DriveFault, "sent an emergency: 0x4310", "emergency"),
        "position_wraps": Stated(LimitExceeded, "rad off its target|but has moved by", named="joint"),
        "single_turn": Stated(ConfigurationRefused, "since it was configured"),
        "sync_producer": Stated(ForeignMaster, r"has sent \d+ SYNC; nothing was sent", named="no node"),
        # drives that may not be moved
        "start_never": Stated(
            NotOperational, "does not go to OPERATIONAL.*PREOPERATIONAL.*communication error may be active"
        ),
        "emcy_disabled": Stated(ConfigurationRefused, r"1014:00.*EMCY messages are switched off"),
        "estop_pressed": Stated(DriveFault, r"must not move: emergency stop: 60FD:00"),
        "unreferenced": Stated(DriveFault, r"must not move: the encoder is not referenced: 60FD:00"),
        "coasting_stop": Stated(FindingFailed, r"605E:00.*a fault disables the drive; the axis coasts"),
        "no_heartbeat": Stated(HeartbeatLost, r"1017:00.*sends no heartbeat"),
        "never_enables": Stated(TransitionTimeout, "stays in SWITCHED ON for more than"),
        "enables_and_drops": Stated(DriveFault, "left OPERATION ENABLED: SWITCHED ON", "left_enabled"),
        "brake_slips": Stated(BrakeDropped, r"sank by 0\.\d+ rad in its brake", named="joint"),
        "brake_falls": Stated(None, r"sank by 0\.0[01]\d\d rad in its brake within .* held by its drive again"),
        "slow_brake": Stated(None, r"sank by 0\.0\d+ rad in its brake"),
        # the bus
        "second_master_sync": Stated(
            ForeignMaster, "a frame with id 080 .* came from another master", "second_master", "no node"
        ),
        "second_master_nmt": Stated(
            ForeignMaster, "a frame with id 000 .* came from another master", "second_master", "no node"
        ),
        "second_master_sdo": Stated(
            ForeignMaster, "3 frames with id 6.. .* came from another master", "foreign_master", "id"
        ),
        "second_master_slow": Stated(
            ForeignMaster, r"in 0\.5 s it has sent [456] SYNC; nothing was sent", named="no node"
        ),
        "error_frames": Stated(
            counts=(Count("error frames", share=1.0), _COMPLETE), real=(Count("error frames", share=1.0),)
        ),
        "error_passive": Stated(
            counts=(Count("error frames", share=1.0), _COMPLETE), real=(Count("error frames", share=1.0),)
        ),
        "bus_off": Stated(BusOff, "the CAN controller is bus-off", "bus_off", "no node"),
        "strange_frames": Stated(
            counts=(Count("extended frames", share=0.5), Count("remote frames", share=0.5), _COMPLETE),
            real=(Count("extended frames", share=0.5), Count("remote frames", share=0.5)),
        ),
        # the master
        "queue_full": Stated(
            counts=(Count("send retries", least=1), _COMPLETE), real=(Count("send retries", least=1),)
        ),
    }
)
