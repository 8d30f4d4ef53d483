"""A bus that only is listened to: constants, rows, setpoints and emergencies are received, and nothing is ever sent."""

from __future__ import annotations

import math
import struct

import pytest

from drives.listen_only import ListenOnlyBus
from drives.scaling import Constants

ENABLED = 0x1237
COUNTS, RATED_NM, RATED_A = 65536, 2.0, 5.0
#: What `generic-cia402` asks a drive for: (index, subindex) -> value.
CONSTANTS = {(0x608F, 1): COUNTS, (0x608F, 2): 1, (0x6076, 0): 2000, (0x6075, 0): 5000}


def say(wire, node: int, index: int, subindex: int, value: int) -> None:
    """Expedited answer of four bytes: CiA 301, 7.2.4.3.6."""
    wire.emit(0x580 + node, bytes([0x43, index & 0xFF, index >> 8, subindex]) + struct.pack("<I", value))


def say_constants(wire, node: int) -> None:
    for (index, subindex), value in CONSTANTS.items():
        say(wire, node, index, subindex, value)


def answer(wire, node: int, counts: int, torque: int) -> None:
    wire.emit(0x180 + node, struct.pack("<Hih", ENABLED, counts, torque))
    wire.emit(0x280 + node, struct.pack("<ih", 0, 0))


def test_rows_are_those_of_the_drives_and_nothing_is_sent(bus, wire, setups):
    listener = ListenOnlyBus(bus, setups(2))
    assert listener.unknown == (1, 2)
    for node in (1, 2):
        say_constants(wire, node)
    for number in range(3):
        wire.emit(0x080, b"")
        answer(wire, 1, COUNTS * number, 100)
        if number != 1:
            answer(wire, 2, -COUNTS, -50)
        bus.listen(0.01)
    wire.emit(0x080, b"")
    bus.listen(0.01)
    assert listener.unknown == ()
    first, second, third = listener.epochs()
    assert [each.sync_index for each in (first, second, third)] == [1, 2, 3]
    assert second.missing == (1,)
    assert third.time_s - first.time_s == pytest.approx(0.02, abs=1e-3)
    assert first.readings[1].position_rad == pytest.approx(-2.0 * math.pi)  # type: ignore[union-attr]
    assert first.readings[1].torque_nm == pytest.approx(-0.050 * RATED_NM)  # type: ignore[union-attr]
    assert third.readings[0].position_rad == pytest.approx(4.0 * math.pi)  # type: ignore[union-attr]
    assert third.readings[0].statusword == ENABLED  # type: ignore[union-attr]
    assert listener.epochs() == []
    assert wire.sent == []


def test_without_constants_nothing_is_read_and_nothing_assumed(bus, wire, setups):
    listener = ListenOnlyBus(bus, setups(1))
    for index, subindex in list(CONSTANTS)[:-1]:
        say(wire, 1, index, subindex, CONSTANTS[index, subindex])
    wire.emit(0x080, b"")
    answer(wire, 1, 5, 5)
    wire.emit(0x201, struct.pack("<Hi", 0x0F, 7))
    wire.emit(0x080, b"")
    bus.listen(0.01)
    assert listener.unknown == (1,)
    assert [each.readings for each in listener.epochs()] == [(None,)]
    assert listener.targets_rad() == [None]


def test_constants_may_come_from_elsewhere(bus, wire, setups):
    listener = ListenOnlyBus(bus, setups(1), [Constants(RATED_NM, RATED_A, None, COUNTS)])
    assert listener.unknown == ()
    wire.emit(0x201, struct.pack("<Hi", 0x0F, COUNTS // 4))
    bus.listen(0.01)
    assert listener.targets_rad() == [pytest.approx(math.pi / 2)]


def test_frames_of_another_mapping_are_not_read(bus, wire, setups):
    listener = ListenOnlyBus(bus, setups(1), [Constants(RATED_NM, RATED_A, None, COUNTS)])
    wire.emit(0x080, b"")
    wire.emit(0x181, struct.pack("<Hi", ENABLED, 5))
    wire.emit(0x080, b"")
    bus.listen(0.01)
    assert listener.epochs()[0].readings == (None,)


def test_emergencies_are_reported_in_words(bus, wire, setups):
    listener = ListenOnlyBus(bus, setups(2))
    wire.emit(0x082, struct.pack("<HB5s", 0x8130, 0x11, b""))
    bus.listen(0.01)
    (emergency,) = listener.emergencies
    assert emergency.node_id == 2
    assert emergency.code == 0x8130
