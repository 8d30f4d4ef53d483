"""Drives that act after a delay or otherwise than they state, judged on the wire against a good drive beside them."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import pytest

from sim.faults import FaultError
from sim.serve import RunningSimulation, running
from tests.sim.conftest import SMALL, Master, drive_of

NODE, GOOD = 2, 3


def code_of(master: Master, action: Callable[[], object]) -> int | None:
    """Abort code, None if the access is served."""
    try:
        action()
    except master.Aborted as abort:
        return abort.code
    return None


def syncs(master: Master, count: int) -> None:
    for _ in range(count):
        master.send(0x080, b"")
        master.number(GOOD, 0x1001)  # the drives have processed the SYNC once one of them answers


def enable(master: Master, simulation: RunningSimulation, node: int) -> None:
    """Bring one drive to OPERATION ENABLED in CSP at its present position; the SYNCs act in lockstep."""
    master.configure(node, 8)
    position = master.number(node, 0x6064, signed=True)
    for word in (0x06, 0x07, 0x0F):
        master.send(0x200 + node, struct.pack("<Hih", word, position, 0))
        syncs(master, 3)
    for _ in range(40):
        master.send(0x200 + node, struct.pack("<Hih", 0x0F, position, 0))
        syncs(master, 1)
    assert drive_of(simulation, node).axis.fed


def test_the_loss_of_the_master_is_ignored(start):
    with start("heartbeat_ignored") as (_, simulation):
        received: dict[int, int] = {}
        for node in (NODE, GOOD):
            drive = drive_of(simulation, node)
            drive.store.values[0x1016, 1] = 127 << 16 | 200
            drive.node.note_heartbeat(127, 0.0)
            drive.node.watch(1.0)
            received[node] = drive.node.error_register
    assert received == {NODE: 0, GOOD: 0x11}


def test_a_delayed_tpdo_follows_its_sync_by_eight_milliseconds(start, tmp_path):
    archive = tmp_path / "timing.npz"
    with start("delayed_tpdo", timing=archive, pacing="real") as (master, _):
        for node in (NODE, GOOD):
            master.configure(node, 8)
        for _ in range(5):
            master.send(0x080, b"")
            master.wait(0x180 + NODE)
    record = np.load(archive)
    sync_s = record["frame_s"][record["frame_id"] == 0x080]
    delays = record["frame_s"][record["frame_id"] == 0x180 + NODE] - sync_s
    assert len(delays) == 5
    assert delays.min() > 0.007


def test_a_torque_word_is_three_syncs_old(start):
    with start("old_torque") as (_, simulation):
        drive = drive_of(simulation, NODE)
        word, shown, true = drive.torque_word(drive.units.torque), [], []
        for reading in (1000.0, 2000.0, 3000.0, 4000.0, 5000.0):
            drive.reading_nm = reading
            true.append(word())
            drive.sync()
            shown.append(drive.store.entries[0x6077, 0].get())
    assert shown == [0, 0, 0, *true[:2]]


@pytest.mark.parametrize(
    ("name", "index", "sub", "value", "acts"),
    [
        ("quick_stop_coasts", 0x605A, 0, 2, 0),
        ("fault_coasts", 0x605E, 0, 2, 0),
        ("ignores_interpolation", 0x60C2, 1, 10, 1),
    ],
)
def test_an_object_shows_what_was_written_and_does_not_act(start, name, index, sub, value, acts):
    with start(name) as (master, simulation):
        size = 1 if index == 0x60C2 else 2
        for node in (NODE, GOOD):
            master.write(node, index, sub, value, size)
            assert master.number(node, index, sub) == value
        held = [drive_of(simulation, node).store.number((index, sub)) for node in (NODE, GOOD)]
        assert held == [acts, value]
        if index == 0x605E:
            assert code_of(master, lambda: master.write(NODE, index, sub, 9, size)) is not None


def test_the_joint_drops_until_a_slow_brake_has_closed(start):
    with start("slow_brake") as (master, simulation):
        dropped = {}
        for node in (NODE, GOOD):
            enable(master, simulation, node)
            held = drive_of(simulation, node).axis.position_rad
            master.write(node, 0x6040, 0, 0, 2)
            syncs(master, 15)
            dropped[node] = abs(drive_of(simulation, node).axis.position_rad - held)
            assert not drive_of(simulation, node).axis.free
    assert dropped[NODE] > 0.002
    assert dropped[GOOD] < 0.0005


@pytest.mark.parametrize(
    ("text", "says"),
    [("2:unknown", "unknown kind"), ("99:delayed_tpdo", "no drive has node 99"), ("no_such_thing", "NODE:]NAME")],
)
def test_an_unknown_fault_or_node_is_refused(channel, text, says):
    with pytest.raises(FaultError, match=says), running(SMALL, f"virtual:{channel}", fault=(text,)):
        pass
