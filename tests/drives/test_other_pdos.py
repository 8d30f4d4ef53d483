"""PDOs that the gateway does not use: off, or counted and named; none that a stranger can command a drive by."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drives.errors import BusOverload, ConfigurationRefused
from drives.group import DriveGroup, GroupOptions

PERIOD_S = 0.004
CONTROLWORD, STATUSWORD, POSITION, TARGET = 0x60400010, 0x60410010, 0x60640020, 0x607A0020


@pytest.fixture
def slaves(add_slaves):
    return add_slaves(1)


@pytest.fixture
def locked(generic):
    """The generic profile, which must not write the records of PDO 3 and 4."""
    kept = tuple(index for index in generic.write.allow if index not in (0x1402, 0x1403, 0x1802, 0x1803))
    return generic.model_copy(update={"write": generic.write.model_copy(update={"allow": kept})})


def configured(bus, setups, pacing="real", options=None):
    group = DriveGroup(bus, setups, PERIOD_S, pacing, options=options)
    group.connect()
    group.configure()
    return group


def with_profile(setups, profile):
    return [replace(setup, profile=profile) for setup in setups]


@pytest.mark.parametrize("transmission", [0, 1, 254, 255])
def test_pdos_that_are_not_used_are_switched_off_and_put_back(bus, slaves, setups, transmission):
    (slave,) = slaves
    found = {0x1402: 0x401, 0x1403: 0x501, 0x1802: 0x40000381, 0x1803: 0x481, 0x1401: 0x301}
    for index, cob_id in found.items():
        slave.add_pdo(index, index + 0x200, cob_id, [CONTROLWORD if index < 0x1800 else STATUSWORD])
        slave.values[index, 2] = transmission
    with configured(bus, setups(1)) as group:
        assert all(slave.values[index, 1] == cob_id | 1 << 31 for index, cob_id in found.items())
        assert tuple(map(str, group.left_pdos)) == ()
        group.restore()
    assert {index: slave.values[index, 1] for index in found} == found


@pytest.mark.parametrize("number", [5, 9, 16])
def test_no_receive_pdo_beyond_the_first_four_takes_a_foreign_controlword(bus, slaves, setups, number):
    (slave,) = slaves
    for other in range(0x1400 + 8, 0x1400 + number - 1, 8):
        slave.add_pdo(other, other + 0x200, 1 << 31, [])
    slave.add_pdo(0x1400 + number - 1, 0x1600 + number - 1, 0x330, [CONTROLWORD])
    with pytest.raises(ConfigurationRefused, match=f"RPDO{number} takes a controlword") as refused:
        configured(bus, setups(1))
    assert "write.allow" in str(refused.value)


def test_what_is_off_already_is_not_touched(bus, slaves, setups):
    (slave,) = slaves
    slave.add_pdo(0x1802, 0x1A02, 1 << 31 | 0x381, [STATUSWORD])
    configured(bus, setups(1)).close()
    assert not [write for write in slave.written if write[0] == 0x1802]


def test_what_stays_on_with_sync_is_counted_into_the_load(bus, slaves, setups, locked):
    (slave,) = slaves
    chosen = with_profile(setups(1), locked)
    with configured(bus, chosen) as group:
        before = group.statistics.bus_load_planned_percent
    slave.add_pdo(0x1802, 0x1A02, 0x381, [STATUSWORD, POSITION])
    slave.values[0x1802, 2] = 1
    with configured(bus, chosen) as group:
        more = group.statistics.bus_load_planned_percent - before
        assert tuple(map(str, group.left_pdos)) == ("node 1: TPDO3 (id 381, with SYNC)",)
    # 6 bytes: 47 + 48 bits, and 20 stuff bits at the worst, at 1 Mbit/s
    assert more == pytest.approx(100 * 115e-6 / PERIOD_S, rel=1e-6)
    limit = GroupOptions(load_limit_percent=before + 0.5 * more)
    with pytest.raises(BusOverload):
        configured(bus, chosen, options=limit)


@pytest.mark.parametrize(("limit_percent", "refused"), [(12.0, True), (14.0, False)])
def test_a_load_that_is_too_high_is_refused_before_anything_is_written(
    bus, slaves, setups, locked, limit_percent, refused
):
    """SYNC 55, TPDOs 135 and 115, RPDO 135 bits are 11 % of 4 ms; what stays on takes 115 bits more."""
    (slave,) = slaves
    slave.add_pdo(0x1802, 0x1A02, 0x381, [STATUSWORD, POSITION])
    slave.values[0x1802, 2] = 1
    options = GroupOptions(load_limit_percent=limit_percent)
    if refused:
        with pytest.raises(BusOverload):
            configured(bus, with_profile(setups(1), locked), options=options)
        assert slave.written == []
    else:
        configured(bus, with_profile(setups(1), locked), options=options).close()
        assert slave.written != []


def test_what_stays_on_by_event_is_named_and_not_counted(bus, slaves, setups, locked):
    (slave,) = slaves
    chosen = with_profile(setups(1), locked)
    with configured(bus, chosen) as group:
        before = group.statistics.bus_load_planned_percent
    slave.add_pdo(0x1803, 0x1A03, 0x481, [STATUSWORD])
    slave.add_pdo(0x1402, 0x1602, 0x401, [TARGET])
    with configured(bus, chosen) as group:
        assert tuple(map(str, group.left_pdos)) == (
            "node 1: RPDO3 (id 401, by event)",
            "node 1: TPDO4 (id 481, by event)",
        )
        assert group.statistics.bus_load_planned_percent == before


def test_a_controlword_for_a_stranger_is_refused(bus, slaves, setups, locked):
    slaves[0].add_pdo(0x1403, 0x1603, 0x501, [TARGET, CONTROLWORD])
    with pytest.raises(ConfigurationRefused, match="node 1:1403.*RPDO4 takes a controlword from the sender of id 501"):
        configured(bus, with_profile(setups(1), locked))


def read_only(slave, *addresses):
    """Parameter records that the drive lets no client change (0x06010002)."""
    slave.refuses_write = lambda address, data: 0x06010002 if address in addresses else 0


def test_a_pdo_that_the_drive_does_not_switch_off_is_named_and_counted_and_needs_no_restore(bus, slaves, setups):
    (slave,) = slaves
    with configured(bus, setups(1)) as group:
        before = group.statistics.bus_load_planned_percent
    slave.add_pdo(0x1802, 0x1A02, 0x381, [STATUSWORD])
    slave.values[0x1802, 2] = 1
    read_only(slave, (0x1802, 1))
    with configured(bus, setups(1)) as group:
        assert tuple(map(str, group.left_pdos)) == ("node 1: TPDO3 (id 381, with SYNC)",)
        assert group.statistics.bus_load_planned_percent > before
        group.restore()
        assert group.ledger.entries == ()


def test_a_controlword_for_a_stranger_that_the_drive_does_not_switch_off_is_refused(bus, slaves, setups):
    slaves[0].add_pdo(0x1402, 0x1602, 0x401, [CONTROLWORD])
    read_only(slaves[0], (0x1402, 1))
    with pytest.raises(ConfigurationRefused, match="RPDO3 takes a controlword"):
        configured(bus, setups(1))
