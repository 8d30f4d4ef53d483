"""The gate: what is read of drives in their brakes decides what may be done with the arm and what is said of it."""

from __future__ import annotations

import itertools
import re

import pytest

from drives.errors import (
    ConfigurationRefused,
    DriveFault,
    DriveRebooted,
    ForeignMaster,
    IdentityMismatch,
    SdoTimeout,
    SeveralFailures,
)
from drives.gate import ArmState
from drives.group import DriveGroup
from drives.values import AxisSetup
from tests.drives.conftest import configured

PERIOD_S = 0.01


@pytest.fixture
def slaves(make_slave):
    slaves = [make_slave(node_id) for node_id in (1, 2)]
    for slave in slaves:
        slave.types[0x6072, 0], slave.values[0x6072, 0] = "u16", 3000
        slave.values[0x6007, 0] = 0
    return slaves


@pytest.fixture(params=["lockstep", "real"])
def waiting(bus, slaves, generic, request):
    """A group that was under power and waits in its brakes, and what each drive was delivered with."""
    delivered = [dict(slave.values) for slave in slaves]
    setups = [AxisSetup(node_id, generic, 0.5, 300.0, torque_limit_nm=1.0) for node_id in (1, 2)]
    with configured(bus, setups, PERIOD_S, request.param) as group:
        for slave in slaves:
            slave.position = 400_000
        group.enable()
        for _ in range(5):
            group.hold()
        group.disable()
        yield group, delivered


def test_of_an_arm_in_its_brakes_both_gates_say_when_every_drive_was_read(waiting):
    group, _ = waiting
    brief, full = group.gate(), group.gate(full=True)
    assert (brief.safe_to_approach, brief.safe_to_power) == (True, False)
    assert (full.safe_to_approach, full.safe_to_power) == (True, True)
    assert re.fullmatch(r"every drive was read as disabled at \d\d:\d\d:\d\d UTC", str(brief))


def test_between_motions_no_pdo_enables_a_drive(bus, slaves, waiting):
    group, _ = waiting
    assert [slave.nmt for slave in slaves] == [127, 127]
    group.enable()
    assert [slave.nmt for slave in slaves] == [5, 5]


@pytest.mark.parametrize(
    ("change", "error", "disabled", "said"),
    [
        (lambda slave: setattr(slave, "state", "operation enabled"), DriveFault, False, "node 2: OPERATION ENABLED"),
        (lambda slave: setattr(slave, "state", "quick stop"), DriveFault, False, "node 2: QUICK STOP ACTIVE"),
        (lambda slave: setattr(slave, "alive", False), SdoTimeout, False, "node 2: not read"),
        (lambda slave: setattr(slave, "position", slave.position + 50_000), ConfigurationRefused, True, "disabled"),
        (lambda slave: slave.heartbeat(0), DriveRebooted, True, "read as disabled"),
        (lambda slave: slave.emergency(bytes.fromhex("1032040000000000")), DriveFault, True, "read as disabled"),
    ],
    ids=["enabled", "quick stop", "silent", "moved", "booted", "emergency"],
)
def test_after_a_change_of_one_drive_the_arm_is_not_safe(slaves, waiting, change, error, disabled, said):
    group, _ = waiting
    change(slaves[1])
    state = group.gate()
    assert (state.is_disabled, state.safe_to_approach) == (disabled, False)
    assert said in str(state)
    assert ("use the emergency stop" in str(state)) is not disabled
    with pytest.raises(error) as refused:
        state.require_approach()
    assert refused.value.node == 2
    assert not group.gate(full=True).safe_to_power or error is DriveFault and slaves[1].state == "switch on disabled"


def test_a_fault_leaves_the_axis_in_its_brake_and_keeps_power_away(slaves, waiting):
    group, _ = waiting
    slaves[1].state = "fault"
    state = group.gate(full=True)
    assert (state.safe_to_approach, state.safe_to_power) == (True, False)
    with pytest.raises(DriveFault, match="node 2.*FAULT"):
        state.require_power()
    slaves[1].state = "fault reaction"
    assert not group.gate().safe_to_approach


def test_an_emergency_that_came_before_the_drives_were_disabled_is_not_one_of_their_brakes(slaves, waiting):
    group, _ = waiting
    group.enable()
    slaves[1].emergency(bytes.fromhex("1032040000000000"))
    group.disable()
    assert group.gate().safe_to_approach


def test_while_a_person_is_at_the_arm_the_heartbeat_goes_on_and_a_change_is_raised(wire, slaves, waiting):
    group, _ = waiting
    sent, began_s = len(wire.sent), wire.now_s
    while wire.now_s < began_s + 2.5:
        group.attend()
    beats = [at_s for at_s, (can_id, _) in zip(wire.sent_at_s[sent:], wire.sent[sent:], strict=True) if can_id == 0x77F]
    assert max(b - a for a, b in itertools.pairwise(beats)) < 0.5
    slaves[0].position += 50_000

    def stay_for_ten_seconds():
        while wire.now_s < began_s + 12.5:
            group.attend()

    with pytest.raises(ConfigurationRefused, match="came to rest"):
        stay_for_ten_seconds()
    assert wire.now_s < began_s + 3.7


def test_a_drive_that_another_master_started_is_refused(slaves, waiting):
    group, _ = waiting
    slaves[1].heartbeat(5)  # it was sent before the drives were commanded to leave OPERATIONAL
    assert group.gate().safe_to_approach
    slaves[1].heartbeat(5)
    state = group.gate()
    assert (state.is_disabled, state.safe_to_approach) == (True, False)
    with pytest.raises(ForeignMaster, match="OPERATIONAL") as refused:
        state.require_approach()
    assert refused.value.node == 2


def test_drives_are_operational_under_power_and_not_afterwards(slaves, waiting):
    group, _ = waiting
    group.enable()
    for slave in slaves:
        slave.heartbeat(5)
        slave.heartbeat(5)
    group.disable()
    for slave in slaves:
        slave.heartbeat()
    assert group.gate(full=True).safe_to_power


def restart(slave, delivered, kept=lambda _index: False):
    """Switch a drive off and on: objects that it does not keep are as delivered, and it says that it booted."""
    for address, value in delivered.items():
        if not kept(address[0]):
            slave.values[address] = value
    slave.nmt, slave.state = 127, "switch on disabled"
    slave.values[0x1016, 1] = 0
    slave.heartbeat(0)


@pytest.mark.parametrize(
    ("kept", "differs"),
    [(lambda index: index < 0x2000, "6060|6072|60C2|6007"), (lambda _index: False, "RPDO1 MAPS 1 OBJECTS")],
    ids=["keeps its communication part", "keeps nothing"],
)
def test_a_drive_that_restarted_is_refused_before_power(bus, slaves, waiting, kept, differs):
    group, delivered = waiting
    restart(slaves[1], delivered[1], kept)
    bus.listen(0.02)
    with pytest.raises(ConfigurationRefused) as refused:
        group.enable()
    assert refused.value.node == 2
    assert re.search(differs, str(refused.value).upper())
    assert not any(slave.state == "operation enabled" for slave in slaves)
    group.configure()
    group.enable()
    assert slaves[1].values[0x6060, 0] == 8
    assert slaves[1].values[0x6072, 0] < 3000


@pytest.mark.parametrize("armed", [False, True], ids=["at the full gate", "at the brief one"])
@pytest.mark.parametrize("keeps", [True, False], ids=["stored configuration", "as delivered"])
def test_a_drive_that_restarts_while_the_last_one_is_read_back_is_refused(slaves, waiting, keeps, armed):
    group, delivered = waiting
    first, last = slaves
    plain = last.get

    def get(address):
        if address == (0x6064, 0) and bool(first.values[0x1016, 1]) is armed:
            last.get = plain
            restart(first, delivered[0], lambda _index: keeps)
        return plain(address)

    last.get = get
    with pytest.raises(DriveRebooted, match="node 1: restarted"):
        group.enable()
    assert not any(slave.state == "operation enabled" for slave in slaves)
    with pytest.raises(ConfigurationRefused, match="configure"):
        group.enable()
    group.configure()
    group.enable()
    assert first.values[0x6060, 0] == 8


def test_a_drive_that_was_exchanged_for_one_with_the_same_settings_is_refused(slaves, waiting):
    group, _ = waiting
    slaves[1].values[0x1018, 4], slaves[1].texts[0x100A, 0] = 2222, b"v2"
    with pytest.raises(
        IdentityMismatch, match="serial number was 2, 2222 is read; software version was v1, v2 is read"
    ):
        group.enable()
    assert not any(slave.state == "operation enabled" for slave in slaves)


def test_two_drives_that_restarted_are_both_named(bus, slaves, waiting):
    group, delivered = waiting
    for slave, values in zip(slaves, delivered, strict=True):
        restart(slave, values)
    bus.listen(0.02)
    with pytest.raises(SeveralFailures) as refused:
        group.enable()
    assert {failure.node for failure in refused.value.failures} == {1, 2}
    assert not any(slave.state == "operation enabled" for slave in slaves)


def test_objects_that_differ_are_listed_also_where_a_pdo_differs(bus, slaves, waiting):
    group, delivered = waiting
    restart(slaves[1], delivered[1])
    bus.listen(0.02)
    with pytest.raises(ConfigurationRefused, match="RPDO1 maps 1 objects") as refused:
        group.enable()
    for named in ("1400:02", "6060:00", "6072:00", "6007:00", "0x3 was configured, 0x0 is read now"):
        assert named in str(refused.value)
    assert len(str(refused.value).splitlines()) <= 10


def test_a_position_that_restarted_at_zero_is_refused_also_after_configuring_again(bus, slaves, waiting):
    group, _ = waiting
    slaves[1].position = 0
    for _ in range(2):
        with pytest.raises(ConfigurationRefused, match="400000 counts, 0 counts"):
            group.enable()
        group.configure()
    assert not any(slave.state == "operation enabled" for slave in slaves)


def test_what_the_drive_kept_is_enabled_again(slaves, waiting):
    group, _ = waiting
    slaves[1].position += 100
    group.enable()
    assert all(slave.state == "operation enabled" for slave in slaves)


@pytest.mark.parametrize(("value", "exponent", "fits"), [(1, -3, False), (10, -3, True), (1, -2, True)])
def test_an_interpolation_period_that_may_not_be_written_has_to_be_the_sync_period(
    bus, make_slave, generic, value, exponent, fits
):
    slave = make_slave(1)
    slave.values[0x60C2, 1], slave.values[0x60C2, 2] = value, exponent
    write = generic.write.model_copy(update={"allow": tuple(each for each in generic.write.allow if each != 0x60C2)})
    profile = generic.model_copy(update={"write": write})
    with DriveGroup(bus, [AxisSetup(1, profile, 0.5, 300.0)], PERIOD_S, "real") as group:
        group.connect()
        if fits:
            group.configure()
            slave.values[0x60C2, 1] += 1
            assert not group.gate(full=True).safe_to_power
        else:
            with pytest.raises(
                ConfigurationRefused, match="interpolates over 0.001 s, the master sends a SYNC every 0.01"
            ):
                group.configure()


def test_drives_that_all_stay_unanswered_are_found_in_the_time_of_one(wire, slaves, waiting):
    """The sentence that names the emergency stop does not come later for each drive that has lost its supply."""
    group, _ = waiting
    for slave in slaves:
        slave.alive = False
    began_s = wire.now_s
    state = group.gate()
    assert wire.now_s - began_s < 0.7
    assert [type(drive.failure) for drive in state.drives] == [SdoTimeout, SdoTimeout]
    assert "use the emergency stop (node 1: not read; node 2: not read)" in str(state)


def test_an_answer_that_is_lost_once_is_asked_for_again(slaves, waiting):
    group, _ = waiting
    answers = iter([[]])
    slaves[1].reply = lambda request, answer: next(answers, [(0.0, answer)])
    assert group.gate().safe_to_approach


def test_of_several_arms_a_node_is_named_with_its_arm(slaves, waiting):
    group, _ = waiting
    safe = group.gate()
    slaves[1].state = "operation enabled"
    both = ArmState.of({"left": safe, "right": group.gate()})
    assert "(arm right, node 2: OPERATION ENABLED)" in str(both)
    assert not both.safe_to_approach
