"""The drives of an arm brought up, moved and stopped; slaves behind a wire."""

from __future__ import annotations

import gc
import math
import shutil
from dataclasses import replace

import can
import pytest

from drives.drive import DriveCommand
from drives.errors import (
    BusError,
    BusOff,
    CommandRefused,
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
    NotStoodDown,
    SdoTimeout,
    SeveralFailures,
    TransitionTimeout,
)
from drives.group import DriveGroup, GroupOptions
from drives.objects import OBJECTS
from drives.values import AxisSetup
from tests.drives.conftest import configured

PERIOD_S = 0.004
COUNT_RAD = 2 * math.pi / 65536


@pytest.fixture
def slaves(add_slaves):
    return add_slaves(6)


@pytest.fixture
def group(bus, slaves, setups):
    with configured(bus, setups(6), PERIOD_S) as group:
        yield group


def targets(slaves, step=0):
    return [DriveCommand((slave.position + step) * COUNT_RAD) for slave in slaves]


@pytest.mark.parametrize(("pacing", "frozen"), [("real", True), ("lockstep", False)])
def test_by_the_clock_no_collection_looks_at_all_that_was_loaded(bus, slaves, setups, pacing, frozen):
    """A full collection takes 20 to 40 ms; what has been loaded before is out of its sight until the bus is closed."""
    gc.unfreeze()
    with configured(bus, setups(6), PERIOD_S, pacing) as group:
        group.enable()
        assert (gc.get_freeze_count() > 10_000) == frozen
    assert gc.get_freeze_count() == 0


def test_enabled_axes_hold_where_they_are_and_follow_the_next_target(group, slaves):
    before = [slave.position for slave in slaves]
    epoch = group.enable()
    assert epoch.complete
    assert [slave.position for slave in slaves] == before
    assert {slave.state for slave in slaves} == {"operation enabled"}
    group.exchange(targets(slaves, step=50))
    epoch = group.hold()
    assert [reading.position_count for reading in epoch.readings] == [count + 50 for count in before]
    assert [reading.sync_index for reading in epoch.readings] == [epoch.sync_index] * 6
    group.disable()
    assert {slave.state for slave in slaves} == {"switch on disabled"}


def test_torque_and_current_follow_the_formula_of_the_standard(group, slaves):
    """Per mille of the rated torque 2 Nm and of the rated current 5 A (CiA 402-2, 0x6077 and 0x6078)."""
    epoch = group.enable()
    for slave, reading in zip(slaves, epoch.readings, strict=True):
        assert reading.torque_nm == pytest.approx(slave.torque / 1000 * 2.0)
        assert reading.current_a == pytest.approx(2 * slave.torque / 1000 * 5.0)
        assert reading.position_rad == pytest.approx(slave.position / 65536 * 2 * math.pi)


def test_the_drives_watch_the_master_from_before_the_first_command_until_after_the_last(group, slaves, wire):
    for _ in range(2):
        wire.sent.clear()
        group.enable()
        assert {slave.values[0x1016, 1] for slave in slaves} == {127 << 16 | 500}
        assert {slave.values[0x6007, 0] for slave in slaves} == {3}
        ids = [can_id for can_id, _ in wire.sent]
        assert ids.index(0x77F) < ids.index(0x201)
        group.disable()
        assert {slave.values[0x1016, 1] for slave in slaves} == {0}


def test_heartbeat_is_sent_often_enough_for_the_drives(group, slaves, wire):
    group.enable()
    start = len(wire.sent)
    for number in range(500):
        for slave in slaves:
            slave.torque = number
        group.hold()
    assert {can_id & 0x780 for can_id, _ in wire.sent[start:]} == {0x080, 0x200, 0x700}
    assert sum(can_id == 0x77F for can_id, _ in wire.sent[start:]) >= 500 * PERIOD_S / 0.5 * 2


def test_pdo_mapping_is_what_the_standard_objects_say(group, slaves):
    """TPDO1 = 6041, 6064, 6077; TPDO2 = 606C, 6078; RPDO1 = 6040, 607A; all synchronous, every SYNC.

    The inhibit time has no meaning there (CiA 301, 7.5.2.37) and stays as it was.
    """
    for slave in slaves:
        values = slave.values
        assert [values[0x1A00, sub] for sub in (0, 1, 2, 3)] == [3, 0x60410010, 0x60640020, 0x60770010]
        assert [values[0x1A01, sub] for sub in (0, 1, 2)] == [2, 0x606C0020, 0x60780010]
        assert [values[0x1600, sub] for sub in (0, 1, 2, 3)] == [2, 0x60400010, 0x607A0020, 0]
        assert [values[index, 2] for index in (0x1400, 0x1800, 0x1801)] == [1, 1, 1]
        assert [values[index, 3] for index in (0x1800, 0x1801)] == [300, 300]
        assert values[0x6060, 0] == 8
        assert (values[0x60C2, 1], values[0x60C2, 2]) == (4, -3)


def test_what_is_right_already_is_not_written_again(bus, slaves, setups):
    for _ in range(2):
        with configured(bus, setups(6), PERIOD_S):
            written = [list(slave.written) for slave in slaves]
            for slave in slaves:
                slave.written.clear()
    assert written == [[]] * 6


def test_restore_puts_back_what_was_there_also_after_a_crash(bus, slaves, setups, tmp_path):
    before = [dict(slave.values) for slave in slaves]
    options = GroupOptions(ledger_path=tmp_path / "ledger.json")
    group = DriveGroup(bus, setups(6), PERIOD_S, options=options)
    group.connect()
    group.configure()
    assert all(slave.values != old for slave, old in zip(slaves, before, strict=True))
    del group
    with DriveGroup(bus, setups(6), PERIOD_S, options=options) as later:
        later.connect()
        later.restore()
        assert later.ledger.entries == ()
    for slave, old in zip(slaves, before, strict=True):
        changed = {key: (old[key], value) for key, value in slave.values.items() if value != old[key]}
        assert {key for key in changed if not (0x1600 <= key[0] < 0x1C00 and key[1] > old[key[0], 0])} == set()


def test_restore_leaves_the_successor_of_a_drive_alone(bus, slaves, setups, tmp_path):
    options = GroupOptions(ledger_path=tmp_path / "ledger.json")
    with configured(bus, setups(6), PERIOD_S, options=options) as group:
        slaves[2].values[0x1018, 4] = 999
        slaves[2].written.clear()
        group.connect()
        with pytest.raises(IdentityMismatch, match="node 3"):
            group.restore()
    assert slaves[2].written == []


def test_every_missing_and_wrong_drive_is_named_at_once(bus, slaves, setups, make_slave):
    slaves[1].alive = False
    slaves[4].values[0x1000, 0] = 0x191
    make_slave(6, serial=77)
    with DriveGroup(bus, setups(6), PERIOD_S) as group, pytest.raises(SeveralFailures) as caught:
        group.connect()
    kinds = {(type(failure), failure.node) for failure in caught.value.failures}
    assert kinds == {(NodeMissing, 2), (IdentityMismatch, 5), (DuplicateNode, 6)}
    assert caught.value.exit_code == 4


def test_a_stopped_node_is_found(bus, slaves, setups):
    slaves[3].nmt = 4
    with DriveGroup(bus, setups(6), PERIOD_S) as group:
        assert [identity.serial_number for identity in group.connect()] == [1, 2, 3, 4, 5, 6]


def test_a_drive_in_fault_is_refused_and_not_reset(group, slaves):
    slaves[2].state = "fault"
    slaves[2].values[0x603F, 0] = 0x8611
    with pytest.raises(DriveFault, match="node 3.*FAULT.*following error") as caught:
        group.enable()
    assert caught.value.node == 3
    assert [slave.controlwords for slave in slaves] == [[]] * 6
    assert {slave.state for slave in slaves} == {"switch on disabled", "fault"}


def test_a_fault_is_reset_only_when_a_person_says_so(group, slaves):
    slaves[2].state = "fault"
    group.drives[2].reset_fault()
    assert slaves[2].state == "switch on disabled"
    slaves[2].state, slaves[2].stuck_in = "fault", "fault"
    with pytest.raises(DriveFault, match="still in FAULT"):
        group.drives[2].reset_fault()


def test_a_drive_may_take_a_moment_to_leave_fault(group, slaves, wire):
    slave = slaves[2]
    slave.state, reset_s = "fault", []

    def slowly(word):
        if word & 0x80:
            reset_s.append(wire.now_s)
        return not word & 0x80

    def statusword():
        if reset_s and wire.now_s > reset_s[0] + 0.3:
            slave.state = "switch on disabled"
        return type(slave).statusword.fget(slave)

    slave.obeys = slowly
    slave.get = lambda address, get=slave.get: statusword() if address == (0x6041, 0) else get(address)
    group.drives[2].reset_fault()
    assert slave.state == "switch on disabled"
    assert wire.now_s - reset_s[0] < 0.5


def test_a_drive_that_does_not_switch_on_times_out_and_all_are_disabled(group, slaves):
    slaves[4].stuck_in = "ready"
    with pytest.raises(TransitionTimeout, match="node 5.*READY TO SWITCH ON") as caught:
        group.enable()
    assert isinstance(caught.value, TimeoutError)
    assert {slave.state for slave in slaves} <= {"switch on disabled", "ready"}
    assert not group.enabled


def test_a_fault_while_moving_stops_all_axes_within_five_syncs(group, slaves):
    group.enable()
    slaves[1].state = "fault"
    slaves[1].emergency(bytes.fromhex("1186 21"))
    first = slaves[0].sync_seen
    with pytest.raises(DriveFault, match="node 2.*left OPERATION ENABLED: FAULT.*following error") as caught:
        group.hold()
    words = [slave.controlwords[-1] for slave in slaves if slave.node_id != 2]
    assert words == [0x02] * 5
    assert slaves[0].sync_seen - first <= 6
    assert {slave.state for slave in slaves} == {"quick stop", "fault"}
    assert caught.value.while_stopping == ()
    with pytest.raises(ConfigurationRefused):
        group.exchange(targets(slaves))
    group.disable()
    assert {slave.state for slave in slaves} == {"switch on disabled", "fault"}


def test_no_controlword_while_disabling_energises(group, slaves):
    group.enable()
    for slave in slaves:
        slave.controlwords.clear()
    group.quick_stop()
    group.disable()
    assert {word & 0x08 for slave in slaves for word in slave.controlwords} == {0}


def test_an_axis_that_stops_responding_stops_the_others(group, slaves):
    group.enable()
    slaves[5].alive = False
    epochs = [group.hold() for _ in range(4)]
    assert [epoch.missing for epoch in epochs] == [(5,)] * 4
    start = slaves[0].wire.now_s
    with pytest.raises(IncompleteEpochs, match="node 6.*check power and cabling") as caught:
        group.hold()
    assert {slave.state for slave in slaves[:5]} == {"quick stop"}
    assert slaves[0].wire.now_s - start < 1.5
    assert [failure.node for failure in caught.value.while_stopping] == [6]
    with pytest.raises(SdoTimeout, match="node 6"):
        group.disable()
    assert {slave.state for slave in slaves[:5]} == {"switch on disabled"}
    assert {slave.values[0x1016, 1] for slave in slaves[:5]} == {0}


def test_boot_up_in_the_middle_of_a_run_is_found_and_needs_a_new_configuration(group, slaves):
    group.enable()
    slaves[3].state, slaves[3].nmt = "switch on disabled", 127
    slaves[3].heartbeat(0)
    with pytest.raises(DriveRebooted, match="node 4"):
        group.hold()
    assert {slave.state for slave in slaves} == {"quick stop", "switch on disabled"}
    group.disable()
    with pytest.raises(DriveRebooted, match="node 4"):
        group.enable()
    group.connect()
    group.configure()
    assert group.enable().complete


def test_a_heartbeat_that_stops_is_missed(group, slaves):
    group.enable()
    slaves[0].beats = False

    def go_on():
        for _ in range(1000):
            group.hold()
            slaves[0].wire.sleep(PERIOD_S)

    with pytest.raises(HeartbeatLost, match="node 1"):
        go_on()


def test_another_master_is_refused_at_the_start(bus, slaves, setups, wire):
    wire.emit(0x080, b"", 0.01)
    with DriveGroup(bus, setups(6), PERIOD_S) as group, pytest.raises(ForeignMaster, match="SYNC"):
        group.connect()


@pytest.mark.parametrize(("can_id", "frames"), [(0x000, 1), (0x080, 1), (0x203, 3), (0x604, 3)])
@pytest.mark.parametrize("echo", [False, True])
def test_the_first_sync_or_nmt_frame_of_another_master_stops(bus, slaves, setups, wire, can_id, frames, echo):
    """Whatever the SYNC index: it is reported at the very SYNC after which it is there."""
    wire.echo = bus.echoes = echo
    for offset in range(5):
        with configured(bus, setups(6), PERIOD_S) as group:
            group.enable()
            for _ in range(offset):
                group.hold()
            for _ in range(frames - 1):
                wire.emit(can_id, b"\x80\x55"[: 2 if can_id == 0 else 0])
                group.hold()
            wire.emit(can_id, b"\x80\x55"[: 2 if can_id == 0 else 0])
            with pytest.raises(ForeignMaster, match=f"{can_id:03X}"):
                group.hold()
            assert {slave.state for slave in slaves} == {"quick stop"}


def test_own_frames_that_come_back_are_no_other_master(bus, slaves, setups, wire):
    wire.echo = bus.echoes = True
    with configured(bus, setups(6), PERIOD_S) as group:
        group.enable()
        for _ in range(100):
            group.hold()
        assert sum(group.statistics.foreign.values()) == 0


@pytest.mark.parametrize(
    "command",
    [
        DriveCommand(math.nan),
        DriveCommand(math.inf),
        DriveCommand(1e9),
        DriveCommand(1.0 + 10 * 300.0 * PERIOD_S),
        DriveCommand(6000 * COUNT_RAD, torque_offset_nm=1e5),
        DriveCommand(6000 * COUNT_RAD, torque_offset_nm=math.nan),
    ],
)
def test_a_target_outside_the_limits_is_refused_and_nothing_is_sent(group, slaves, wire, command):
    group.enable()
    sent = len(wire.sent)
    with pytest.raises(CommandRefused, match="node 6"):
        group.exchange([*targets(slaves)[:5], command])
    assert len(wire.sent) == sent
    assert group.hold().complete


def test_every_write_is_in_the_ledger_with_the_old_value(group, slaves):
    ledger = {(entry.node_id, entry.index, entry.subindex): entry for entry in group.ledger.entries}
    assert ledger[1, 0x6007, 0].old == 1
    assert ledger[1, 0x6007, 0].new == 3
    assert ledger[1, 0x1800, 1].old == 0x40000181
    for slave in slaves:
        assert {(slave.node_id, *write[:2]) for write in slave.written} <= set(ledger)


def test_nothing_is_ever_stored(group, slaves):
    group.enable()
    group.disable()
    assert not any(index in (0x1010, 0x1011) for slave in slaves for index, _, _ in slave.written)


def test_a_value_that_does_not_stick_is_an_error(bus, slaves, setups):
    class Ignoring(dict):
        def __setitem__(self, key, value):
            super().__setitem__(key, 1 if key == (0x6007, 0) else value)

    slaves[1].values = Ignoring(slaves[1].values)
    with DriveGroup(bus, setups(6), PERIOD_S) as group:
        group.connect()
        with pytest.raises(ConfigurationRefused, match="node 2:6007:00"):
            group.configure()


def test_bus_off_in_a_run_is_an_error(group, slaves, wire):
    group.enable()
    wire.emit(0x040, bytes(8), is_error_frame=True)
    with pytest.raises(BusOff):
        group.hold()
    assert not group.enabled


def test_targets_stay_inside_the_position_limits(bus, slaves, generic):
    setups = [AxisSetup(1, generic, 0.5, 300.0, position_limit_rad=(899.5 * COUNT_RAD, 1100.5 * COUNT_RAD))]
    with configured(bus, setups, PERIOD_S) as group:
        group.enable()
        group.exchange([DriveCommand(1100 * COUNT_RAD)])
        with pytest.raises(CommandRefused, match=r"1101 counts is outside 900 \.\. 1100"):
            group.exchange([DriveCommand(1101 * COUNT_RAD)])


def test_a_drive_enabled_by_another_master_is_not_configured(bus, slaves, setups):
    slaves[1].state = "operation enabled"
    with DriveGroup(bus, setups(6), PERIOD_S) as group:
        group.connect()
        with pytest.raises(DriveFault, match="node 2.*OPERATION ENABLED"):
            group.configure()
    assert slaves[1].written == []


@pytest.mark.parametrize(
    ("address", "kind", "value"),
    [((0x1005, 0), "u32", 0x40000080), ((0x1005, 0), "u32", 0x81), ((0x1019, 0), "u8", 10)],
)
def test_a_drive_that_wants_another_sync_is_refused(bus, slaves, setups, address, kind, value):
    slaves[3].types[address], slaves[3].values[address] = kind, value
    with DriveGroup(bus, setups(6), PERIOD_S) as group:
        group.connect()
        with pytest.raises(ConfigurationRefused, match=f"node 4:{address[0]:04X}"):
            group.configure()


def test_a_mapping_that_is_shifted_is_found_before_anything_moves(group, slaves, wire):
    real = wire.emit
    wire.emit = lambda can_id, data, *rest, **flags: real(
        can_id, data[:2] + data[4:] + data[2:4] if can_id == 0x185 else data, *rest, **flags
    )
    with pytest.raises(ConfigurationRefused, match="node 5.*TPDO1 reports"):
        group.enable()
    assert {word & 0x0F for slave in slaves for word in slave.controlwords} <= {0x00}


def test_only_what_the_profile_allows_is_written(group, slaves):
    with pytest.raises(ConfigurationRefused, match="6073:00.*does not allow"):
        group.access[0].write(OBJECTS["max_current"], 100, "test")
    assert 0x6073 not in {index for index, _, _ in slaves[0].written}


def test_rated_values_of_zero_and_a_resolution_of_one_count_are_refused(bus, slaves, setups):
    slaves[0].values[0x6076, 0] = 0
    slaves[1].values[0x608F, 1] = 1  # in one revolution: delivered without a motor
    with DriveGroup(bus, setups(6), PERIOD_S) as group:
        group.connect()
        with pytest.raises(SeveralFailures, match="6076:00.*608F:01"):
            group.configure()


def test_leaving_without_an_adapter_is_one_error_with_the_last_state_of_each_drive(group, wire):
    def gone(*_arguments, **_named):
        raise can.CanOperationError("Network is down")

    group.enable()
    group.hold()
    wire.send = wire.recv = gone
    with pytest.raises(BusError) as caught:
        group.close()
    assert str(caught.value).count("Network is down") == 1
    (note,) = caught.value.__notes__
    assert "emergency stop" in note
    assert note.count("OPERATION ENABLED") == 6


def test_node_ids_must_differ_also_from_the_masters(bus, setups):
    with pytest.raises(ConfigurationRefused):
        DriveGroup(bus, [*setups(2), *setups(1)], PERIOD_S)
    with pytest.raises(ConfigurationRefused):
        DriveGroup(bus, [replace(setups(1)[0], node_id=127)], PERIOD_S)
    with pytest.raises(ConfigurationRefused):
        DriveGroup(bus, [], PERIOD_S)


@pytest.mark.parametrize("period_s", [0.0, -PERIOD_S, math.nan, math.inf, -math.inf])
def test_a_period_is_a_positive_time(bus, setups, period_s):
    with pytest.raises(ConfigurationRefused, match="not positive"):
        DriveGroup(bus, setups(2), period_s)


def test_a_master_that_paused_does_not_call_a_heartbeat_lost(group, slaves, wire):
    """In lockstep the drives' time is stopped while no SYNC is sent."""
    group.enable()
    slaves[0].heartbeat()
    group.hold()
    wire.sleep(60.0)
    for _ in range(50):
        group.hold()
    assert group.enabled


def test_a_drive_that_leaves_operational_stops_all_axes_at_its_next_heartbeat(group, slaves, wire):
    group.enable()
    for slave in slaves:
        slave.heartbeat()
    group.hold()
    slaves[1].nmt = 127
    slaves[1].heartbeat()
    sent = len(wire.sent)
    with pytest.raises(NotOperational, match="node 2: left OPERATIONAL: its heartbeat shows PREOPERATIONAL"):
        group.hold()
    words = [data[0] for can_id, data in wire.sent[sent:] if can_id == 0x201]
    assert words[:2] == [0x0F, 0x02], "one SYNC more, then the quick stop"
    assert not group.enabled
    assert {slave.state for slave in slaves} <= {"quick stop", "switch on disabled"}


def test_an_adapter_that_dies_in_a_run_is_one_error_in_bounded_time(group, slaves, wire):
    group.enable()
    wire.send_errors = 1 << 30
    start = wire.now_s
    with pytest.raises(BusError, match="could not be sent"):
        group.hold()
    assert wire.now_s - start < 1.0
    assert not group.enabled
    wire.send_errors = 0
    group.disable()
    assert {slave.state for slave in slaves} == {"switch on disabled"}


@pytest.mark.parametrize("in_fault", [False, True])
def test_a_ledger_that_cannot_be_written_does_not_hide_that_all_drives_are_disabled(
    bus, slaves, setups, tmp_path, in_fault
):
    folder = tmp_path / "state"
    group = DriveGroup(bus, setups(6), PERIOD_S, options=GroupOptions(ledger_path=folder / "ledger.json"))
    group.connect()
    group.configure()
    group.enable()
    shutil.rmtree(folder)
    folder.write_text("not a folder: the ledger cannot be written")
    if in_fault:
        slaves[1].state = "fault"
        with pytest.raises(DriveFault):
            group.hold()
    with pytest.raises(NotStoodDown, match="every drive was read as disabled; then: .*cannot be written") as failed:
        group.disable()
    assert {slave.state for slave in slaves} <= {"switch on disabled", "fault"}
    assert "emergency stop" not in str(failed.value)
    folder.unlink()
    group.close()
