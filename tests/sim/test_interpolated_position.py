"""Mode 7 of a simulated drive on the wire, judged against CiA 402-2."""

from __future__ import annotations

import struct

import pytest

NODE = 3
ACTIVE = 1 << 12
#: Movement in a SYNC period [counts].
STEP = 4000
#: Controlword, record of 0x60C1.
RPDO1 = (0x60400010, 0x60C10120)


def cycle(master, word, record):
    """One SYNC: statusword, position."""
    master.send(0x200 + NODE, struct.pack("<Hi", word, record))
    master.send(0x080, b"")
    return struct.unpack("<Hih", master.wait(0x180 + NODE))[:2]


@pytest.fixture
def enabled(drives):
    """A drive that is enabled in mode 7 without bit 4, and its position."""
    master, simulation = drives
    master.configure(NODE, 7)
    master.map(NODE, 0, RPDO1, 1, receive=True)
    position = master.number(NODE, 0x6064, signed=True)
    for word in (0x06, 0x07, *[0x0F] * 30):
        status, _ = cycle(master, word, position)
    assert status & 0x6F == 0x27
    assert not status & ACTIVE
    return master, simulation, position


def test_records_move_the_axis_only_after_bit_4_has_risen(enabled):
    master, _, begin = enabled
    for number in range(20):
        _, at = cycle(master, 0x0F, begin + STEP * number)
    assert abs(at - begin) < STEP
    for number in range(60):
        status, at = cycle(master, 0x1F, begin + STEP * number)
    assert status & ACTIVE
    assert begin + 50 * STEP < at < begin + 60 * STEP
    assert master.number(NODE, 0x60C1, 1, signed=True) == begin + STEP * 59
    assert master.number(NODE, 0x607A, signed=True) != begin + STEP * 59


def test_bit_4_that_enables_the_operation_does_not_start_the_interpolation(enabled):
    master, _, begin = enabled
    cycle(master, 0x07, begin)
    for _ in range(30):
        status, _ = cycle(master, 0x1F, begin)
    assert status & 0x6F == 0x27
    assert not status & ACTIVE
    cycle(master, 0x0F, begin)
    assert cycle(master, 0x1F, begin)[0] & ACTIVE


def test_a_dropped_bit_4_stops_by_the_ramp(enabled):
    master, _, begin = enabled
    for number in range(40):
        _, at = cycle(master, 0x1F, begin + STEP * number)
    for _ in range(100):
        status, rest = cycle(master, 0x0F, begin)
    assert status & 0x6F == 0x27
    assert not status & ACTIVE
    assert rest > at + STEP
    assert abs(cycle(master, 0x0F, begin)[1] - rest) < 200


def test_each_sync_takes_one_record_out_of_the_buffer(enabled):
    master, simulation, begin = enabled
    motion = simulation.simulation.servers[0].drive(NODE).motion
    cycle(master, 0x1F, begin)
    motion.record_depth = 3
    for step in (9000, 300, 600, 900):  # the first one finds no place
        master.write(NODE, 0x60C1, 1, begin + step, 4)
    demands = []
    for _ in range(5):
        master.send(0x080, b"")
        master.wait(0x180 + NODE)
        demands.append(master.number(NODE, 0x6062, signed=True) - begin)
    assert demands == pytest.approx([300, 600, 900, 900, 900], abs=2)


def test_the_interpolation_period_is_locked_while_mode_7_is_active(enabled):
    master, _, begin = enabled
    master.write(NODE, 0x60C2, 1, 10, 1)
    cycle(master, 0x1F, begin)
    for sub in (1, 2):
        with pytest.raises(master.Aborted) as caught:
            master.write(NODE, 0x60C2, sub, 20 if sub == 1 else 0xFD, 1)
        assert caught.value.code == 0x08000022
    cycle(master, 0x0F, begin)
    master.write(NODE, 0x60C2, 1, 10, 1)
