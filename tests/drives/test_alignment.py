"""In real time: whatever stays away, and whenever it comes, no row carries what was true at another SYNC."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drives.bus import Bus, BusSpec
from drives.drive import DriveCommand
from drives.epoch import Alignment, Epoch
from drives.errors import DriveFault, IncompleteEpochs
from drives.group import DriveGroup
from drives.values import AxisSetup
from tests.drives.conftest import Slave, Wire

PERIOD_S = 0.01
USUAL_S = 0.0004


class Rig:
    """Three axes in real time; each moves on by one count a SYNC, and each reading is compared with the truth."""

    def __init__(self, wire: Wire, setups: Callable[[int], list[AxisSetup]], stamped: bool) -> None:
        self.wire = wire
        wire.slaves[:] = [Slave(wire, node_id) for node_id in (1, 2, 3)]
        self.slaves = wire.slaves
        self.bus = Bus(wire, BusSpec("test", "wire"))
        self.bus.stamped = stamped
        self.group = DriveGroup(self.bus, setups(3), PERIOD_S, "real")
        self.group.connect()
        self.group.configure()
        self.group.enable()
        self.wrong = 0
        for _ in range(10):
            assert self.step().complete

    def step(self) -> Epoch:
        """One SYNC."""
        true = [slave.position for slave in self.slaves]
        commands = [DriveCommand((drive.target_count + 1) * drive.scale.count_rad) for drive in self.group.drives]
        epoch = self.group.exchange(commands)
        for reading, position in zip(epoch.readings, true, strict=True):
            self.wrong += reading is not None and reading.position_count != position
        return epoch

    def stall(self, slave: Slave, begin_s: float, length_s: float) -> None:
        """Answers to the SYNCs of this time, which begins so long after the next SYNC, come at its end in a burst."""
        number = slave.sync_seen
        for later in range(1, 8):
            sync_s = (later - 1) * PERIOD_S
            if begin_s <= sync_s + USUAL_S and sync_s < begin_s + length_s:
                slave.tpdo_delay_s[number + later] = begin_s + length_s - sync_s + 1e-5 * later

    def close(self) -> None:
        self.group.close()
        self.bus.close()


@pytest.fixture
def rig_of(wire: Wire, setups: Callable[[int], list[AxisSetup]]) -> Iterator[Callable[[bool], Rig]]:
    rigs: list[Rig] = []

    def make(stamped: bool) -> Rig:
        rigs.append(Rig(wire, setups, stamped))
        return rigs[-1]

    yield make
    for rig in rigs:
        rig.close()


@pytest.mark.slow
@pytest.mark.parametrize("stamped", [True, False])
# each example is 20 cycles of a group, half a second and more
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(begin_s=st.floats(-0.01, 0.01), length_s=st.floats(0.001, 0.045), axis=st.integers(0, 2))
def test_a_burst_after_a_stall_of_a_drive_never_enters_a_row_of_another_sync(
    wire: Wire,
    setups: Callable[[int], list[AxisSetup]],
    stamped: bool,
    begin_s: float,
    length_s: float,
    axis: int,
) -> None:
    rig = Rig(wire, setups, stamped)
    rig.stall(rig.slaves[axis], begin_s, length_s)
    epochs = [rig.step() for _ in range(20)]
    assert rig.wrong == 0
    assert {missing for epoch in epochs for missing in epoch.missing} <= {axis}
    assert all(epoch.complete for epoch in epochs[-8:])
    rig.close()


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("begin_s", [0.0005 * step for step in range(-4, 20)])
def test_25_ms_of_stall_at_every_alignment(rig_of: Callable[[bool], Rig], stamped: bool, begin_s: float) -> None:
    rig = rig_of(stamped)
    rig.stall(rig.slaves[1], begin_s, 0.025)
    epochs = [rig.step() for _ in range(12)]
    assert rig.wrong == 0
    assert 1 <= sum(not epoch.complete for epoch in epochs) <= 6


@pytest.mark.parametrize("stamped", [True, False])
def test_a_lost_frame_costs_at_most_four_rows(rig_of: Callable[[bool], Rig], stamped: bool) -> None:
    rig = rig_of(stamped)
    rig.slaves[1].tpdo_delay_s[rig.slaves[1].sync_seen + 1] = None
    epochs = [rig.step() for _ in range(12)]
    assert [epoch.missing for epoch in epochs[:4]] == [(1,)] * 4
    assert all(epoch.complete for epoch in epochs[4:])
    assert rig.wrong == 0
    assert rig.group.enabled


def test_a_time_stamp_gives_the_age_of_the_first_delayed_frame(rig_of: Callable[[bool], Rig]) -> None:
    """Sent just before the next SYNC and read after it: only its time stamp shows the delay."""
    rig = rig_of(True)
    rig.step()
    stale = rig.wire.now_s + rig.wire.wall_ahead_s
    plain = rig.wire.send

    def send(message: object, timeout: float | None = None) -> None:
        plain(message, timeout)  # type: ignore[arg-type]
        if message.arbitration_id == 0x080:  # type: ignore[attr-defined]
            wire, wire.wall_ahead_s = rig.wire, stale - rig.wire.now_s
            wire.emit(0x182, bytes.fromhex("3702 00000000 0000"), 0.0)
            wire.wall_ahead_s = 7.0e8

    wire = rig.wire
    wire.send = send  # type: ignore[method-assign]
    delayed = rig.group.statistics.late
    assert rig.step().complete
    wire.send = plain  # type: ignore[method-assign]
    assert (rig.wrong, rig.group.statistics.late) == (0, delayed + 1)


@pytest.mark.parametrize("jump_s", [-3600.0, 3600.0, 11.0])
def test_a_wall_clock_that_is_set_proves_nothing(rig_of: Callable[[bool], Rig], jump_s: float) -> None:
    rig = rig_of(True)
    real = rig.wire.send

    def send(message: object, timeout: float | None = None) -> None:
        if message.arbitration_id == 0x080:  # type: ignore[attr-defined]
            rig.wire.wall_ahead_s += jump_s
            rig.wire.send = real  # type: ignore[method-assign]
        real(message, timeout)  # type: ignore[arg-type]

    rig.wire.send = send  # type: ignore[method-assign]
    assert [rig.step().complete for _ in range(6)] == [True] * 6
    assert rig.wrong == 0


def test_an_axis_whose_answers_cannot_be_assigned_is_seen_to_leave_its_state(rig_of: Callable[[bool], Rig]) -> None:
    rig = rig_of(False)
    rig.slaves[1].tpdo_delay_s[rig.slaves[1].sync_seen + 1] = None
    rig.step()
    rig.slaves[1].state = "fault"
    with pytest.raises(DriveFault, match="node 2.*left OPERATION ENABLED: FAULT"):
        rig.step()


def test_answers_that_can_never_be_assigned_are_no_answers_in_the_end(rig_of: Callable[[bool], Rig]) -> None:
    """A drive that is a whole SYNC behind, and far too slow: not for ever without a position to watch."""
    rig = rig_of(False)
    slave = rig.slaves[1]
    slave.tpdo_delay_s.update({slave.sync_seen + number: 0.0165 for number in range(1, 60)})

    def go_on() -> None:
        for _ in range(50):
            rig.step()

    with pytest.raises(IncompleteEpochs, match=r"node 2.*unanswered in time: \d+ answers were delayed") as stopped:
        go_on()
    assert "cabling" not in str(stopped.value)
    assert rig.wrong == 0


def test_what_is_owed_and_has_come_is_owed_no_more() -> None:
    """Hand-made: SYNC 1 unanswered, SYNC 2 brings nothing either, SYNC 3 brings three frames."""
    alignment = Alignment()
    alignment.learn(0.001)
    for frames, came in (([None], 0), ([None], 0), ([b"x"], 3)):
        for _ in range(came):
            alignment.came(0, 0.001)
        alignment.end(frames)
        assert (0 in alignment.unassigned) == (came == 0)
