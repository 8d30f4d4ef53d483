"""The three proofs of how the drives stop, on slaves of which it is known when they stop, how far and how long."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import pytest

from drives.drive import DriveCommand
from drives.errors import ConfigurationRefused, DriveError, DriveFault, TransitionTimeout
from drives.group import DriveGroup
from drives.values import AxisSetup
from tests.drives.conftest import Slave, Wire, configured, prove_quick_stop, release, stop_responding

PERIOD_S = 0.01
COUNT_RAD = 2 * math.pi / 65536
#: Consumer heartbeat time of the generic profile [s].
NO_HEARTBEAT_S = 0.5
STEP = 20


@pytest.fixture
def slaves(add_slaves: Callable[[int], list[Slave]]) -> list[Slave]:
    found = add_slaves(3)
    for slave in found:
        slave.supervises = True
    found[1].rounded = {(0x1016, 1): 60}  # 488 ms instead of 500 ms
    return found


@pytest.fixture
def group(bus: object, slaves: list[Slave], setups: Callable[[int], list[AxisSetup]]) -> Iterator[DriveGroup]:
    """In real time: that is what the drives supervise by."""
    with configured(bus, setups(3), PERIOD_S, "real") as group:
        group.enable()
        yield group


def rows(slaves: list[Slave], number: int) -> list[list[DriveCommand]]:
    """So many setpoints, each `STEP` counts further."""
    return [
        [DriveCommand((slave.position + STEP * row) * COUNT_RAD) for slave in slaves] for row in range(1, number + 1)
    ]


def words(wire: Wire, node_id: int) -> list[tuple[float, int]]:
    """Controlwords to a node with the times at which they went out."""
    sent = zip(wire.sent, wire.sent_at_s, strict=True)
    return [(at, data[0] | data[1] << 8) for (can_id, data), at in sent if can_id == 0x200 + node_id]


def last_beat_s(wire: Wire) -> float:
    return max(at for (can_id, _), at in zip(wire.sent, wire.sent_at_s, strict=True) if can_id == 0x77F)


def test_each_drive_leaves_operation_after_its_heartbeat_time(group, slaves, wire):
    """30 steps of 20 counts; axis 1 goes on by 700, 500 and 300 counts while it brakes, the others stop at once."""
    slaves[0].moves_in = {"quick stop": [700, 500, 300]}
    traces = stop_responding(group, rows(slaves, 30))
    assert [trace.stated_s - PERIOD_S for trace in traces] == pytest.approx([NO_HEARTBEAT_S, 0.488, NO_HEARTBEAT_S])
    for trace in traces:
        assert -2 * PERIOD_S < trace.left_s - trace.stated_s <= PERIOD_S
        assert trace.left_s - trace.enabled_s == pytest.approx(PERIOD_S, abs=1e-3)
        assert (trace.in_time, trace.stood, str(trace.state)) == (True, True, "QUICK STOP ACTIVE")
    assert [trace.node_id for trace in traces] == [1, 2, 3]
    assert [trace.moved_rad / COUNT_RAD for trace in traces] == pytest.approx([30 * STEP + 1500, 30 * STEP, 30 * STEP])
    assert [trace.coast_rad / COUNT_RAD for trace in traces] == pytest.approx([1500, 0, 0])
    assert traces[0].rest_s == pytest.approx(traces[0].left_s + 3 * PERIOD_S, abs=1e-3)
    assert {slave.state for slave in slaves} == {"switch on disabled"}


def test_no_heartbeat_and_no_word_that_energises_follows(group, slaves, wire):
    begun_s = wire.now_s
    stop_responding(group, rows(slaves, 30))
    assert last_beat_s(wire) - begun_s < PERIOD_S
    for slave in slaves:
        left_s = next(at for at, word in words(wire, slave.node_id) if at > begun_s and word != 0x0F)
        assert {word for at, word in words(wire, slave.node_id) if at >= left_s} <= {0x02, 0x00, 0x06, 0x07}
        targets = [slave.position] * 3
        assert slave.position_at_sync[-3:] == targets


def test_after_the_last_set_point_the_axes_are_held_and_a_drive_that_has_left_keeps_its_target(group, slaves):
    start = [slave.position for slave in slaves]
    slaves[1].values[0x1016, 1] = 127 << 16 | 100
    stop_responding(group, rows(slaves, 80))
    went = [(slave.values[0x607A, 0] - at) // STEP for slave, at in zip(slaves, start, strict=True)]
    assert went[1] == pytest.approx(0.1 / PERIOD_S + 1, abs=2)
    assert went[0] == went[2] == pytest.approx(NO_HEARTBEAT_S / PERIOD_S + 1, abs=2)


def test_a_drive_that_ignores_the_missing_heartbeat_is_stopped_by_the_master(group, slaves, wire):
    """0.2 s after the stated time; the others are out by then."""
    slaves[2].supervises = False
    traces = stop_responding(group, rows(slaves, 10))
    assert [trace.in_time for trace in traces] == [True, True, False]
    assert traces[2].left_s is None
    stopped_s = next(at for at, word in words(wire, 3) if word == 0x02)
    assert stopped_s - last_beat_s(wire) == pytest.approx(NO_HEARTBEAT_S + PERIOD_S + 0.2, abs=3 * PERIOD_S)
    assert {slave.state for slave in slaves} == {"switch on disabled"}


def test_a_drive_that_leaves_later_than_it_said_is_not_in_time(group, slaves):
    slaves[0].values[0x1016, 1] = 127 << 16 | 600
    first, second, _ = stop_responding(group, rows(slaves, 10))
    assert (first.in_time, second.in_time) == (False, True)
    assert first.left_s == pytest.approx(0.6, abs=2 * PERIOD_S)


def test_a_drive_that_still_moves_at_the_end_did_not_stand(group, slaves):
    slaves[1].moves_in = {"quick stop": [500] * 260}
    traces = stop_responding(group, rows(slaves, 10))
    assert [trace.stood for trace in traces] == [True, False, True]
    assert {slave.state for slave in slaves} == {"switch on disabled"}


def test_a_drive_that_goes_on_at_the_speed_of_the_proof_did_not_stand(group, slaves):
    """A motor behind a low gear ratio turns by a tenth of what a braked one shakes between two SYNCs."""
    slaves[1].moves_in = {"quick stop": [STEP] * 260}
    traces = stop_responding(group, rows(slaves, 10))
    assert [trace.stood for trace in traces] == [True, False, True]


def test_a_drive_that_leaves_the_bus_as_well_is_asked_by_sdo(group, slaves):
    """Error behaviour 0x1029: a missing heartbeat may end NMT state OPERATIONAL too, and the answers to SYNC."""
    slave = slaves[1]
    slave.at_sync = lambda: slave.state == "quick stop" and setattr(slave, "nmt", 127)
    trace = stop_responding(group, rows(slaves, 10))[1]
    assert (trace.stood, str(trace.state)) == (True, "QUICK STOP ACTIVE")
    assert trace.left_s is not None


@pytest.mark.parametrize("option", [1, 2, 3])
def test_whatever_0x6007_makes_of_it_counts_as_left(group, slaves, option):
    slaves[0].values[0x6007, 0] = option
    first = stop_responding(group, rows(slaves, 5))[0]
    assert (first.in_time, first.stood) == (True, True)
    assert str(first.state) == {1: "FAULT", 2: "SWITCH ON DISABLED", 3: "QUICK STOP ACTIVE"}[option]
    assert slaves[0].state == ("fault" if option == 1 else "switch on disabled")


def test_only_enabled_axes_stop_responding(group, slaves):
    group.disable()
    with pytest.raises(ConfigurationRefused):
        stop_responding(group, rows(slaves, 1))


def test_a_bus_that_fails_meanwhile_ends_the_proof_and_all_are_stopped(group, slaves, wire):
    group.on_stop = lambda: setattr(wire, "send_errors", 0)
    last = rows(slaves, 5)
    remaining = iter(last)

    def failing() -> Iterator[list[DriveCommand]]:
        yield from remaining
        wire.send_errors = 1 << 30
        yield last[-1]

    with pytest.raises(DriveError, match="could not be sent"):
        stop_responding(group, failing())
    assert {slave.state for slave in slaves} == {"quick stop"}
    assert not group.enabled


# -- one axis on its brake ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("syncs", "waited"), [(90, True), (120, False)])
def test_a_slow_drive_is_waited_for_as_long_as_its_profile_says(group, slaves, syncs, waited):
    """1 s is 100 SYNCs."""
    slaves[1].obey_after(syncs)
    slaves[1].moves_in = {"switch on disabled": [-30, -40, 10]}
    if waited:
        assert release(group, 1, 0.2).moved_rad == pytest.approx(70 * COUNT_RAD)
    else:
        with pytest.raises(TransitionTimeout, match="stays in OPERATION ENABLED"):
            release(group, 1, 0.2)


def test_one_axis_is_watched_for_as_long_as_asked(group, slaves):
    """What it does afterwards does not count; a slow drive is watched from when it has left, 0.3 s without voltage."""
    slaves[1].obey_after(30)
    slaves[1].moves_in = {"switched on": [0], "switch on disabled": [0] * 27 + [-5] + [-400] * 10}
    syncs = slaves[0].sync_seen
    brake_drop_rad = release(group, 1, 0.3).moved_rad
    assert 5 <= brake_drop_rad / COUNT_RAD + 1e-6 < 1000
    assert slaves[0].sync_seen - syncs >= 30 + 20


@pytest.mark.parametrize("deaf", [0, 1, 4])
def test_a_brake_that_fails_without_voltage_is_caught_from_there(group, slaves, deaf):
    """Three controlwords in three SYNCs lead back; a drive that misses some is led by the state that it shows."""
    slaves[1].moves_in = {
        "switched on": [0] * 11 + [40] * 30,
        "switch on disabled": [40] * 30,
        "ready": [40] * 30,
    }
    missed: list[int] = []

    def obeys(word: int) -> bool:
        if word != 0x06 or len(missed) >= deaf:
            return True
        missed.append(word)
        return False

    slaves[1].obeys = obeys
    slaves[1].controlwords.clear()
    test = release(group, 1, 0.5, limit_rad=200 * COUNT_RAD)
    assert test.beyond_limit
    assert test.held
    words = slaves[1].controlwords
    up = words[words.index(0x06, words.index(0x00)) :]
    assert up[:3] == [0x06, 0x07, 0x0F]
    assert 200 <= test.farthest_rad / COUNT_RAD <= 200 + 40 * (4 if not deaf else 16)


def test_a_brake_counts_as_holding_only_without_voltage(group, slaves):
    """The time asked for has passed before the voltage is off; the brake lets go 0.25 s after that."""
    slaves[1].moves_in = {"switch on disabled": [0] * 25 + [40] * 30}
    assert release(group, 1, 0.05, limit_rad=200 * COUNT_RAD).beyond_limit


def test_a_drive_that_keeps_its_voltage_in_the_brake_test_is_named(group, slaves):
    slaves[1].obeys = lambda word: word != 0x00
    for _ in range(5):
        group.hold()
    group.release(1, math.inf, disables_voltage=True)
    with pytest.raises(TransitionTimeout, match=r"node 2.*SWITCHED ON.*voltage"):
        [group.hold() for _ in range(200)]
    slaves[1].obeys = lambda word: True


def test_an_axis_that_falls_is_held_again_once_its_drive_is_ready(group, slaves):
    falls = [40] * 30
    slaves[1].moves_in = {
        "switched on": [0] * 11 + falls,
        "switch on disabled": falls,
        "not ready": falls,
        "ready": falls,
    }
    waits: list[int] = []

    def obeys(word: int) -> bool:
        if word == 0x06 and not waits or slaves[1].state == "not ready":
            waits.append(word)
            slaves[1].state = "not ready" if len(waits) < 3 else "switch on disabled"
            return False
        return True

    slaves[1].obeys = obeys
    test = release(group, 1, 0.5, limit_rad=200 * COUNT_RAD)
    assert test.beyond_limit
    assert test.held
    assert len(waits) == 3


def test_an_axis_that_was_tried_is_held_by_its_drive_again(group, slaves):
    """It is enabled where it is, and guarded as before; statusword bit 12, set before, may come back a while later."""
    plain = slaves[1].bytes_of

    def bytes_of(address: tuple[int, int]) -> bytes:
        data = plain(address)
        if address != (0x6041, 0) or len(slaves[1].controlwords) in range(50, 75):
            return data
        return bytes([data[0], data[1] | 0x10])

    slaves[1].bytes_of = bytes_of  # type: ignore[method-assign]
    for _ in range(5):
        group.hold()
    slaves[1].controlwords[:] = [0] * 45
    test = group.release(1, 0.1)
    while test.released_syncs < 5:
        group.hold()
    test.enable_again()
    while not test.held:
        group.hold()
    for _ in range(10):
        group.hold()
    assert {slave.state for slave in slaves} == {"operation enabled"}
    slaves[1].state = "fault"
    with pytest.raises(DriveFault, match="node 2"):
        group.hold()


@pytest.mark.parametrize(("broken", "says"), [("fault", "cannot be enabled again"), ("switched on", "is not enabled")])
def test_a_drive_that_does_not_hold_its_axis_again_stops_all(group, slaves, broken, says):
    slaves[1].moves_in = {"switched on": [-300] * 10}

    def obeys(word: int) -> bool:
        if (slaves[1].state, word) != ("switched on", 0x0F):
            return True
        slaves[1].state = broken
        return False

    slaves[1].obeys = obeys
    with pytest.raises(DriveError, match=f"node 2.*{says}"):
        release(group, 1, 0.2, limit_rad=1000 * COUNT_RAD, disables_voltage=False)
    assert {slave.state for slave in slaves if slave.node_id != 2} == {"switch on disabled"}


# -- the quick stop ----------------------------------------------------------------------------------------------------


def test_a_ramp_is_watched_until_it_ends(group, slaves):
    """0.5 s of ramp: the trace says when the axis was last seen to move, and the master's heartbeat goes on."""
    slaves[2].moves_in = {"quick stop": [1000 - 10 * number for number in range(50)]}
    third = prove_quick_stop(group, rows(slaves, 5))[2]
    assert third.stood
    assert third.rest_s == pytest.approx(50 * PERIOD_S, abs=2 * PERIOD_S)
    assert third.coast_rad / COUNT_RAD == pytest.approx(sum(1000 - 10 * number for number in range(50)), abs=2 * STEP)


def test_a_drive_that_obeys_after_two_syncs_is_in_time_and_a_later_one_is_not(group, slaves):
    slaves[0].obey_after(1)
    slaves[1].obey_after(6)
    first, second, third = prove_quick_stop(group, rows(slaves, 5))
    assert (first.in_time, second.in_time, third.in_time) == (True, False, True)
    assert second.left_s == pytest.approx(third.left_s + 6 * PERIOD_S, abs=1e-3)
    assert second.stood
