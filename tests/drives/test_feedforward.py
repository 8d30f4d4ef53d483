"""Offsets beside the position: mapped only when asked for, put back afterwards, zero outside OPERATION ENABLED."""

from __future__ import annotations

import math
import struct

import pytest

from drives.drive import DriveCommand
from drives.errors import CommandRefused, DriveFault, ProfileError, SeveralFailures
from drives.group import DriveGroup, GroupOptions
from drives.pdo import OFFSETS
from drives.profile_file import load_profile, parse_profile
from drives.values import AxisSetup
from tests.drives.conftest import configured

PERIOD_S = 0.004
COUNT_RAD = 2 * math.pi / 65536
MAX_RAD_S = 300.0
VELOCITY_BIT_RAD_S = 0.01 * 2 * math.pi / 60  # 0.01 rpm


@pytest.fixture
def slaves(add_slaves):
    """Two drives with a second RPDO and the velocity offset."""
    slaves = add_slaves(2)
    for slave in slaves:
        slave.types[0x60B1, 0], slave.values[0x60B1, 0] = "i32", 0
        slave.add_pdo(0x1401, 0x1601, 1 << 31 | 0x300 + slave.node_id, [])
    return slaves


@pytest.fixture
def group(bus, slaves, generic):
    setups = [AxisSetup(node_id, generic, 0.5, MAX_RAD_S, offsets=tuple(OFFSETS)) for node_id in (1, 2)]
    with configured(bus, setups, PERIOD_S) as group:
        yield group


def commands(slaves, torque_nm=0.0, velocity_rad_s=0.0):
    return [DriveCommand(slave.position * COUNT_RAD, torque_nm, velocity_rad_s) for slave in slaves]


def last_offsets(wire, node_id):
    """Torque and velocity word that went out last to one node."""
    torque = [data for can_id, data in wire.sent if can_id == 0x200 + node_id][-1]
    velocity = [data for can_id, data in wire.sent if can_id == 0x300 + node_id][-1]
    return struct.unpack("<Hih", torque)[2], struct.unpack("<i", velocity)[0]


def test_without_feedforward_the_second_rpdo_is_left_alone(bus, slaves, setups, wire):
    with configured(bus, setups(2), PERIOD_S) as group:
        group.enable()
        for offsets, index in (({"torque_nm": 0.5}, "60B2"), ({"velocity_rad_s": 1.0}, "60B1")):
            with pytest.raises(CommandRefused, match=index):
                group.exchange(commands(slaves, **offsets))
            group.disable()
            group.enable()
    assert not [can_id for can_id, _ in wire.sent if 0x300 <= can_id < 0x380]
    touched = {index for slave in slaves for index, _, _ in slave.written}
    assert not touched & {0x1401, 0x1601, 0x60B1, 0x60B2}


def test_the_offsets_go_out_before_the_sync_in_the_units_of_the_standard(group, slaves, wire):
    group.enable()
    assert [(slave.values[0x1601, 1], slave.values[0x1600, 3]) for slave in slaves] == [(0x60B10020, 0x60B20010)] * 2
    assert [slave.values[0x1401, 1] for slave in slaves] == [0x301, 0x302]
    group.exchange(commands(slaves, 0.5, -3.0))
    # 1000 per mille = 2 Nm; 0.01 rpm per bit
    assert last_offsets(wire, 2) == (250, round(-3.0 / VELOCITY_BIT_RAD_S))
    ids = [can_id for can_id, _ in wire.sent]
    assert ids[-5:] == [0x201, 0x202, 0x301, 0x302, 0x080]
    group.hold()
    assert last_offsets(wire, 1) == (0, 0)


@pytest.mark.parametrize("leave", ["disable", "quick_stop", "close"])
def test_no_offset_is_left_outside_operation_enabled(group, slaves, wire, leave):
    group.enable()
    group.exchange(commands(slaves, 0.5, 3.0))
    assert last_offsets(wire, 1) != (0, 0)
    getattr(group, leave)()
    assert last_offsets(wire, 1) == last_offsets(wire, 2) == (0, 0)


def test_a_drive_that_leaves_operation_enabled_takes_every_offset_with_it(group, slaves, wire):
    group.enable()
    group.exchange(commands(slaves, 0.5, 3.0))
    slaves[0].state = slaves[0].stuck_in = "fault"
    with pytest.raises((DriveFault, SeveralFailures)):
        group.exchange(commands(slaves, 0.5, 3.0))
    assert last_offsets(wire, 2) == (0, 0)


def test_a_velocity_offset_beyond_the_speed_limit_is_refused(group, slaves):
    group.enable()
    with pytest.raises(CommandRefused, match="60B1"):
        group.exchange(commands(slaves, velocity_rad_s=1.01 * MAX_RAD_S))


def test_restore_takes_the_second_rpdo_back(group, slaves):
    group.restore()
    assert [slave.values[0x1401, 1] for slave in slaves] == [1 << 31 | 0x301, 1 << 31 | 0x302]
    assert [slave.values[0x1601, 0] for slave in slaves] == [0, 0]


def test_a_run_without_feedforward_clears_what_a_crashed_one_has_left(bus, slaves, generic, setups, tmp_path):
    options = GroupOptions(ledger_path=tmp_path / "ledger.json")
    fed = [AxisSetup(node_id, generic, 0.5, MAX_RAD_S, offsets=tuple(OFFSETS)) for node_id in (1, 2)]
    with configured(bus, fed, PERIOD_S, options=options):
        pass
    slaves[1].values[0x60B1, 0] = 7000
    slaves[0].values[0x60B2, 0] = 70
    with configured(bus, setups(2), PERIOD_S, options=options):
        pass
    assert (slaves[1].values[0x60B1, 0], slaves[0].values[0x60B2, 0]) == (0, 0)


def test_an_offset_that_another_tool_has_left_is_cleared(bus, slaves, setups):
    slaves[0].values[0x60B2, 0], slaves[1].values[0x60B1, 0] = 70, 7000
    with configured(bus, setups(2), PERIOD_S):
        pass
    assert (slaves[0].values[0x60B2, 0], slaves[1].values[0x60B1, 0]) == (0, 0)


def test_a_drive_without_the_object_is_refused_before_it_is_enabled(bus, add_slaves, generic):
    add_slaves(2)
    setups = [AxisSetup(node_id, generic, 0.5, MAX_RAD_S, offsets=tuple(OFFSETS)) for node_id in (1, 2)]
    with DriveGroup(bus, setups, PERIOD_S) as group:
        group.connect()
        with pytest.raises(SeveralFailures, match="60B1"):
            group.configure()


def test_a_profile_without_feedforward_is_refused():
    with pytest.raises(ProfileError, match=r"kollmorgen-akd-x00606 has no \[feedforward\]"):
        AxisSetup(1, load_profile("kollmorgen-akd-x00606"), 0.5, MAX_RAD_S, offsets=tuple(OFFSETS))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0x60B1, ", "", "0x60B1"),
        ("0x1401, ", "", "0x1401"),
        ("value = 0.8,", "value = 1.2,", "velocity_share"),
    ],
)
def test_a_profile_that_cannot_do_what_it_says_is_refused(generic, old, new, message):
    with pytest.raises(ProfileError, match=message):
        parse_profile(generic.text.replace(old, new), "here.toml")


def test_the_bus_load_counts_the_second_rpdo(group, bus, setups):
    with configured(bus, setups(2), PERIOD_S) as plain:
        difference = group.statistics.bus_load_planned_percent - plain.statistics.bus_load_planned_percent
    # two frames of 4 bytes, 95 bits each with worst stuffing, and two of 8 instead of 6 bytes, 20 bits more each
    assert difference == pytest.approx(100 * 2 * 115e-6 / PERIOD_S, rel=1e-6)
