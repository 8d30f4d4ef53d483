"""Disabling: a master that was stalled, standstill before the brakes, drop, the end of the heartbeat, two proofs."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import can
import pytest

from drives.drive import DriveCommand
from drives.epoch import EpochCollector
from drives.errors import (
    BusError,
    ConfigurationRefused,
    DriveError,
    DriveFault,
    MasterStalled,
    SeveralFailures,
    StopRequested,
    TransitionTimeout,
)
from drives.group import DriveGroup
from drives.reactions import DRIVE_RULES
from drives.values import AxisSetup
from gateway.data.disk import Disk
from gateway.data.recording.bus_log import FrameLog
from tests.drives.conftest import Slave, Wire, configured, prove_quick_stop, release

PERIOD_S = 0.01
COUNT_RAD = 2 * math.pi / 65536
SYNC, HEARTBEAT = 0x080, 0x77F


@pytest.fixture
def slaves(add_slaves: Callable[[int], list[Slave]]) -> list[Slave]:
    return add_slaves(6)


def made(bus: object, setups: Callable[[int], list[AxisSetup]], pacing: str) -> Iterator[DriveGroup]:
    with configured(bus, setups(6), PERIOD_S, pacing) as group:
        group.enable()
        yield group


@pytest.fixture
def real(bus, slaves, setups) -> Iterator[DriveGroup]:
    yield from made(bus, setups, "real")


@pytest.fixture
def group(bus, slaves, setups) -> Iterator[DriveGroup]:
    yield from made(bus, setups, "lockstep")


def move(group: DriveGroup, rows: int = 1, step: int = 100) -> None:
    """Every axis goes on by so many counts a SYNC."""
    for _ in range(rows):
        group.exchange([DriveCommand((drive.target_count + step) * COUNT_RAD) for drive in group.drives])


def beats_s(wire: Wire) -> list[float]:
    """When heartbeats of the master went out."""
    return [at for (can_id, _), at in zip(wire.sent, wire.sent_at_s, strict=True) if can_id == HEARTBEAT]


# -- a master that was stalled -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("where", ["before the commands", "while waiting for the SYNC"])
def test_a_master_that_was_held_up_while_moving_stops_and_sends_no_further_set_point(real, slaves, wire, where):
    move(real, 5)
    last = [slave.values[0x607A, 0] for slave in slaves]
    syncs, start = slaves[0].sync_seen, len(wire.sent)
    if where == "before the commands":
        wire.now_s += 0.345
        woken_s = wire.now_s
    else:
        wire.held_up_s = 0.345
        woken_s = wire.now_s + 0.345
    with pytest.raises(MasterStalled, match=r"stalled for 0\.3[345]. s while the arm moved") as caught:
        move(real)
    sync_s = [at for (can_id, _), at in zip(wire.sent, wire.sent_at_s, strict=True) if can_id == 0x080]
    assert sync_s[syncs - slaves[0].sync_seen] - woken_s < 2 * PERIOD_S
    applied = [slave.values[0x607A, 0] for slave in slaves]
    assert applied == last
    assert {slave.controlwords[-1] for slave in slaves} == {0x02}
    assert {slave.state for slave in slaves} == {"quick stop"}
    assert [slave.position for slave in slaves] == last
    assert caught.value.while_stopping == ()
    assert (len(wire.sent) > start, real.enabled) == (True, False)
    real.disable()
    assert {slave.state for slave in slaves} == {"switch on disabled"}


@pytest.mark.parametrize(("delay_s", "stops"), [(0.019, False), (0.0225, True)])
def test_a_delay_of_two_periods_is_the_limit(real, slaves, wire, delay_s, stops):
    assert DRIVE_RULES["stalled"].limit == 2
    move(real, 3)
    wire.now_s += PERIOD_S + delay_s - 1e-3
    if stops:
        with pytest.raises(MasterStalled):
            move(real)
    else:
        move(real)
        assert real.enabled


def test_the_sync_after_the_last_set_point_counts_as_motion(real, wire):
    move(real, 3)
    wire.now_s += 0.1
    with pytest.raises(MasterStalled):
        real.hold()


def test_a_master_that_was_held_up_at_rest_goes_on_without_that_row(real, slaves, wire):
    for _ in range(3):
        real.hold()
    overruns = real.statistics.overruns
    wire.now_s += 0.345
    epoch = real.hold()
    assert epoch.missing == (0, 1, 2, 3, 4, 5)
    assert real.statistics.overruns > overruns + 30
    assert [real.hold().complete for _ in range(3)] == [True] * 3
    move(real, 2)
    assert real.enabled


def test_in_lockstep_time_stops_while_the_master_does(group, wire):
    move(group, 3)
    wire.now_s += 5.0
    move(group, 3)
    assert group.enabled


def test_a_set_point_that_never_went_out_with_a_sync_is_not_the_place_to_stop_at(group, slaves, wire):
    """The bus fails while a row is being sent: the words to stop carry the targets of the row before."""
    move(group, 3)
    last = slaves[0].values[0x607A, 0]
    wire.send_errors = 1 << 30
    with pytest.raises(BusError):
        move(group)
    wire.send_errors = 0
    group.disable()
    assert slaves[0].values[0x607A, 0] == last


# -- standstill before the brakes, and drop ----------------------------------------------------------------------------


def test_an_axis_that_moves_is_brought_to_rest_before_it_is_disabled(group, slaves):
    move(group, 5, step=900)
    for slave in slaves:
        slave.moves_in = {"quick stop": [700, 500, 300, 100, 10]}
        slave.controlwords.clear()
    group.disable()
    for slave in slaves:
        words = slave.controlwords
        assert words[0] == 0x02
        first = next(number for number, word in enumerate(words) if word != 0x02)
        assert first >= 5 + 3
        assert slave.moves_in["quick stop"] == []
        assert slave.state == "switch on disabled"


def test_an_axis_at_rest_is_disabled_without_a_ramp(group, slaves):
    for _ in range(5):
        group.hold()
    for slave in slaves:
        slave.controlwords.clear()
    group.disable()
    assert all(0x02 not in slave.controlwords for slave in slaves)


def test_drop_is_measured_from_where_the_drive_last_held_the_axis(group, slaves):
    for _ in range(5):
        group.hold()
    slaves[1].moves_in = {"switched on": [-20], "switch on disabled": [-30, -40, 10, 0, 0, -5]}
    slaves[4].moves_in = {"switch on disabled": [7]}
    syncs = slaves[0].sync_seen
    group.disable()
    assert group.brake_drop_rad == pytest.approx([0, 90 * COUNT_RAD, 0, 0, 7 * COUNT_RAD, 0])
    assert slaves[0].sync_seen - syncs >= 0.3 / PERIOD_S


@pytest.mark.parametrize(("closing_s", "syncs"), [(0.1, 10), (0.0, 0), (0.25, 25), (0.101, 11)])
def test_the_voltage_stays_on_until_the_brake_has_had_its_time_to_close(bus, slaves, setups, closing_s, syncs):
    """SYNCs and the master's heartbeat go on meanwhile; without the voltage no drive holds the axis."""
    some = setups(6)
    machine = some[0].profile.state_machine.model_copy(update={"brake_closing_s": closing_s})
    some[2] = replace(some[2], profile=some[2].profile.model_copy(update={"state_machine": machine}))
    with configured(bus, some, PERIOD_S, "lockstep") as group:
        group.enable()
        for _ in range(5):
            group.hold()
        states: list[str] = []
        slave = slaves[2]
        slave.at_sync = lambda: states.append(slave.state)
        group.disable()
        assert states.count("switched on") in (syncs + 1, syncs + 2)  # its state is read one SYNC later
        assert slave.state == "switch on disabled"


def test_the_brake_has_its_time_to_close_after_a_quick_stop_too(group, slaves):
    """The drives stay in QUICK STOP ACTIVE; `brake_closing_s` is 0.1 s, and three SYNCs show the standstill."""
    move(group, 3)
    for slave in slaves:
        slave.controlwords.clear()
    group.quick_stop()
    group.disable()
    for slave in slaves:
        assert slave.controlwords.index(0x00) >= 3 + 10
        assert set(slave.controlwords) == {0x02, 0x00}


def test_an_axis_that_still_slows_down_is_waited_for(group, slaves):
    """It needs 8 s, more than a ramp is given. Standstill is 0.001 revolutions between two SYNCs."""
    move(group, 3)
    slaves[3].moves_in = {"quick stop": [800 - step for step in range(801)]}
    with pytest.raises(TransitionTimeout, match=r"node 4.*still moves.*emergency stop"):
        group.disable()
    assert slaves[3].state == "switch on disabled"
    assert slaves[3].moves_in["quick stop"][0] <= 0.001 * 65536


@pytest.mark.parametrize("stops_before", [False, True])
def test_an_axis_that_does_not_slow_down_is_not_disabled_and_the_emergency_stop_is_named(group, slaves, stops_before):
    """It answers SYNC. It stays in its quick stop, watches for the heartbeat that has ended, and the others go on."""
    move(group, 3)
    slaves[3].moves_in = {"quick stop": [500] * 3000}
    slaves[3].controlwords.clear()
    if stops_before:
        with pytest.raises(TransitionTimeout, match=r"node 4.*still moves"):
            group.quick_stop()
    with pytest.raises(TransitionTimeout, match=r"node 4.*not disabled.*emergency stop"):
        group.disable()
    group.close()
    assert set(slaves[3].controlwords) == {0x02}
    assert slaves[3].state == "quick stop"
    assert slaves[3].values[0x1016, 1]
    assert {slave.state for slave in slaves if slave.node_id != 4} == {"switch on disabled"}
    assert not group.heartbeat.running


def test_the_time_of_a_brake_that_was_never_opened_is_not_waited_for(bus, slaves, setups):
    asked: list[int] = []

    def stop_requested() -> bool:
        asked.append(1)
        return slaves[2].state == "switched on"

    with configured(bus, setups(6), PERIOD_S, "lockstep") as group:
        with pytest.raises(StopRequested):
            group.enable(stop_requested)
        words = slaves[2].controlwords
        assert words[words.index(0x07) :].count(0x07) == 1


def test_a_quick_stop_leaves_an_axis_whose_brake_closes_in_switched_on(group, slaves):
    """What comes next, `disable`, waits for the brake."""
    move(group, 3)
    slaves[1].obeys = lambda word: word != 0x0F
    slaves[1].state = "switched on"
    with pytest.raises(DriveFault):
        move(group)
    assert slaves[1].state == "switched on"
    slaves[1].controlwords.clear()
    group.disable()
    assert slaves[1].controlwords.count(0x07) == pytest.approx(10, abs=1)
    assert slaves[1].state == "switch on disabled"


def test_one_axis_that_does_not_obey_leaves_the_others_led_down(group, slaves):
    move(group, 3)
    slaves[2].stuck_in = "operation enabled"
    with pytest.raises(TransitionTimeout, match="node 3.*stays in OPERATION ENABLED.*emergency stop"):
        group.disable()
    assert {slave.state for slave in slaves} == {"switch on disabled", "operation enabled"}


def test_an_axis_that_answers_sdo_alone_is_brought_to_rest_before_it_is_disabled(group, slaves, wire):
    """It has left NMT state OPERATIONAL; in lockstep it slows down over 80 SYNCs, each of which is 10 ms to it."""
    move(group, 3)
    slave = slaves[1]
    slave.nmt = 127
    plain, read, began = slave.get, [], []

    def get(address: tuple[int, int]) -> int:
        if address == (0x6064, 0):
            syncs = wire.sent.count((0x080, b""))
            began.extend([syncs] * (slave.state == "quick stop" and not began))
            left = max(0, 80 - syncs + began[0])
            slave.position = 400_000 - 50 * left**2
            read.append((left, slave.state))
        return plain(address)

    slave.get = get  # type: ignore[method-assign]
    slave.controlwords.clear()
    group.disable()
    assert slave.controlwords[0] == 0x02
    *ramp, (left, state_at_rest) = read
    assert {state for _, state in ramp} == {"quick stop"}
    assert (left, state_at_rest) == (0, "switch on disabled")


@pytest.mark.parametrize(("syncs", "enough"), [(205, True), (222, False)])
def test_a_ramp_is_waited_for_two_seconds(group, slaves, syncs, enough):
    """Of 10 ms each; 0.2 s beyond them are patience."""
    move(group, 3)
    slaves[3].moves_in = {"quick stop": [500] * syncs}
    if enough:
        group.quick_stop()
        assert slaves[3].moves_in["quick stop"] == []
    else:
        with pytest.raises(TransitionTimeout, match=r"node 4.*still moves 2\.2 s"):
            group.quick_stop()


@pytest.mark.parametrize(("syncs", "goes_on"), [(15, True), (30, False)])
def test_the_heartbeat_ends_when_an_axis_stays_enabled_too_long(group, slaves, wire, syncs, goes_on):
    """0.2 s are 20 SYNCs; a drive that still is enabled then shall stop by itself."""
    move(group, 3)
    slaves[2].obey_after(syncs)
    group.quick_stop()
    before = len(beats_s(wire))
    group.bus.listen(0.5)
    assert (len(beats_s(wire)) > before) == goes_on
    assert {slave.state for slave in slaves} == {"quick stop"}


def test_a_bus_that_fails_while_the_drop_is_monitored_ends_the_heartbeat(group, slaves, wire):
    for _ in range(5):
        group.hold()
    slaves[0].at_sync = lambda: slaves[0].state == "switch on disabled" and setattr(wire, "send_errors", 1 << 30)
    with pytest.raises(DriveError, match="could not be sent"):
        group.disable()
    wire.send_errors = 0
    beats = len(beats_s(wire))
    group.bus.listen(1.0)
    assert len(beats_s(wire)) == beats


def test_arms_that_all_stop_responding_are_not_monitored_for_a_drop(group, slaves):
    """Nothing is measured where nothing answers."""
    for _ in range(5):
        group.hold()
    syncs = []

    def counted(slave: Slave, plain: Callable[[int, bytes], None], can_id: int, data: bytes) -> None:
        syncs.extend([slave.state] * (can_id == SYNC))
        if can_id != SYNC or slave.state != "switch on disabled":
            plain(can_id, data)

    for slave in slaves:
        slave.on_frame = partial(counted, slave, slave.on_frame)  # type: ignore[method-assign]
    with contextlib.suppress(DriveError):
        group.disable()
    assert syncs.count("switch on disabled") <= len(slaves) * 6


# -- without SYNC, or after an interrupted run -------------------------------------------------------------------------


class Decelerating(Slave):
    """Its quick stop takes 1 s from 50 rad/s, in the time of the wire; it reports position and velocity."""

    ramp_s, speed_rad_s = 1.0, 50.0
    began_s: float | None = None
    #: Speed and time when it left the energised states.
    off_rad_s: float | None = None
    off_s = 0.0

    def speed_now_rad_s(self) -> float:
        if self.began_s is None:
            return self.speed_rad_s
        return self.speed_rad_s * max(0.0, 1.0 - (self.wire.now_s - self.began_s) / self.ramp_s)

    def on_frame(self, can_id: int, data: bytes) -> None:
        before = self.state
        super().on_frame(can_id, data)
        if self.state == "quick stop" and self.began_s is None:
            self.began_s = self.wire.now_s
        if before in ("operation enabled", "quick stop") and self.state not in ("operation enabled", "quick stop"):
            self.off_rad_s, self.off_s = self.speed_now_rad_s(), self.wire.now_s

    def get(self, address: tuple[int, int]) -> int:
        if self.began_s is not None and address == (0x6064, 0):
            passed_s = min(self.wire.now_s - self.began_s, self.ramp_s)
            turned_rad = self.speed_rad_s * (passed_s - passed_s**2 / 2.0 / self.ramp_s)
            return self.position + round(turned_rad * 65536 / (2.0 * math.pi))
        if address == (0x606C, 0):
            return round(self.speed_now_rad_s() / 0.0010471975511965976)
        return super().get(address)


@pytest.mark.parametrize("state", ["operation enabled", "quick stop", "switched on"])
def test_a_drive_left_energised_is_disabled_once_its_standstill_was_read_and_its_brake_has_closed(
    bus, wire, setups, state
):
    """Of a killed master, say. `brake_closing_s` of the profile is 0.1 s."""
    slave = Decelerating(wire, 1)
    wire.slaves.append(slave)
    slave.state = state
    if state == "quick stop":
        slave.began_s = wire.now_s
    elif state == "switched on":
        slave.speed_rad_s = 0.0
    with DriveGroup(bus, setups(1), 0.01, "real") as group:
        group.connect()
        group.restore()
        (text,) = group.taken_down
        assert f"node 1: was in {state.replace('quick stop', 'quick stop active').upper()}" in text
        group.restore()
        assert group.taken_down == ()
    assert slave.state == "switch on disabled"
    assert not slave.off_rad_s
    assert slave.controlwords[0] == (0x02 if state == "operation enabled" else 0x00)
    if state == "operation enabled":
        assert slave.off_s - slave.began_s >= slave.ramp_s + 0.1


def test_without_sync_a_drive_is_disabled_by_sdo_once_its_standstill_was_read(bus, wire, setups):
    """The adapter refuses SYNC while the axis moves; SDO works."""
    slave = Decelerating(wire, 1)
    wire.slaves.append(slave)
    with configured(bus, setups(1), 0.01, "real") as group:
        slave.speed_rad_s = 0.0
        group.enable()
        slave.speed_rad_s = 50.0
        count_rad, send = group.drives[0].scale.count_rad, wire.send
        for _ in range(5):
            group.exchange([DriveCommand(group.drives[0].target_count * count_rad + 0.5)])

        def without_sync(message: can.Message, timeout: float | None = None) -> None:
            if message.arbitration_id == 0x080:
                raise can.CanOperationError("no SYNC")
            send(message, timeout)

        wire.send = without_sync  # type: ignore[method-assign]
        with pytest.raises(DriveError, match="no SYNC"):
            group.hold()
        with contextlib.suppress(DriveError):
            group.disable()
        wire.send = send  # type: ignore[method-assign]
    assert slave.state == "switch on disabled"
    assert slave.off_rad_s == 0.0


def test_an_axis_whose_standstill_cannot_be_read_is_not_disabled_and_the_emergency_stop_is_named(bus, wire, setups):
    slave = Decelerating(wire, 1)
    wire.slaves.append(slave)
    slave.state, slave.refused = "operation enabled", {(0x6064, 0): 0x08000000}
    with DriveGroup(bus, setups(1), 0.01, "real") as group:
        group.connect()
        with pytest.raises(DriveError, match=r"node 1:6064.*not known whether the axis is at rest; use the emergency"):
            group.restore()
        assert slave.off_rad_s is None


# -- what fails while disabling ----------------------------------------------------------------------------------------


def test_a_drive_that_cannot_be_disarmed_is_named_and_the_others_are(group, slaves, wire):
    slaves[2].refused[0x1016, 1] = 0x08000022
    with pytest.raises(DriveError, match="node 3:1016:01"):
        group.disable()
    assert [slave.values[0x1016, 1] for slave in slaves if slave.node_id != 3] == [0] * 5
    beats = len(beats_s(wire))
    group.bus.listen(1.0)
    assert len(beats_s(wire)) == beats


def test_a_bus_that_is_dead_at_the_end_is_counted_and_no_error(group, wire):
    group.disable()
    wire.send_errors = 1 << 30
    group.close()
    assert group.bus.counts["unsent_at_close"] == 1


@pytest.mark.parametrize("error", [DriveError("first"), ValueError("first")])
def test_what_goes_wrong_while_closing_is_added_to_the_error_that_led_to_it(bus, slaves, setups, error):
    def used() -> None:
        with configured(bus, setups(6), PERIOD_S) as group:
            group.enable()
            slaves[4].alive = False
            raise error

    with pytest.raises(type(error), match="first") as caught:
        used()
    added = getattr(caught.value, "while_stopping", ())
    assert [failure.node for failure in added] == ([5] if isinstance(error, DriveError) else [])
    assert {slave.state for slave in slaves if slave.node_id != 5} == {"switch on disabled"}


def test_axes_that_never_come_to_rest_are_not_released(group, slaves):
    slaves[0].moves_in = {"operation enabled": [500, -500] * 200}
    move(group, 2, step=0)
    with pytest.raises(ConfigurationRefused, match="bring the axes to rest first"):
        release(group, 1, 0.1)
    assert group.enabled
    assert {slave.state for slave in slaves} == {"operation enabled"}


def test_a_bus_that_fails_while_the_quick_stop_is_tried_is_an_error(group, slaves, wire):
    rows = [[DriveCommand((slave.position + 50 * row) * COUNT_RAD) for slave in slaves] for row in range(1, 6)]
    slaves[0].moves_in = {"quick stop": [700] * 50}
    slaves[0].at_sync = lambda: slaves[0].state == "quick stop" and setattr(wire, "send_errors", 1 << 30)
    group.on_stop = lambda: (setattr(slaves[0], "at_sync", list), setattr(wire, "send_errors", 0))
    with pytest.raises(DriveError, match="could not be sent"):
        prove_quick_stop(group, rows)
    assert not group.enabled
    assert {slave.state for slave in slaves} == {"quick stop"}


# -- the end of the heartbeat ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pacing", ["real", "lockstep"])
@pytest.mark.parametrize("what", ["dead", "deaf", "send"])
def test_no_heartbeat_after_a_stop_that_is_not_confirmed(bus, slaves, setups, wire, pacing, what):
    with configured(bus, setups(6), PERIOD_S, pacing) as group:
        group.enable()
        move(group, 5)
        if what == "dead":
            slaves[5].alive = False
        elif what == "deaf":
            slaves[5].stuck_in = "operation enabled"
            slaves[5].reply = lambda request, answer: []
        else:
            wire.send_errors = 1 << 30
        commanded_s = wire.now_s
        with pytest.raises(DriveError):
            group.quick_stop()
        wire.send_errors = 0
        with pytest.raises(DriveError) if what != "send" else contextlib.nullcontext():
            group.disable()
        assert max(beats_s(wire)) - commanded_s <= 0.2 + PERIOD_S
        with pytest.raises(DriveError, match="configure"):
            group.enable()


def test_heartbeats_go_on_while_the_drives_slow_down(group, slaves, wire):
    move(group, 5)
    for slave in slaves:
        slave.moves_in = {"quick stop": [50000 - 250 * number for number in range(150)]}
    start = len(beats_s(wire))
    group.quick_stop()
    assert len(beats_s(wire)) - start >= 10
    assert {slave.state for slave in slaves} == {"quick stop"}


def test_waiting_for_an_answer_does_not_revive_the_heartbeat(group, slaves, wire):
    move(group, 3)
    for slave in slaves:
        slave.alive = False
    with pytest.raises(SeveralFailures, match="nodes 1 to 6.*no SDO answer"):
        group.quick_stop()
    last = len(beats_s(wire))
    group.bus.listen(5.0)
    assert len(beats_s(wire)) == last
    for slave in slaves:
        slave.alive = True


# -- one axis on its brake ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pacing", ["real", "lockstep"])
def test_one_axis_is_held_by_its_brake_while_the_others_hold(bus, slaves, setups, pacing):
    with configured(bus, setups(6), PERIOD_S, pacing) as group:
        group.enable()
        slaves[1].moves_in = {"switched on": [-20], "switch on disabled": [-30, -40, 10]}
        for slave in slaves:
            slave.controlwords.clear()
        brake_drop_rad = release(group, 1, 0.5).moved_rad
        assert brake_drop_rad == pytest.approx(90 * COUNT_RAD)
        assert slaves[1].controlwords.count(0x0F) <= 5
        assert slaves[0].controlwords.count(0x0F) >= 0.5 / PERIOD_S
        assert {slave.state for slave in slaves} == {"switch on disabled"}
        assert not group.enabled
        assert group.enable().complete


def test_another_axis_that_slips_meanwhile_stops_all(group, slaves):
    slaves[1].at_sync = lambda: slaves[1].state == "switch on disabled" and setattr(slaves[3], "state", "fault")
    with pytest.raises(DriveFault, match="node 4"):
        release(group, 1, 0.5)
    assert {slave.state for slave in slaves} == {"switch on disabled", "fault"}


def test_an_axis_that_stays_enabled_is_named_and_all_are_disabled(group, slaves):
    slaves[1].stuck_in = "operation enabled"
    with pytest.raises(TransitionTimeout, match="node 2.*stays in OPERATION ENABLED"):
        release(group, 1, 0.5)
    assert {slave.state for slave in slaves if slave.node_id != 2} == {"switch on disabled"}


def test_only_enabled_axes_are_released(group):
    with pytest.raises(ConfigurationRefused):
        release(group, 6, 0.1)
    group.disable()
    with pytest.raises(ConfigurationRefused):
        release(group, 1, 0.1)


# -- the quick stop, tried out -----------------------------------------------------------------------------------------


def test_the_quick_stop_is_traced_axis_by_axis(group, slaves):
    """Axis 1 goes on by 700, 500, 300 counts while it brakes, for three SYNCs; axis 2 stops at once."""
    slaves[0].moves_in = {"quick stop": [700, 500, 300]}
    rows = [[DriveCommand((slave.position + 50 * row) * COUNT_RAD) for slave in slaves] for row in range(1, 6)]
    first, second, *_ = prove_quick_stop(group, rows)
    assert (first.node_id, first.in_time, first.stood) == (1, True, True)
    assert first.coast_rad == pytest.approx((700 + 500 + 300) * COUNT_RAD, abs=60 * COUNT_RAD)
    assert first.rest_s == pytest.approx(3 * PERIOD_S, abs=PERIOD_S)
    assert second.rest_s <= PERIOD_S
    assert second.coast_rad <= 60 * COUNT_RAD
    assert {slave.state for slave in slaves} == {"switch on disabled"}
    assert {slave.values[0x607A, 0] - slave.node_id * 1000 for slave in slaves} == {250}


def test_a_drive_that_ignores_the_quick_stop_is_named_and_the_heartbeat_ends(group, slaves, wire):
    slaves[4].stuck_in = "operation enabled"
    rows = [[DriveCommand((slave.position + 50 * row) * COUNT_RAD) for slave in slaves] for row in range(1, 6)]
    with pytest.raises(DriveError, match="node 5.*OPERATION ENABLED"):
        prove_quick_stop(group, rows)
    words = [(data[0], at) for (can_id, data), at in zip(wire.sent, wire.sent_at_s, strict=True) if can_id == 0x205]
    commanded_s = next(at for word, at in words if word == 0x02)
    assert max(beats_s(wire)) - commanded_s <= 0.2 + PERIOD_S
    assert {slave.state for slave in slaves if slave.node_id != 5} == {"switch on disabled"}


# -- failures while disabling --------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), ValueError("bad"), KeyError("x")])
@pytest.mark.parametrize("stage", ["exchange", "quick_stop", "disable", "close"])
def test_any_exception_is_recorded_and_the_stop_of_all_axes_goes_on(
    bus, slaves, setups, wire, monkeypatch, stage, error
):
    """Something fails at every SYNC from a stage on: every axis is led down by SDO, and the heartbeat ends first."""
    group = DriveGroup(bus, setups(6), PERIOD_S, "real")
    group.connect()
    group.configure()
    group.enable()
    move(group, 5)

    def fails(*arguments):
        raise error

    failing = ["exchange", "quick_stop", "disable", "close"]
    for name in failing:
        if name == stage:
            monkeypatch.setattr(EpochCollector, "collect", fails)
        with contextlib.suppress(DriveError, *([type(error)] if name == "exchange" else [])):
            move(group) if name == "exchange" else getattr(group, name)()
    assert {slave.state for slave in slaves} == {"switch on disabled"}
    if stage != "close":
        downs = [at for (_, data), at in zip(wire.sent, wire.sent_at_s, strict=True) if data[:4] == b"\x2b\x40\x60\x00"]
        assert max(beats_s(wire)) < min(downs)


def test_a_notice_to_the_other_arm_that_fails_does_not_keep_this_one_from_stopping(real, slaves):
    def fails():
        raise RuntimeError("cannot schedule new futures after shutdown")

    real.on_stop = fails
    move(real, 3)
    slaves[2].state = "fault"
    with pytest.raises(DriveFault, match="cannot schedule"):
        move(real, 3)
    assert {slave.state for slave in slaves} == {"quick stop", "fault"}


@pytest.mark.parametrize("suffix", ["log", "blf", "asc"])
def test_a_frame_log_on_a_full_disk_neither_ends_a_motion_nor_a_stop(group, slaves, tmp_path, suffix):
    for slave in slaves:
        slave.moves_in = {"quick stop": [50, 30, 10]}
    trace = tmp_path / f"trace.{suffix}"
    trace.symlink_to("/dev/full")
    with Disk() as disk:
        log = FrameLog(disk, trace)
        group.bus.add_tap(log.take)
        move(group, 3)
        log.close()  # what waits is written: it fails
    assert log.failure is not None
    move(group, 200)
    group.quick_stop()
    assert {slave.state for slave in slaves} == {"quick stop"}
    group.disable()
    assert {slave.state for slave in slaves} == {"switch on disabled"}


@pytest.mark.parametrize("object_index", [0x1016, 0x6064])
def test_a_lost_answer_leaves_no_stop_unconfirmed(group: DriveGroup, slaves: list[Slave], object_index: int) -> None:
    """Disabling asks every drive over SDO to stop watching the master, and where it is: each first answer is lost."""
    lost: list[int] = []

    def reply(request: bytes, answer: bytes) -> list[tuple[float, bytes]]:
        if request[1] | request[2] << 8 == object_index and request[0] not in lost:
            lost.append(request[0])
            return []
        return [(0.0002, answer)]

    move(group, 3)
    slaves[2].reply = reply
    group.disable()
    assert lost
    assert {slave.state for slave in slaves} == {"switch on disabled"}
    assert slaves[2].values[0x1016, 1] == 0
    group.enable()
