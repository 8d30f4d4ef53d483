"""A bus that another master leads is left alone: nothing is sent, and the senders are reported."""

from __future__ import annotations

import pytest

from drives.discovery import FREE_S, refuse_foreign, scan
from drives.errors import ForeignMaster
from drives.group import DriveGroup
from tests.drives.conftest import configured

SYNC, START, UPLOAD, BEAT = (0x080, b""), (0x000, b"\x01\x00"), (0x603, bytes(8)), (0x77F, b"\x05")
SAID = [
    (SYNC, "1 SYNC"),
    (START, "1 NMT commands"),
    (UPLOAD, "SDO requests to node 3"),
    (BEAT, "the heartbeat of node 127"),
]


@pytest.mark.parametrize(("frame", "said"), SAID)
def test_a_scan_beside_a_master_sends_nothing_and_names_who_was_received(bus, make_slave, wire, frame, said):
    make_slave(3)
    wire.emit(*frame, delay_s=0.9 * FREE_S)
    with pytest.raises(ForeignMaster, match=f"has sent {said}; nothing was sent to the drives") as refused:
        scan(bus, listen_s=0.1)
    assert refused.value.exit_code == 4
    assert wire.sent == []


def test_all_received_frames_are_reported(bus, wire):
    for can_id, data in (SYNC, SYNC, UPLOAD, (0x605, bytes(8)), BEAT):
        wire.emit(can_id, data, delay_s=0.01)
    says = r"has sent 2 SYNC and SDO requests to nodes 3, 5 and the heartbeat of node 127"
    with pytest.raises(ForeignMaster, match=says) as refused:
        refuse_foreign(bus, 0.1)
    assert "is a drive" not in str(refused.value)


def test_a_drive_with_the_id_of_masters_is_reported_with_the_remedy(bus, wire):
    wire.emit(*BEAT, delay_s=0.01)
    with pytest.raises(ForeignMaster, match="if node 127 is a drive, give it another id"):
        refuse_foreign(bus, 0.1)


def test_what_drives_send_is_no_master(bus, make_slave, wire):
    slave = make_slave(5)
    slave.heartbeat()
    for can_id in (0x705, 0x085, 0x185, 0x585):
        wire.emit(can_id, bytes(1 if can_id == 0x705 else 8), delay_s=0.01)
    assert [result.identity.node_id for result in scan(bus, listen_s=0.1)] == [5]


def test_what_came_before_and_our_own_frames_are_no_other_master(bus, make_slave, wire):
    wire.echo = bus.echoes = True
    make_slave(5)
    wire.emit(*SYNC)
    assert scan(bus, listen_s=0.1)
    assert scan(bus, listen_s=0.1), "own requests came back"


@pytest.mark.parametrize("frame", [UPLOAD, BEAT])
def test_drives_are_not_taken_from_another_master(bus, add_slaves, setups, wire, frame):
    add_slaves(6)
    wire.emit(*frame, delay_s=0.01)
    with DriveGroup(bus, setups(6), 0.01) as group, pytest.raises(ForeignMaster):
        group.connect()
    assert wire.sent == []


@pytest.mark.parametrize("pacing", ["lockstep", "real"])
def test_a_master_with_a_sync_of_100_ms_is_detected_before_a_group_sends_anything(
    bus, add_slaves, setups, wire, pacing
):
    add_slaves(6)
    for number in range(20):
        wire.emit(*SYNC, delay_s=0.08 + 0.1 * number)
    with DriveGroup(bus, setups(6), 0.01, pacing) as group, pytest.raises(ForeignMaster, match="has sent [45] SYNC"):
        group.connect()
    assert wire.sent == []


@pytest.mark.parametrize("frame", [SYNC, START, UPLOAD])
def test_once_a_master_appears_nothing_more_is_written_or_commanded(bus, add_slaves, setups, wire, frame):
    slaves = add_slaves(6)
    with DriveGroup(bus, setups(6), 0.01) as group:
        group.connect()
        wire.emit(*frame)
        with pytest.raises(ForeignMaster, match=f"started to send.*{frame[0]:03X}; no further writes sent"):
            group.configure()
        sent = list(wire.sent)
    assert not any(slave.written for slave in slaves)
    assert not [frame for frame in wire.sent if frame[0] == 0], "no NMT command"
    assert wire.sent == sent, "nor while closing"


def test_a_master_that_appears_while_the_arm_waits_in_its_brakes_is_detected_before_it_is_enabled(
    bus, add_slaves, setups, wire
):
    slaves = add_slaves(2)
    with configured(bus, setups(2), 0.01) as group:
        group.enable()
        group.disable()
        wire.emit(*SYNC)
        with pytest.raises(ForeignMaster, match="started to send"):
            group.enable()
        assert not any(slave.state == "operation enabled" for slave in slaves)
