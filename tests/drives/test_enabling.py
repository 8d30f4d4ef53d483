"""Enabling: stopped by a person, ended by an axis that falls back, bounded in time, and no target follows an axis."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest

from drives.enabling import BRAKE_DROP_REVOLUTIONS
from drives.errors import ConfigurationRefused, DriveFault, IncompleteEpochs, StopRequested, TransitionTimeout
from tests.drives.conftest import configured

PERIOD_S = 0.004
TURN = 65536
OFF = "switch on disabled"


@pytest.fixture
def slaves(add_slaves):
    return add_slaves(3)


@pytest.fixture(params=["lockstep", "real"])
def group(request, bus, slaves, setups):
    with configured(bus, setups(3), PERIOD_S, request.param) as group:
        yield group


def enabling_words(slaves):
    return {word for slave in slaves for word in slave.controlwords if word & 0x08}


def targets(wire, node_id):
    """Every target position that was sent to a node."""
    return [struct.unpack("<Hi", data)[1] for can_id, data in wire.sent if can_id == 0x200 + node_id]


# -- drives that show their mode only once they are enabled ---------------------------------------------------------


@pytest.fixture(params=["lockstep", "real"])
def mode_shown_when_enabled(request, bus, slaves, setups):
    """A group of drives whose 0x6061 stays 0 for a time under power, and the list that holds it in SYNCs."""
    enabled: dict[int, int] = {}
    delay_syncs = [75]

    def mode_of(slave, plain):
        def get(address):
            if address != (0x6061, 0):
                return plain(address)
            if slave.state != "operation enabled":
                return 0
            return 8 if slave.sync_seen - enabled.setdefault(slave.node_id, slave.sync_seen) > delay_syncs[0] else 0

        return get

    for slave in slaves:
        slave.get = mode_of(slave, slave.get)
    with configured(bus, setups(3), PERIOD_S, request.param) as group:
        yield group, delay_syncs


def longest_gap_s(wire):
    """Longest time between two SYNCs since the first drive was enabled."""
    enabled_s = next(at_s for at_s, sent in zip(wire.sent_at_s, wire.sent, strict=True) if sent[1][:1] == b"\x0f")
    syncs = [at_s for at_s, (can_id, _) in zip(wire.sent_at_s, wire.sent, strict=True) if can_id == 0x80]
    return max(later - before for before, later in pairwise(at_s for at_s in syncs if at_s > enabled_s))


def test_a_drive_that_shows_another_mode_by_now_is_not_enabled(group, slaves):
    plain = slaves[1].get
    slaves[1].get = lambda address: 4 if address == (0x6061, 0) else plain(address)
    with pytest.raises(ConfigurationRefused, match="shows mode 4 instead of 8"):
        group.enable()
    assert not enabling_words(slaves)


def test_sync_goes_on_while_the_mode_is_waited_for(mode_shown_when_enabled, wire):
    group, _ = mode_shown_when_enabled
    group.enable()
    assert group.enabled
    assert longest_gap_s(wire) < 2 * PERIOD_S


def test_a_stop_is_detected_while_the_mode_is_waited_for(mode_shown_when_enabled, slaves, wire):
    group, delay_syncs = mode_shown_when_enabled
    delay_syncs[0] = 10_000
    asked_s: list[float] = []

    def asked():
        if min(slave.controlwords.count(0x0F) for slave in slaves) < 30:
            return False
        asked_s.append(wire.now_s)
        return True

    with pytest.raises(StopRequested):
        group.enable(asked)
    assert {slave.state for slave in slaves} == {OFF}
    assert wire.now_s - asked_s[0] < 2.0


def test_a_mode_that_is_never_shown_is_refused_and_no_axis_stays_enabled(mode_shown_when_enabled, slaves, wire):
    group, delay_syncs = mode_shown_when_enabled
    delay_syncs[0] = 10_000
    with pytest.raises(ConfigurationRefused, match="shows mode 0 instead of 8"):
        group.enable()
    assert {slave.state for slave in slaves} == {OFF}
    assert longest_gap_s(wire) < 2 * PERIOD_S or group.timing.pacing == "lockstep"


# -- a person who asks to stop ----------------------------------------------------------------------------------------


def test_who_asks_before_anything_began_gets_nothing_enabled(group, slaves):
    with pytest.raises(StopRequested) as caught:
        group.enable(lambda: True)
    assert caught.value.exit_code == 130
    assert [slave.controlwords for slave in slaves] == [[]] * 3


def test_a_stop_is_detected_while_a_node_does_not_start(group, slaves, wire):
    slaves[1].communication_error_until_s = wire.now_s + 1e9
    begin_s = wire.now_s
    with pytest.raises(StopRequested):
        group.enable(lambda: wire.now_s > begin_s + 0.5)
    assert wire.now_s - begin_s < 1.5
    assert enabling_words(slaves) == set()


def test_a_stop_is_detected_while_an_axis_does_not_switch_on(group, slaves):
    slaves[2].stuck_in = "ready"
    with pytest.raises(StopRequested):
        group.enable(lambda: slaves[2].state == "ready")
    assert {slave.state for slave in slaves[:2]} == {OFF}
    assert not group.enabled


@pytest.mark.parametrize("syncs", [0, 3, 10])
def test_a_stop_is_detected_while_the_brakes_open(group, slaves, syncs):
    """The profile gives the brakes 50 ms, 13 SYNCs."""

    def asked():
        return all(slave.controlwords.count(0x0F) > syncs for slave in slaves)

    with pytest.raises(StopRequested):
        group.enable(asked)
    assert {slave.state for slave in slaves} == {OFF}
    assert max(slave.controlwords.count(0x0F) for slave in slaves) <= syncs + 3
    assert {slave.values[0x1016, 1] for slave in slaves} == {0}


def test_without_a_stop_request_all_are_enabled(group, slaves):
    assert group.enable(lambda: False).complete
    assert {slave.state for slave in slaves} == {"operation enabled"}


# -- falling back -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("place", "below"), [("switched on", "ready"), ("operation enabled", "switched on")])
def test_an_axis_that_falls_back_is_not_led_up_again(group, slaves, place, below):
    """It reaches a state, and some SYNCs later is below it while another axis is still in transit.

    One word was in transit when the fall was reported.
    """
    slaves[0].stuck_in = "ready"
    real = slaves[1].on_frame
    seen = []

    def on_frame(can_id, data):
        words = len(slaves[1].controlwords)
        real(can_id, data)
        for word in slaves[1].controlwords[words:]:
            if slaves[1].state == place:
                seen.append(word)
            if len(seen) > 2 and slaves[1].state == place and word:
                slaves[1].state = below

    if place == "switched on":
        slaves[1].stuck_in = place
    slaves[1].on_frame = on_frame
    with pytest.raises(DriveFault, match="node 2.*fell back from .* while being enabled") as caught:
        group.enable()
    assert caught.value.node == 2
    assert {slaves[1].state, slaves[2].state} == {OFF}
    assert len(seen) == 4


def test_an_axis_that_falls_back_while_the_brakes_open_ends_it(group, slaves):
    def falls_back():
        if slaves[1].controlwords.count(0x0F) == 6 and slaves[1].controlwords[-1] == 0x0F:
            slaves[1].state = "switched on"

    slaves[1].at_sync = falls_back
    with pytest.raises(DriveFault, match="node 2.*left OPERATION ENABLED"):
        group.enable()
    assert {slave.state for slave in slaves} == {OFF}


# -- time -------------------------------------------------------------------------------------------------------------


def test_rows_that_never_become_complete_end_the_enabling(group, slaves, wire):
    """Each axis answers often enough not to count as not responding, but never all three at once."""

    class Absent(dict):
        def __init__(self, phase, begin):
            super().__init__()
            self.phase, self.begin = phase, begin

        def get(self, number, default=None):
            return None if number >= self.begin and number % 3 == self.phase else default

    for phase, slave in enumerate(slaves):
        slave.tpdo_delay_s = Absent(phase, 6)
    if group.timing.pacing == "real":  # answers that cannot be assigned for so long count as missing
        with pytest.raises(IncompleteEpochs, match="SYNCs in a row unanswered"):
            group.enable()
    else:
        with pytest.raises(TransitionTimeout, match=r"after 3\.\d s not all axes are enabled and responding"):
            group.enable()
        assert 2.9 < slaves[0].controlwords.count(0x0F) * PERIOD_S < 3.2
    assert {slave.state for slave in slaves} == {OFF}


# -- places -----------------------------------------------------------------------------------------------------------


def test_the_target_during_enabling_does_not_follow_an_axis_that_drops(group, slaves, wire):
    """Every SYNC before its brake holds the axis sinks by 100 counts: its target stays at its former position."""
    stood = slaves[1].position
    slaves[0].stuck_in = "ready"
    slaves[1].moves_in = {"ready": [-100] * 1000, "switched on": [-100] * 1000}
    slaves[1].stuck_in = "switched on"
    with pytest.raises(TransitionTimeout):
        with_short_patience(group)
    assert set(targets(wire, 2)) == {stood}


def with_short_patience(group):
    """Enable; the axis sinks slowly enough to stay below what counts as moving."""
    for drive in group.drives:
        object.__setattr__(drive.setup.profile.state_machine, "transition_timeout_s", 0.4)
    try:
        group.enable()
    finally:
        for drive in group.drives:
            object.__setattr__(drive.setup.profile.state_machine, "transition_timeout_s", 1.0)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_an_axis_that_moves_while_its_brake_opens_stops_the_enabling(group, slaves, share):
    moved = round(share * BRAKE_DROP_REVOLUTIONS * TURN)

    def drop(can_id, data):
        real(can_id, data)
        if can_id == 0x080 and slaves[1].state == "operation enabled":
            slaves[1].position = slaves[1].values[0x607A, 0] - moved

    real, slaves[1].on_frame = slaves[1].on_frame, drop
    if share < 1:
        assert group.enable().complete
        return
    with pytest.raises(DriveFault, match=r"node 2:6064.*moves while its brake opens: 0\.2[78] motor") as caught:
        group.enable()
    assert caught.value.node == 2
    assert {slave.state for slave in slaves} == {OFF}


# -- what ends it ------------------------------------------------------------------------------------------------------


def test_a_drive_that_is_operational_and_does_not_answer_sync_is_named(group, slaves):
    slaves[1].tpdo_cut = 0
    with pytest.raises(IncompleteEpochs, match=r"node 2.*does not respond to SYNC \(\d+ sent\).*synchronous"):
        group.enable()
    assert enabling_words(slaves) == set()


def test_a_drive_that_goes_to_fault_before_the_first_word_is_led_nowhere(group, slaves):
    """No route leads out of FAULT, and the word that resets it is never sent."""
    plain = slaves[2].on_frame

    def on_frame(can_id, data):
        if can_id == 0x080:
            slaves[2].state = slaves[2].stuck_in = "fault"
        plain(can_id, data)

    slaves[2].on_frame = on_frame
    plain_get = slaves[2].get
    slaves[2].get = lambda address: 0x0208 if address == (0x6041, 0) and slaves[2].nmt == 5 else plain_get(address)
    with pytest.raises(DriveFault, match="node 3.*no route from FAULT"):
        group.enable()
    assert enabling_words(slaves) == set()
    assert all(not word & 0x80 for slave in slaves for word in slave.controlwords)


def test_a_drive_enabled_meanwhile_is_not_enabled_again(group, slaves):
    slaves[0].state = "operation enabled"
    with pytest.raises(DriveFault, match="node 1.*is energised: OPERATION ENABLED.*servo-gateway restore"):
        group.enable()
    slaves[0].state = "switch on disabled"
    assert enabling_words(slaves) == set()
