"""One row = one SYNC: a lost, delayed, doubled, torn or cut frame never becomes a reading of the wrong SYNC."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from can import Message
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drives.bus import Bus, BusSpec
from drives.drive import DriveCommand
from drives.epoch import EpochCollector
from tests.drives.conftest import configured


@pytest.fixture
def slaves(add_slaves):
    return add_slaves(3)


@pytest.fixture
def group(bus, slaves, setups):
    with configured(bus, setups(3), 0.004) as group:
        group.enable()
        yield group


def step(group, slaves):
    """One SYNC while every axis moves on by one count; each reading must be what was true at that SYNC."""
    from drives.drive import DriveCommand

    true = [slave.position for slave in slaves]
    commands = [DriveCommand((drive.target_count + 1) * drive.scale.count_rad) for drive in group.drives]
    epoch = group.exchange(commands)
    for reading, position in zip(epoch.readings, true, strict=True):
        assert reading is None or (reading.position_count, reading.sync_index) == (position, epoch.sync_index)
    return epoch


def test_a_lost_answer_leaves_a_gap_and_the_next_row_is_whole(group, slaves):
    slaves[1].tpdo_delay_s[slaves[1].sync_seen + 2] = None
    step(group, slaves)
    assert step(group, slaves).missing == (1,)
    assert step(group, slaves).complete
    assert group.statistics.incomplete == 1


def test_in_lockstep_a_stall_of_this_process_costs_no_answer(wire, group, slaves):
    """Longer than any time-out for an answer; simulated drives may have been stalled with it."""
    slaves[1].tpdo_delay_s[slaves[1].sync_seen + 1] = 0.03
    wire.held_up_s = 1.2
    assert step(group, slaves).complete
    assert group.statistics.incomplete == 0


@pytest.mark.parametrize("delay_s", [0.025, 0.03, 0.039])
def test_a_delayed_answer_never_enters_the_next_row(group, slaves, delay_s):
    slaves[2].tpdo_delay_s[slaves[2].sync_seen + 1] = delay_s
    assert step(group, slaves).missing == (2,)
    for _ in range(20):
        assert step(group, slaves).complete
    assert group.statistics.late == 2


def test_an_answer_that_comes_after_the_next_sync_contradicts_its_successor(group, slaves):
    """Later than every wait: two different frames of one TPDO answer one SYNC, and neither is accepted."""
    slaves[0].tpdo_delay_s[slaves[0].sync_seen + 1] = 0.0433
    slaves[0].tpdo_delay_s[slaves[0].sync_seen + 2] = 0.0006
    assert step(group, slaves).missing == (0,)
    for _ in range(5):
        step(group, slaves)
    assert group.statistics.ambiguous >= 1
    for _ in range(20):
        assert step(group, slaves).complete


def test_of_a_single_drive_too_an_answer_to_the_sync_before_is_not_accepted(bus, add_slaves, setups):
    """Nothing else comes with delay here: what stayed away itself is what is watched for."""
    slaves = add_slaves(1)
    with configured(bus, setups(1), 0.004) as group:
        group.enable()
        seen = slaves[0].sync_seen
        slaves[0].tpdo_delay_s |= {seen + 1: 0.0433, seen + 2: 0.0006}
        assert step(group, slaves).missing == (0,)
        for _ in range(5):
            step(group, slaves)
        assert group.statistics.ambiguous >= 1
        assert all(step(group, slaves).complete for _ in range(20))


def test_a_doubled_answer_is_counted_and_does_no_harm(group, slaves, wire):
    real = wire.emit

    def doubled(can_id, data, delay_s=0.0, **flags):
        real(can_id, data, delay_s, **flags)
        if can_id == 0x182:
            real(can_id, data, delay_s, **flags)

    wire.emit = doubled
    for _ in range(10):
        assert step(group, slaves).complete
    assert group.statistics.duplicate >= 9
    assert group.statistics.ambiguous == 0


def test_an_answer_of_the_wrong_length_is_none(group, slaves):
    slaves[1].tpdo_cut = 6
    assert step(group, slaves).missing == (1,)
    slaves[1].tpdo_cut = 8
    assert step(group, slaves).complete
    assert group.statistics.wrong_length == 1


def test_a_warning_is_counted_and_stops_nothing(group, slaves, wire):
    real = wire.emit

    def warned(can_id, data, *rest, **flags):
        real(can_id, bytes([data[0] | 0x80, *data[1:]]) if can_id == 0x182 else data, *rest, **flags)

    assert group.statistics.warnings == 0
    wire.emit = warned
    for _ in range(7):
        assert step(group, slaves).complete
    assert group.statistics.warnings == 7


def test_half_an_answer_is_none(group, slaves, wire):
    """TPDO1 came and TPDO2 did not: the row of that axis stays empty."""
    real = wire.emit
    wire.emit = lambda can_id, *rest, **flags: None if can_id == 0x283 else real(can_id, *rest, **flags)
    assert step(group, slaves).missing == (2,)
    wire.emit = real
    assert step(group, slaves).complete


def test_foreign_and_odd_frames_between_the_answers_do_no_harm(group, slaves, wire):
    for _ in range(10):
        wire.emit(0x7FF, b"\0" * 8)
        wire.emit(0x123, b"")
        wire.emit(0x182, b"", 0.0, is_remote_frame=True)
        wire.emit(0x020, b"\0" * 8, 0.0, is_error_frame=True)
        assert step(group, slaves).complete
    assert group.statistics.frames["error"] == 10


def test_readings_of_a_row_are_of_one_sync_even_if_the_frames_arrive_in_any_order(group, slaves):
    for number in range(1, 10):
        for axis, slave in enumerate(slaves):
            slave.tpdo_delay_s[slave.sync_seen + number] = 0.0001 * ((axis * 7 + number * 3) % 5 + 1)
    for _ in range(9):
        assert step(group, slaves).complete


class Script:
    """An adapter that delivers frames by a list; None = nothing for a while."""

    def __init__(self, frames):
        self.frames = list(frames)

    def recv(self, timeout=None):
        import can

        item = self.frames.pop(0) if self.frames else None
        return None if item is None else can.Message(arbitration_id=item[0], data=item[1], is_extended_id=False)

    def send(self, message):
        pass

    def shutdown(self):
        self.frames.clear()


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.one_of(st.none(), st.tuples(st.sampled_from([0x181, 0x182, 0x200, 0x77F]), st.binary(max_size=8)))))
def test_whatever_arrives_a_slot_holds_a_frame_of_its_length_or_nothing(wire, frames):
    with Bus(Script(frames), BusSpec("test", "script")) as bus:
        collector = EpochCollector(bus, [(0x181, 8), (0x182, 4)], 1e-3)
        row = collector.collect(wire.now_s, 0.0)
        assert [None if data is None else len(data) for data in row] in ([8, 4], [None, 4], [8, None], [None, None])
        seen: dict[int, set[bytes]] = {0x181: set(), 0x182: set()}
        for item in frames:
            if item is not None and len(item[1]) == {0x181: 8, 0x182: 4}.get(item[0]):
                seen[item[0]].add(item[1])
        assert row[0] is None or bytes(row[0]) in seen[0x181]
        collector.sweep()
        collector.close()


def test_a_drive_that_is_only_slow_is_waited_for(group, slaves):
    """It answers neither the SYNC nor the question for a while: nothing is lost."""
    slaves[1].tpdo_delay_s[slaves[1].sync_seen + 1] = 0.3
    slaves[1].reply = lambda request, answer: [(0.32, answer)]
    assert step(group, slaves).complete
    slaves[1].reply = lambda request, answer: [(0.001, answer)]
    for _ in range(5):
        assert step(group, slaves).complete
    assert group.statistics.incomplete == 0
    assert group.access[1].sdo.upload(0x1000) == b"\x92\x01\x02\x00"


def test_a_question_that_is_lost_as_well_is_asked_again(group, slaves, wire):
    slaves[1].tpdo_delay_s[slaves[1].sync_seen + 1] = None
    first = iter([[]])
    slaves[1].reply = lambda request, answer: next(first, [(0.001, answer)])
    start = wire.now_s
    assert step(group, slaves).missing == (1,)
    assert wire.now_s - start < 0.15
    assert step(group, slaves).complete


class HeldUp:
    """A bus whose master is suspended for long in its first wait; what has arrived meanwhile is there afterwards."""

    def __init__(self, asleep_s: float, arrived: list[Message]) -> None:
        self.now_s, self._asleep_s, self._arrived = 0.0, asleep_s, arrived
        self.stamped = False

    def subscribe(self, _can_id: int, _handler: object) -> None:
        pass

    def receive(self, timeout_s: float) -> Message | None:
        if self._asleep_s:
            self.now_s += self._asleep_s
            self._asleep_s = 0.0
        elif self._arrived:
            return self._arrived.pop(0)
        else:
            self.now_s += timeout_s
        return None


@pytest.mark.parametrize(("asleep_s", "is_complete"), [(0.03, True), (0.009, False)])
def test_by_the_clock_a_master_that_slept_past_the_window_reads_what_waits_for_it(monkeypatch, asleep_s, is_complete):
    """Window 9 ms. Who wakes in time finds the window over; who was stalled finds the answers in its queue."""
    bus = HeldUp(asleep_s, [Message(arbitration_id=0x181, data=bytes(8)), Message(arbitration_id=0x182, data=bytes(8))])
    monkeypatch.setattr("drives.epoch.time", SimpleNamespace(monotonic=lambda: bus.now_s))
    collector = EpochCollector(bus, [(0x181, 8), (0x182, 8)], 0.009)  # type: ignore[arg-type]
    frames = collector.collect(0.0, 0.0)
    assert (None not in frames) == is_complete
    assert bus.now_s <= asleep_s + 0.009


def test_a_lost_answer_costs_little_time(group, slaves, wire):
    slaves[1].tpdo_delay_s[slaves[1].sync_seen + 1] = None
    start = wire.now_s
    assert step(group, slaves).missing == (1,)
    assert step(group, slaves).complete
    assert wire.now_s - start < 0.06


def test_a_row_has_the_time_at_which_its_sync_left_a_full_transmit_queue(bus, slaves, setups, wire):
    """Every 5th SYNC is refused for 6 ms of its 10 ms: rows, lateness and answers are those of the frame that left."""
    from can import CanOperationError

    real, state, reported = wire.send, {"count": 0, "since": None}, []

    def send(message, timeout=None):
        if message.arbitration_id == 0x80:
            if state["since"] is None:
                state["count"], state["since"] = state["count"] + 1, wire.now_s
            if state["count"] % 5 == 0 and wire.now_s - state["since"] < 0.006:
                raise CanOperationError("Transmit buffer full")
            state["since"] = None
        real(message, timeout)

    with configured(bus, setups(3), 0.01, "real") as group:
        group.enable()
        for _ in range(5):
            group.hold()
        wire.send = send
        before = len(wire.sent)
        for _ in range(40):
            epoch = group.exchange([DriveCommand((d.target_count + 100) * d.scale.count_rad) for d in group.drives])
            assert epoch.complete
            reported.append(epoch.time_s)
        sent = zip(wire.sent[before:], wire.sent_at_s[before:], strict=True)
        left = [at for (can_id, _), at in sent if can_id == 0x80]
        assert max(b - a for a, b in zip(left, left[1:], strict=False)) > 0.0155
        for (a, b), (c, d) in zip(
            zip(left, left[1:], strict=False), zip(reported, reported[1:], strict=False), strict=True
        ):
            assert b - a == pytest.approx(d - c, abs=2e-5)
        assert group.statistics.jitter_p99_s == pytest.approx(0.006, abs=6e-4)  # of fewer than 100: the greatest
