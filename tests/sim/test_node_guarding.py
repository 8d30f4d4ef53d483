"""Node guarding of a simulated drive on the wire, judged against CiA 301, 7.2.8.3.2.1."""

from __future__ import annotations

import struct

import can
import pytest

NODE = 3


def guard(master):
    master.bus.send(can.Message(arbitration_id=0x700 + NODE, is_remote_frame=True, is_extended_id=False, dlc=1))


def answers(master):
    return [bytes(frame.data) for frame in master.drain() if frame.arbitration_id == 0x700 + NODE]


def test_a_remote_frame_is_answered_with_toggle_bit_and_state(drives):
    master, _ = drives
    guard(master)
    assert b"\x7f" not in answers(master)[1:], "a node with a heartbeat is not guarded"
    master.write(NODE, 0x1017, 0, 0, 2)
    master.drain()
    for _ in range(3):
        guard(master)
    assert answers(master) == [b"\x7f", b"\xff", b"\x7f"]
    master.send(0x000, bytes([1, NODE]))
    guard(master)
    assert answers(master) == [b"\x85"]


@pytest.mark.parametrize(("factor", "state"), [(3, 0x40), (0, 0x27)])
def test_guarding_that_stops_ends_as_0x6007_says(drives, factor, state):
    master, _ = drives
    for index, value, size in ((0x1017, 0, 2), (0x100C, 40, 2), (0x100D, factor, 1), (0x6007, 2, 2)):
        master.write(NODE, index, 0, value, size)
    master.configure(NODE, 8)
    position = master.enable(NODE)
    for _ in range(4):
        guard(master)
        for _ in range(8):
            status, _, _ = master.cycle(NODE, 0x0F, position)
        assert status & 0x6F == 0x27
    master.drain()
    for _ in range(20):
        status, _, _ = master.cycle(NODE, 0x0F, position)
    codes = [struct.unpack_from("<H", frame.data)[0] for frame in master.drain() if frame.arbitration_id == 0x80 + NODE]
    assert status & 0x6F == state
    assert codes == ([0x8130] if factor else [])
    guard(master)
    codes = [struct.unpack_from("<H", frame.data)[0] for frame in master.drain() if frame.arbitration_id == 0x80 + NODE]
    assert codes == ([0] if factor else [])
