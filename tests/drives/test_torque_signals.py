"""A third TPDO for a check: torque, demand and current of the very same SYNC, and nothing left of it afterwards."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from drives.group import DriveGroup
from drives.torque_signals import TorqueSignalReader, TorqueSignals
from drives.values import AxisSetup
from tests.drives.conftest import Slave, configured

OFF = 1 << 31


@pytest.fixture
def slaves(add_slaves: Callable[[int], list[Slave]]) -> list[Slave]:
    """Two drives with a third TPDO, which is off, and a torque demand."""
    found = add_slaves(2)
    for slave in found:
        slave.add_pdo(0x1802, 0x1A02, OFF | 0x380 + slave.node_id, [])
        slave.types[0x6074, 0], slave.values[0x6074, 0] = "i16", -7 * slave.node_id
    return found


@pytest.fixture
def group(bus: object, slaves: list[Slave], setups: Callable[[int], list[AxisSetup]]) -> Iterator[DriveGroup]:
    with configured(bus, setups(2), 0.004) as group:
        yield group


def test_each_sync_gives_the_three_words_of_each_drive(group, slaves):
    with TorqueSignalReader(group.bus, group.drives) as reader:
        group.enable()
        group.bus.listen(0.001)
        before = [len(signals.torque) for signals in reader.signals]
        for number in range(5):
            slaves[1].torque = 100 + number
            group.hold()
        group.disable()
    first, second = reader.signals
    assert second.torque[before[1] : before[1] + 5] == [100, 101, 102, 103, 104]
    assert second.current[before[1] : before[1] + 5] == [200, 202, 204, 206, 208]
    assert set(first.torque) == {10}
    assert (set(first.demand), set(second.demand)) == ({-7}, {-14})
    assert len(first.torque) == len(first.demand) == len(first.current) > 5
    assert (first.missing, second.missing) == ("", "")


def test_afterwards_it_is_off_and_not_received(group, slaves):
    with TorqueSignalReader(group.bus, group.drives) as reader:
        assert [slave.values[0x1802, 1] & OFF for slave in slaves] == [0, 0]
        assert [slave.values[0x1802, 2] for slave in slaves] == [1, 1]
    assert [slave.values[0x1802, 1] & OFF for slave in slaves] == [OFF, OFF]
    slaves[0].wire.emit(0x381, bytes(6))
    group.bus.drain()
    assert reader.signals[0].torque == []
    reader.close()


def test_a_drive_without_a_third_tpdo_says_so_and_the_other_is_received(group, slaves):
    for address in [address for address in slaves[0].values if address[0] in (0x1802, 0x1A02)]:
        del slaves[0].values[address]
    with TorqueSignalReader(group.bus, group.drives) as reader:
        group.enable()
        group.disable()
    assert "1802" in reader.signals[0].missing
    assert reader.signals[0] == TorqueSignals(1, missing=reader.signals[0].missing)
    assert len(reader.signals[1].torque) > 1


def test_an_object_that_a_drive_does_not_have_is_left_out(group, slaves):
    del slaves[0].values[0x6074, 0]
    with TorqueSignalReader(group.bus, group.drives) as reader:
        group.enable()
        group.disable()
    assert reader.signals[0].demand == []
    assert len(reader.signals[0].torque) == len(reader.signals[0].current) > 1
    assert set(reader.signals[0].current) == {20}


def test_a_drive_that_is_gone_at_the_end_is_counted(group, slaves):
    with TorqueSignalReader(group.bus, group.drives):
        slaves[1].alive = False
    assert group.bus.counts["witness_left_on"] == 1
    assert slaves[0].values[0x1802, 1] & OFF
    slaves[1].alive = True


def test_a_frame_of_another_length_is_no_word(group, slaves, wire):
    with TorqueSignalReader(group.bus, group.drives) as reader:
        for length in (5, 7, 6):
            wire.emit(0x382, bytes(length))
        group.bus.drain()
        assert reader.signals[1].torque == [0]
