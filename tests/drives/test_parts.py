"""Small parts of the motor side: PDO plans, emergencies, heartbeats, ledger, bus load, clock, statistics, scan."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drives.bringup import decimal_periods
from drives.bus import Bus, BusSpec
from drives.busload import cycle_bits_worst, frame_bits, frame_bits_worst
from drives.clock import SyncClock
from drives.discovery import matching_profiles, probe, scan
from drives.emcy import EmcyLog, parse_emergency
from drives.errors import BusOverload, ConfigurationRefused, DriveError, SdoAbort, SeveralFailures
from drives.group import DriveGroup
from drives.heartbeat import HeartbeatProducer, HeartbeatWatch, NmtState
from drives.ledger import LedgerEntry, WriteLedger
from drives.objects import OBJECTS, object_name
from drives.pdo import restore_steps, tpdo_plan, tpdo_plans
from drives.profile import ObjectReference
from drives.profile_file import list_profiles, load_profile
from drives.reactions import DRIVE_RULES
from drives.statistics import quantile
from drives.values import Identity
from tests.drives.conftest import configured

# -- bus load ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "least", "most"), [(0, 47, 55), (1, 55, 65), (2, 63, 75), (4, 79, 95), (6, 95, 115), (8, 111, 135)]
)
def test_bits_of_a_frame(size, least, most):
    """Table of a classic frame with an 11 bit identifier, interframe space included."""
    assert (frame_bits(size), frame_bits_worst(size)) == (least, most)


def test_597_cycles_of_six_drives_fit_one_megabit():
    """SYNC + 6 TPDO + 6 RPDO of eight bytes: 1675 bits in the worst case."""
    assert cycle_bits_worst([0, *[8] * 12]) == 1675 == 1_000_000 // 597


def test_a_rate_that_does_not_fit_is_refused_with_the_one_that_does(bus, add_slaves, setups):
    """SYNC + 12 TPDO + 6 RPDO = 6 x (135 + 115 + 115) + 55 bits; 70 % of 1 Mbit/s."""
    add_slaves(6)
    bits = 55 + 6 * (135 + 115 + 115)
    with DriveGroup(bus, setups(6), 0.002, "real") as group:
        group.connect()
        with pytest.raises(BusOverload, match=f"{bits / 20:.0f} %.*0.0033"):
            group.configure()
    with configured(bus, setups(6), 0.002, "lockstep") as group:
        assert group.statistics.bus_load_planned_percent == pytest.approx(bits / 20)


# -- PDO plans --------------------------------------------------------------------------------------------------------


def test_a_torque_of_32_bits_opens_the_second_frame():
    profile = load_profile("maxon-epos4")
    wide = profile.torque.model_copy(update={"object": ObjectReference(index=0x30D1, subindex=2, type="i32")})
    plans, roles = tpdo_plans(profile.model_copy(update={"torque": wide}), 4)
    assert [plan.cob_id for plan in (*plans, tpdo_plan(3, 5, []))] == [0x184, 0x284, 0x385]
    assert [plan.size_bytes for plan in plans] == [6, 8]
    assert roles == ("statusword", "position", "torque", "velocity")
    assert [entry.mapping for entry in plans[1].entries] == [0x30D10220, 0x606C0020]


def test_a_profile_without_current_needs_one_frame():
    plans, roles = tpdo_plans(load_profile("kinco-fd123"), 1)
    assert [entry.mapping for entry in plans[0].entries] == [0x60410010, 0x60640020, 0x60780010]
    assert len(plans) == 1
    assert roles == ("statusword", "position", "torque")


@pytest.mark.parametrize("name", list_profiles())
@pytest.mark.parametrize("torque", ["i16", "i32"])
@pytest.mark.parametrize("velocity", ["i16", "i32"])
def test_a_frame_holds_no_more_than_eight_bytes_and_nothing_that_fits_is_left_out(name, torque, velocity):
    profile = load_profile(name)
    changes = {"torque": profile.torque.model_copy(update={"object": ObjectReference(index=0x6077, type=torque)})}
    if profile.velocity is not None:
        wide = ObjectReference(index=0x606C, type=velocity)
        changes["velocity"] = profile.velocity.model_copy(update={"object": wide})
    plans, roles = tpdo_plans(profile.model_copy(update=changes), 3)
    sizes = [sum(entry.size_bits for entry in plan.entries) for plan in plans]
    assert max(sizes) <= 64
    assert len(roles) == sum(len(plan.entries) for plan in plans)
    for role in ("velocity", "current"):
        signal = getattr(profile.model_copy(update=changes), role)
        if len(plans) == 2 and signal is not None and role not in roles:
            assert sizes[1] + signal.object.size_bits > 64


def test_restore_switches_a_pdo_off_empties_and_fills_it_and_switches_it_on():
    old = {
        (0x1800, 1): ("u32", 0x40000181),
        (0x1800, 2): ("u8", 255),
        (0x1A00, 0): ("u8", 1),
        (0x1A00, 1): ("u32", 0x60410010),
        (0x1A00, 2): ("u32", 0),
        (0x6060, 0): ("i8", 0),
        (0x6007, 0): ("i16", 1),
    }
    steps = [(step.index, step.subindex, step.value) for step in restore_steps(old)]
    assert steps == [
        (0x6007, 0, 1),
        (0x6060, 0, 0),
        (0x1800, 1, 0xC0000181),
        (0x1A00, 0, 0),
        (0x1A00, 1, 0x60410010),
        (0x1A00, 0, 1),
        (0x1800, 2, 255),
        (0x1800, 1, 0x40000181),
    ]


@pytest.mark.parametrize(
    ("period_s", "own", "pair"),
    [
        (0.004, -3, (4, -3)),
        (0.01, -3, (10, -3)),
        (0.01, -2, (1, -2)),
        (0.02, -6, (20, -3)),
        (0.0025, -3, (25, -4)),
        (0.0025, -5, (250, -5)),
        (0.1, -3, (100, -3)),
        (0.5, -3, (50, -2)),
        (0.000125, -3, (125, -6)),
    ],
)
def test_period_of_0x60c2_in_the_exponent_of_the_drive_or_in_milliseconds(period_s, own, pair):
    assert decimal_periods(period_s, own)[0] == pair
    assert pair[0] * 10.0 ** pair[1] == pytest.approx(period_s)


@pytest.mark.parametrize("period_s", [0.0033333, 1 / 300, 1e-9])
def test_a_period_that_0x60c2_cannot_hold(period_s):
    with pytest.raises(ConfigurationRefused, match="60C2"):
        decimal_periods(period_s)


# -- emergencies ------------------------------------------------------------------------------------------------------


def test_an_emergency_in_words_of_the_profile(generic):
    message = parse_emergency(3, bytes.fromhex("1186210102030405"), 7, generic)
    assert (message.code, message.register, message.vendor) == (0x8611, 0x21, bytes.fromhex("0102030405"))
    assert str(message) == (
        "node 3: EMCY 0x8611, following error too large; check for a collision, the load and the speed limit"
    )


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0x0000, "no error"),
        (0x2310, "current"),
        (0x3210, "voltage"),
        (0x4210, "temperature"),
        (0x8130, "communication"),
    ],
)
def test_an_emergency_in_words_of_the_standard(code, text):
    assert text in parse_emergency(1, code.to_bytes(2, "little") + bytes(6), 0).text


@given(st.binary(max_size=64))
def test_any_emergency_frame_is_read(data):
    message = parse_emergency(1, data, 0)
    assert (message.code is None) == (len(data) < 2)
    assert len(message.vendor) <= 5


def test_a_storm_of_emergencies_is_counted_and_bounded(generic):
    log = EmcyLog({1: generic})
    for number in range(10_000):
        log.on_frame(0x81, number.to_bytes(2, "little") + bytes(6), 0.0)
    assert log.count == 10_000
    assert len(log.messages) <= 256
    assert log.messages[-1].code == 9999


# -- heartbeats -------------------------------------------------------------------------------------------------------


def test_a_heartbeat_watch_starts_with_the_first_heartbeat(bus, wire):
    watch = HeartbeatWatch(bus, [1, 2, 3], [0.5, 0.5, None])
    wire.now_s += 10.0
    assert watch.lost() == ()
    for node_id in (1, 3):
        wire.emit(0x700 + node_id, b"\x05")
    bus.drain()
    assert watch.states[1] is NmtState.OPERATIONAL
    wire.now_s += 0.4
    assert watch.lost() == ()
    wire.now_s += 0.2
    assert watch.lost() == (1,)
    wire.emit(0x701, b"\x7f")
    bus.drain()
    assert watch.lost() == ()
    assert watch.states[1] is NmtState.PREOPERATIONAL


@pytest.mark.parametrize("begin_s", [0.0, 100.0])
@pytest.mark.parametrize(
    ("clock_s", "syncs_s", "lost"), [(0.4, 0.4, ()), (9.0, 0.4, ()), (0.4, 9.0, ()), (0.6, 0.6, (1,)), (9.0, 0.6, (1,))]
)
def test_a_heartbeat_is_lost_when_it_is_missing_too_long_in_real_time_and_by_syncs(
    bus, wire, begin_s, clock_s, syncs_s, lost
):
    sync_time_s = [begin_s]
    watch = HeartbeatWatch(bus, [1], [0.5], lambda: sync_time_s[0])
    wire.emit(0x701, b"\x05")
    bus.drain()
    wire.now_s += clock_s
    sync_time_s[0] += syncs_s
    assert watch.lost() == lost


def test_a_boot_up_is_kept_until_it_is_forgiven(bus, wire):
    watch = HeartbeatWatch(bus, [1], [0.5])
    wire.emit(0x701, b"\x00")
    wire.emit(0x701, b"\x05")
    wire.emit(0x701, b"")
    bus.drain()
    assert watch.booted == {1}
    watch.forgive()
    assert watch.booted == set()
    assert bus.counts["wrong_length"] == 1


def test_the_masters_heartbeat_is_due_by_sync_time_or_by_the_clock(bus, wire):
    sync_time_s = [0.0]
    producer = HeartbeatProducer(bus, 0.4, lambda: sync_time_s[0])
    producer.tick()
    assert wire.sent == []
    producer.start()
    for sync_time_s[0], beats in ((0.05, 1), (0.1, 2)):
        producer.tick()
        assert wire.sent == [(0x77F, b"\x05")] * beats
    wire.now_s += 0.101
    producer.tick()
    assert len(wire.sent) == 3
    producer.stop()
    wire.now_s += 1.0
    sync_time_s[0] = 9.0
    producer.tick()
    assert len(wire.sent) == 3


# -- ledger -----------------------------------------------------------------------------------------------------------


def test_the_ledger_is_on_disk_before_the_write_and_keeps_the_first_old_value(tmp_path):
    path = tmp_path / "ledger.json"
    ledger = WriteLedger(path)
    ledger.note(LedgerEntry(1, 0x6007, 0, "i16", 1, 2, "first", 77))
    ledger.note(LedgerEntry(1, 0x6007, 0, "i16", 2, 3, "second", 77))
    (entry,) = WriteLedger(path).entries
    assert (entry.old, entry.new, entry.reason, entry.serial_number) == (1, 3, "second", 77)
    ledger.forget(entry)
    assert WriteLedger(path).entries == ()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": 2, "entries": []}', "[" * 9000])
def test_a_file_that_is_no_ledger_is_refused(tmp_path, text):
    path = tmp_path / "ledger.json"
    path.write_text(text)
    with pytest.raises(ConfigurationRefused, match="not a write ledger"):
        WriteLedger(path)


def test_a_damaged_or_edited_ledger_is_refused_by_name(tmp_path):
    path = tmp_path / "ledger.json"
    WriteLedger(path).note(LedgerEntry(1, 0x6007, 0, "i16", 1, 2, "first", 77))
    text = path.read_text()
    assert '"old": 1,' in text
    path.write_text(text.replace('"old": 1,', '"old": 3,'))
    with pytest.raises(ConfigurationRefused, match=r"ledger\.json is not a write ledger: .*damaged or edited"):
        WriteLedger(path)


def test_nothing_is_written_when_the_ledger_cannot_be(bus, add_slaves, setups, tmp_path):
    slaves = add_slaves(1)
    with DriveGroup(bus, setups(1), 0.004) as group:
        group.connect()
        (tmp_path / "file").touch()
        group.ledger.path = tmp_path / "file" / "ledger.json"
        with pytest.raises(ConfigurationRefused, match="cannot be written"):
            group.configure()
        assert slaves[0].written == []


# -- finding ----------------------------------------------------------------------------------------------------------


def test_a_probe_counts_the_answers_of_each_id(bus, make_slave):
    for node_id in (2, 5, 5):
        make_slave(node_id)
    assert probe(bus, [1, 2, 5]) == {1: 0, 2: 1, 5: 2}


def test_a_probe_waits_for_a_second_device_no_longer_than_it_may_take_and_listens_no_more(bus, make_slave, wire):
    for node_id in (2, 5):
        make_slave(node_id)
    begin_s = wire.now_s
    assert probe(bus, [2, 5], timeout_s=0.3) == {2: 1, 5: 1}
    assert 0.05 <= wire.now_s - begin_s < 0.1
    wire.emit(0x582, bytes.fromhex("4300100092010200"))
    bus.drain()
    assert bus.counts["unclaimed"] == 1
    begin_s = wire.now_s
    assert probe(bus, [2, 3], timeout_s=0.3) == {2: 1, 3: 0}
    assert wire.now_s - begin_s == pytest.approx(0.3, abs=0.02)


def test_a_scan_finds_everybody_and_changes_nothing(bus, make_slave, wire):
    first, second = make_slave(2), make_slave(90)
    second.values[0x1018, 1], second.values[0x1018, 3] = 0xFB, 0x01700000
    first.heartbeat()
    results = scan(bus, listen_s=0.2)
    assert [(result.identity.node_id, result.devices, result.state) for result in results] == [
        (2, 1, NmtState.PREOPERATIONAL),
        (90, 1, None),
    ]
    assert results[0].profiles == ("generic-cia402",)
    assert results[1].profiles == ("maxon-epos4", "generic-cia402")
    assert first.written == second.written == []
    assert {can_id & 0x780 for can_id, _ in wire.sent} == {0x600}


def test_a_scan_says_of_which_node_the_identity_could_not_be_read_and_why(bus, make_slave):
    """It answers the first question and does not respond from then on."""
    make_slave(2)
    unresponsive = make_slave(3)
    was_missing: list[bool] = []

    def reply(request, answer):
        if was_missing:
            return []
        was_missing.append(True)
        return [(0.001, answer)]

    unresponsive.reply = reply
    first, second = scan(bus, listen_s=0.2)
    assert first.unread == ""
    assert (second.identity.node_id, second.identity.vendor_id) == (3, None)
    assert "node 3" in second.unread
    assert "no SDO answer" in second.unread


def test_no_profile_fits_what_is_no_drive():
    sensor = Identity(1, 0x00080194, 0xFB, 1, 1, 1, "", "", "")
    assert matching_profiles(sensor) == ()


# -- clock ------------------------------------------------------------------------------------------------------------


def test_the_clock_keeps_the_rhythm_and_never_catches_up_in_a_burst(bus, wire):
    clock = SyncClock(bus, 0.01)
    start = clock.wait()
    times = [clock.wait() - start for _ in range(3)]
    assert times == pytest.approx([0.01, 0.02, 0.03], abs=1e-4)
    wire.now_s += 0.095
    waited_s = clock.wait() - start
    following = clock.wait() - start
    assert waited_s == pytest.approx(0.125, abs=1e-4)
    assert following == pytest.approx(0.13, abs=1e-4)  # where the drives' own clocks expect it
    assert clock.overruns == 8


def test_the_clock_goes_on_from_the_syncs_of_another_one(bus, wire):
    clock = SyncClock(bus, 0.01)
    clock.wait()
    wire.now_s += 0.5
    clock.follow(wire.now_s)
    clock.sent(wire.now_s)
    assert clock.wait() == pytest.approx(wire.now_s, abs=1e-4)
    assert (clock.overruns, clock.paused_s) == (0, pytest.approx(0.0, abs=1e-4))


def test_in_real_time_an_axis_that_does_not_respond_does_not_block_the_others(bus, add_slaves, setups, wire):
    slaves = add_slaves(3)
    with configured(bus, setups(3), 0.004, "real") as group:
        group.enable()
        slaves[1].tpdo_delay_s[slaves[1].sync_seen + 1] = 0.0038
        epochs = [group.hold() for _ in range(4)]
        assert [epoch.missing for epoch in epochs] == [(1,), (), (), ()]
        gaps = [after.time_s - before.time_s for before, after in zip(epochs, epochs[1:], strict=False)]
        assert gaps == pytest.approx([0.004] * 3, abs=2e-4)
        assert group.statistics.late == 2
        assert group.statistics.jitter_p99_s is not None


@given(st.lists(st.floats(0, 1), min_size=1, max_size=50), st.floats(0.01, 1.0))
def test_quantile_by_its_definition(values, share):
    found = quantile(values, share)
    assert found in values
    assert sum(value <= found for value in values) >= math.floor(share * len(values))
    assert sum(value < found for value in values) <= share * len(values)


# -- rules ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rule", DRIVE_RULES.values(), ids=DRIVE_RULES)
@pytest.mark.parametrize("period_s", [0.001, 0.004, 0.01, 0.03, 0.1])
def test_by_the_clock_a_rule_waits_for_its_time_and_no_longer_and_by_syncs_for_its_number(rule, period_s):
    """An operating system may pause who answers: not so many SYNCs, but so much time has to go by."""
    assert rule.syncs(period_s, "lockstep") == int(rule.limit)
    syncs = rule.syncs(period_s, "real")
    assert syncs * period_s >= rule.least_s - 1e-12
    assert syncs == int(rule.limit) or (syncs - 1) * period_s < rule.least_s


# -- errors -----------------------------------------------------------------------------------------------------------


def test_an_error_says_what_where_and_what_to_do():
    error = SdoAbort("refused", node=3, index=0x6077, subindex=0, code=1, advice="see the manual")
    assert str(error) == "node 3:6077:00 (torque): refused; see the manual"
    assert str(SeveralFailures([error, DriveError("alone")])).startswith("2 failures: (1) node 3:6077:00")


def test_objects_are_named_once():
    assert len({entry.address for entry in OBJECTS.values()}) == len(OBJECTS)
    assert object_name(0x1A01, 2) == "1A01:02 (TPDO2 mapping)"
    assert object_name(0x2345) == "2345:00"


def test_a_bus_may_be_made_of_any_adapter(wire):
    assert str(Bus(wire, BusSpec("test", "wire", options={"a": 1})).spec) == "test:wire,a=1"
