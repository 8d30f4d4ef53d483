"""One SYNC for the drives of two buses in real time: its five parts, what each bus sees, what is taken back."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator

import pytest

from drives.bus import Bus, BusSpec
from drives.drive import DriveCommand
from drives.errors import CommandRefused, DriveFault, MasterStalled
from drives.group import DriveGroup
from tests.drives.conftest import Beside, Slave, Wire

PERIOD_S = 0.01
COUNT_RAD = 2 * math.pi / 65536


@pytest.fixture
def wires(wire: Wire) -> list[Wire]:
    return [wire, Beside(wire)]


@pytest.fixture
def groups(wires, setups) -> Iterator[list[DriveGroup]]:
    opened = []
    for each in wires:
        each.slaves += [Slave(each, node_id) for node_id in range(1, 4)]
        group = DriveGroup(Bus(each, BusSpec("test", "wire")), setups(3), PERIOD_S, "real")  # type: ignore[arg-type]
        group.connect()
        group.configure()
        group.enable()
        opened.append(group)
    for group in opened:
        group.align(wires[0].now_s + PERIOD_S)
    yield opened
    for group in opened:
        group.close()


def commands(group: DriveGroup, step: int) -> list[DriveCommand]:
    return [DriveCommand((drive.target_count + step) * COUNT_RAD) for drive in group.drives]


def together(groups: list[DriveGroup], step: int = 50) -> list:
    for group in groups:
        group.begin(commands(group, step))
    at_s = groups[0].prepare()
    for group in groups[1:]:
        assert group.prepare(at_s) == at_s
    for group in groups:
        group.sync()
    epochs = [group.gather() for group in groups]
    for group, epoch in zip(groups, epochs, strict=True):
        group.check(epoch)
    return epochs


def syncs_s(wire: Wire) -> list[float]:
    return [at for (can_id, _), at in zip(wire.sent, wire.sent_at_s, strict=True) if can_id == 0x080]


def free(group: DriveGroup) -> bool:
    """Whether another thread may receive on its bus."""
    got = []

    def ask() -> None:
        got.append(group.bus.receive_lock.acquire(blocking=False))
        if got[0]:
            group.bus.receive_lock.release()

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    return got[0]


@pytest.mark.parametrize("held_s", [0.0, 0.006, 0.013, 0.0175])
def test_both_buses_get_their_sync_at_one_instant_and_answer_it_whatever_the_delay_of_one(groups, wires, held_s):
    before = [len(syncs_s(each)) for each in wires]
    for row in range(12):
        if row == 5:
            wires[0].now_s += held_s
        epochs = together(groups)
        assert all(epoch.complete for epoch in epochs) or (row == 5 and held_s > PERIOD_S)
    first, second = (syncs_s(each)[start:] for each, start in zip(wires, before, strict=True))
    assert len(first) == len(second) == 12
    assert max(abs(one - other) for one, other in zip(first, second, strict=True)) < 1e-4
    phases = [(at - first[0]) % PERIOD_S for at in first[7:]]
    assert max(min(each, PERIOD_S - each) for each in phases) < 2e-4  # the rhythm is the one from before
    assert [slave.position for slave in wires[0].slaves] == [drive.target_count for drive in groups[0].drives]


def test_an_axis_that_does_not_respond_on_one_bus_leaves_the_answers_of_the_other_bus_whole(groups, wires):
    unresponsive = wires[0].slaves[1]
    for sync in (unresponsive.sync_seen + 1, unresponsive.sync_seen + 2):
        unresponsive.tpdo_delay_s[sync] = None
    rows = [together(groups) for _ in range(3)]
    assert [first.missing for first, _ in rows[:2]] == [(1,), (1,)]
    assert [second.missing for _, second in rows] == [()] * 3


def test_what_one_arm_refuses_is_not_begun_by_the_other(groups, wires):
    together(groups)
    targets = [drive.target_count for drive in groups[0].drives]
    sent = [len(syncs_s(each)) for each in wires]
    groups[0].begin(commands(groups[0], 50))
    assert not free(groups[0])
    with pytest.raises(CommandRefused):
        groups[1].begin([DriveCommand(math.nan)] * 3)
    groups[0].abandon()
    assert [drive.target_count for drive in groups[0].drives] == targets
    assert [len(syncs_s(each)) for each in wires] == sent
    assert free(groups[0])
    assert free(groups[1])
    assert all(epoch.complete for epoch in together(groups))


def test_no_thread_leaves_a_cycle_that_another_thread_has_begun(groups):
    """One thread may be stopping an arm while another one clears up what was begun with it."""
    together(groups)
    targets, first = [drive.target_count for drive in groups[0].drives], groups[0]
    begun, go_on, brought = threading.Event(), threading.Event(), []

    def cycle() -> None:
        first.begin(commands(first, 50))
        begun.set()
        go_on.wait()
        first.prepare()
        first.sync()
        brought.append(first.gather())

    thread = threading.Thread(target=cycle, daemon=True)
    thread.start()
    begun.wait()
    first.abandon()
    assert not free(first)
    go_on.set()
    thread.join()
    assert brought[0].complete
    assert [drive.target_count for drive in first.drives] == [count + 50 for count in targets]
    assert free(first)


def test_a_stall_while_both_move_stops_before_the_sync_and_takes_the_targets_back(groups, wires):
    for _ in range(3):
        together(groups)
    targets = [[drive.target_count for drive in group.drives] for group in groups]
    for group in groups:
        group.begin(commands(group, 50))
    wires[0].now_s += 0.1
    with pytest.raises(MasterStalled):
        groups[0].prepare()
    groups[1].abandon()
    groups[1].quick_stop()
    assert [[drive.target_count for drive in group.drives] for group in groups] == targets
    assert {slave.state for each in wires for slave in each.slaves} == {"quick stop"}
    assert free(groups[0])
    assert free(groups[1])


def test_a_fault_is_reported_by_the_last_part_and_stops_the_axes_of_its_bus(groups, wires):
    together(groups)
    wires[1].slaves[2].state = "fault"
    for group in groups:
        group.begin(commands(group, 50))
    groups[1].prepare(groups[0].prepare())
    for group in groups:
        group.sync()
    first, second = (group.gather() for group in groups)
    groups[0].check(first)
    with pytest.raises(DriveFault, match="node 3"):
        groups[1].check(second)
    assert (groups[0].enabled, groups[1].enabled) == (True, False)
    assert [slave.state for slave in wires[1].slaves] == ["quick stop", "quick stop", "fault"]
