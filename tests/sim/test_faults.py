"""Faults on the wire, seen by a listener on the same bus; scenario files."""

from __future__ import annotations

import errno
import struct
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import can
import pytest

from sim.fault import REACTIONS, Fault
from sim.faults import KINDS, FaultError, fault_of, parse_faults, read_faults
from sim.wire_faults import FaultyWire

NODES = (1, 2, 3)
STATUS = 0x1237


class Rig:
    """Three devices behind a faulty wire that answer each SYNC with a counter, and a master that listens."""

    def __init__(self, master: can.BusABC, wire: FaultyWire) -> None:
        self.master, self.wire = master, wire

    def cycle(self, number: int) -> list[tuple[int, bytes]]:
        """One SYNC: what the master sees of it."""
        self.master.send(can.Message(arbitration_id=0x80, is_extended_id=False))
        if self.wire.recv(0.0) is not None:
            for node in NODES:
                data = struct.pack("<Hih", STATUS, 1000 * number + node, 10 * node)
                self.wire.send(can.Message(arbitration_id=0x180 + node, data=data, is_extended_id=False))
        return self.seen()

    def seen(self) -> list[tuple[int, bytes]]:
        """Data frames that have arrived at the master."""
        out = []
        while (frame := self.master.recv(0.0)) is not None:
            out.append((frame.arbitration_id, bytes(frame.data)))
        return out

    def answer(self, data: bytes) -> list[bytes]:
        """Device 2 answers an SDO request with these bytes."""
        self.wire.send(can.Message(arbitration_id=0x582, data=data, is_extended_id=False))
        return [data for can_id, data in self.seen() if can_id == 0x582]


@pytest.fixture
def rig() -> Iterator[Rig]:
    channel = f"faults-{uuid.uuid4().hex}"
    with (
        can.Bus(interface="virtual", channel=channel) as master,
        FaultyWire(can.Bus(interface="virtual", channel=channel), KINDS) as wire,
    ):
        yield Rig(master, wire)


def ids(frames: list[tuple[int, bytes]]) -> list[int]:
    return [can_id for can_id, _ in frames]


ALL = [0x181, 0x182, 0x183]


@pytest.mark.parametrize("kind", ["tpdo_lost", "tpdo_gone"])
def test_lost_answers_are_lost_for_as_long_as_stated(rig: Rig, kind: str) -> None:
    rig.wire.arm(fault_of(kind, node=2, at_sync=2, syncs=2))
    assert [ids(rig.cycle(number)) for number in range(1, 5)] == [ALL, [0x181, 0x183], [0x181, 0x183], ALL]


def test_delayed_answer_comes_before_the_next_one_of_the_same_drive(rig: Rig) -> None:
    rig.wire.arm(fault_of("tpdo_late", node=1, at_sync=2))
    rig.cycle(1)
    assert ids(rig.cycle(2)) == [0x182, 0x183]
    frames = rig.cycle(3)
    assert ids(frames) == [0x181, *ALL]
    assert [struct.unpack("<Hih", data)[1] for can_id, data in frames if can_id == 0x181] == [2001, 3001]


def test_answers_twice_torn_short_and_empty(rig: Rig) -> None:
    rig.cycle(0)
    for kind, sizes in (("tpdo_duplicated", [8, 8]), ("tpdo_torn", [8, 8]), ("tpdo_short", [7]), ("tpdo_empty", [0])):
        rig.wire.clear()
        rig.wire.arm_in(fault_of(kind, node=3), 1)
        frames = [data for can_id, data in rig.cycle(1) if can_id == 0x183]
        assert [len(data) for data in frames] == sizes, kind
        assert (len(set(frames)) == 2) == (kind == "tpdo_torn")


def test_order_changes_and_nothing_is_lost(rig: Rig) -> None:
    rig.cycle(0)
    rig.wire.arm_in(fault_of("tpdo_reordered", syncs=0, seed=3), 1)
    seen = [ids(rig.cycle(number)) for number in range(1, 6)]
    assert all(sorted(frames) == ALL for frames in seen)
    assert any(frames != ALL for frames in seen)


def test_stuck_answers_repeat_the_first_one(rig: Rig) -> None:
    rig.wire.arm(fault_of("tpdo_stuck", node=1, at_sync=2, syncs=0))
    values = [dict(rig.cycle(number))[0x181] for number in range(1, 5)]
    assert values[1] == values[2] == values[3] != values[0]


@pytest.mark.parametrize(
    ("kind", "bit", "value"),
    [
        ("internal_limit", 11, 1),
        ("following_error", 13, 1),
        ("warning", 7, 1),
        ("not_remote", 9, 0),
        ("not_following", 12, 0),
    ],
)
def test_bits_of_the_statusword(rig: Rig, kind: str, bit: int, value: int) -> None:
    rig.wire.arm(fault_of(kind, node=2, at_sync=1))
    frames = dict(rig.cycle(1))
    assert struct.unpack_from("<H", frames[0x182])[0] >> bit & 1 == value
    assert struct.unpack_from("<H", frames[0x181])[0] == STATUS


def test_random_loss_has_its_share_and_repeats_with_its_seed(rig: Rig) -> None:
    def missing(seed: int) -> list[int]:
        rig.wire.clear()
        rig.wire.arm_in(fault_of("tpdo_random_loss", syncs=0, share=0.2, seed=seed), 1)
        return [3 - len(rig.cycle(number)) for number in range(200)]

    first = missing(5)
    assert 70 <= sum(first) <= 170
    assert missing(5) == first
    assert missing(6) != first


def test_sdo_answers(rig: Rig) -> None:
    good = bytes.fromhex("4376600010270000")
    segment = bytes.fromhex("0041424344454647")
    for kind, data, expected in (
        ("sdo_aborted", bytes.fromhex("4360600010270000"), [bytes.fromhex("8060600022000008")]),
        ("sdo_other_object", good, [bytes.fromhex("4377600010270000")]),
        ("sdo_wrong_toggle", segment, [bytes.fromhex("1041424344454647")]),
        ("sdo_wrong_toggle", good, [good]),
        ("sdo_short", good, [good[:4]]),
        ("sdo_lost", good, []),
        ("duplicate_node", good, [good, good[:-1] + b"\x01"]),
    ):
        rig.wire.clear()
        rig.wire.arm(fault_of(kind, node=2, syncs=0))
        assert rig.answer(data) == expected, kind
    rig.wire.clear()
    rig.wire.arm(fault_of("sdo_lost", node=2, syncs=0, index=0x6077))
    assert rig.answer(good) == [good]


def test_delayed_sdo_answer_is_sent_by_the_next_receive(rig: Rig) -> None:
    rig.wire.arm(fault_of("sdo_late", node=2, syncs=0, delay_s=0.02))
    sent_s = time.monotonic()
    assert rig.answer(bytes(8)) == []
    rig.wire.recv(0.05)
    assert ids(rig.seen()) == [0x582]
    assert time.monotonic() - sent_s >= 0.02


def test_a_burst_holds_answers_back_and_lets_them_come_at_once(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr("sim.wire_faults.time", SimpleNamespace(monotonic=lambda: now_s[0]))
    rig.wire.real = True
    rig.wire.arm(fault_of("burst", node=2, syncs=0, delay_s=0.2))
    seen = [frame for number in range(1, 4) for frame in rig.cycle(number)]
    assert ids(seen) == [0x181, 0x183] * 3
    for passed_s, held in ((0.19, True), (0.21, False)):
        now_s[0] = 100.0 + passed_s
        rig.wire.recv(0.0)
        assert (0x182 not in ids(burst := rig.seen())) == held
    assert [struct.unpack("<Hih", data)[1] for _, data in burst] == [1002, 2002, 3002]


def test_a_burst_in_lockstep_is_as_long_as_its_syncs_stand_for(rig: Rig) -> None:
    rig.wire.arm(fault_of("burst", node=2, at_sync=2, syncs=2))
    seen = [[data for can_id, data in rig.cycle(number) if can_id == 0x182] for number in range(1, 7)]
    counts = [[struct.unpack("<Hih", data)[1] for data in frames] for frames in seen]
    assert counts == [[1002], [], [], [4002], [2002, 3002, 5002], [6002]]


def test_a_delayed_answer_is_delayed_by_time_where_a_time_is_given(rig: Rig) -> None:
    rig.wire.arm(fault_of("tpdo_late", node=1, at_sync=1, delay_s=0.1))
    begin_s = time.monotonic()
    assert ids(rig.cycle(1)) == [0x182, 0x183]
    assert ids(rig.cycle(2)) == ALL
    while not (delayed := rig.seen()):
        rig.wire.recv(0.01)
        assert time.monotonic() - begin_s < 5.0
    assert ids(delayed) == [0x181]


def test_another_master_with_a_slow_sync_keeps_to_the_clock(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [time.monotonic()]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    rig.wire.arm(fault_of("second_master_slow"))
    came = []
    for _ in range(50):
        rig.wire.recv(0.0)
        came += [can_id for can_id, _ in rig.seen()]
        now[0] += 0.01
    assert came == [0x080] * 5


def test_commands_that_reach_no_drive(rig: Rig) -> None:
    rig.wire.arm(fault_of("rpdo_lost", node=2, at_sync=0, syncs=0))
    for node in NODES:
        rig.master.send(can.Message(arbitration_id=0x200 + node, data=bytes(8), is_extended_id=False))
    received = [rig.wire.recv(0.0) for _ in range(3)]
    assert [frame.arbitration_id for frame in received if frame is not None] == [0x201, 0x203]
    rig.wire.clear()
    rig.wire.arm_in(fault_of("sync_lost"), 1)
    assert rig.cycle(1) == []


@pytest.mark.parametrize("kind", [kind for kind, about in KINDS.items() if about.where == "wire"])
def test_every_kind_of_the_wire_is_carried_out(rig: Rig, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without waiting: a delayed answer is sent by the next receive, so that it is delayed in real time too."""
    monkeypatch.setattr("sim.wire_faults.time.sleep", lambda _seconds: pytest.fail("the serving thread waits"))
    assert KINDS[kind].reaction in REACTIONS
    rig.wire.arm_in(fault_of(kind, node=2, **{"share": 1.0} if kind == "tpdo_random_loss" else {}), 1)
    rig.cycle(1)
    rig.answer(struct.pack("<BHBI", 0x43, 0x6060 if kind == "sdo_aborted" else 0x6076, 0, 8))
    rig.answer(bytes(8))
    rig.master.send(can.Message(arbitration_id=0x202, data=bytes(8), is_extended_id=False))
    rig.wire.send(can.Message(arbitration_id=0x702, data=b"\x05", is_extended_id=False))
    rig.wire.recv(0.0)
    assert rig.wire.touched[kind]


def test_a_full_queue_is_waited_for(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    refused = [
        can.CanOperationError("Failed to transmit", errno.ENOBUFS),
        can.CanOperationError("Transmit buffer full"),
    ]
    send = can.interfaces.virtual.VirtualBus.send

    def full_twice(bus: can.BusABC, message: can.Message, timeout: float | None = None) -> None:
        if refused:
            raise refused.pop()
        send(bus, message, timeout)  # type: ignore[arg-type]

    monkeypatch.setattr(can.interfaces.virtual.VirtualBus, "send", full_twice)
    assert rig.answer(bytes(8)) == [bytes(8)]
    refused.append(can.CanOperationError("Network is down", errno.ENETDOWN))
    with pytest.raises(can.CanOperationError, match="down"):
        rig.answer(bytes(8))


def test_faults_of_a_drive_are_handed_to_it() -> None:
    reported: list[Fault] = []
    with FaultyWire(can.Bus(interface="virtual", channel=uuid.uuid4().hex), KINDS) as wire:
        wire.act = reported.append
        wire.arm(fault_of("drive_fault", node=2, at_sync=3))
        wire.arm(fault_of("wrong_rated", node=1))
    assert [fault.kind for fault in reported] == ["wrong_rated"]


def test_scenario_file(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text('[[fault]]\nkind = "emcy"\nnode = 3\nat_sync = 200\ncode = 0x3210\n[[fault]]\nkind = "tpdo_lost"\n')
    assert read_faults(path) == (fault_of("emcy", node=3, at_sync=200, code=0x3210), fault_of("tpdo_lost"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('[[fault]]\nkind = "gremlin"', "unknown"),
        ('[[fault]]\nkind = "emcy"\nnod = 3', "unknown key 'nod'"),
        ('[[fault]]\nkind = "emcy"\nnode = 300', "node = 300"),
        ('[[fault]]\nkind = "emcy"\nnode = true', "node = True"),
        ('[[fault]]\nkind = "master_killed"', "fault of the master"),
        ('[[fault]]\nkind = "emcy"\nshare = 0.5', "unknown key 'share'"),
        ('[[fault]]\nkind = "tpdo_random_loss"\nshare = nan', "share = nan"),
        ("fault = 3", "may only contain"),
        ('[[faults]]\nkind = "emcy"', "may only contain"),
        ("[[fault", "not valid TOML"),
    ],
)
def test_scenarios_that_are_refused(text: str, says: str) -> None:
    with pytest.raises(FaultError, match=says):
        parse_faults(text, "scenario.toml")


def test_missing_scenario_file(tmp_path: Path) -> None:
    with pytest.raises(FaultError, match="cannot be read"):
        read_faults(tmp_path / "none.toml")
    with pytest.raises(FaultError):
        parse_faults("[[fault]]\nnode = 2\n")
    assert read_faults("3:emcy") == (fault_of("emcy", node=3),)
    assert read_faults("sync_lost") == (fault_of("sync_lost"),)
