"""Drives that keep to the letter of CiA 301, each configured and enabled: what other stacks refuse or insist on."""

from __future__ import annotations

import struct

import pytest

from drives.bringup import set_interpolation_period
from drives.discovery import FREE_S, nmt_states
from drives.errors import (
    ConfigurationRefused,
    DriveFault,
    HeartbeatLost,
    NodeMissing,
    NotOperational,
)
from drives.group import DriveGroup
from drives.heartbeat import NmtState
from drives.profile_file import load_profile
from drives.values import AxisSetup
from tests.drives.conftest import Slave, configured

PERIOD_S = 0.004
BOTH = pytest.mark.parametrize("pacing", ["lockstep", "real"])


@pytest.fixture
def slaves(add_slaves):
    return add_slaves(2)


def enabled(bus, setups, pacing="lockstep"):
    """A group whose drives are up and have followed a few SYNCs; to be closed."""
    group = DriveGroup(bus, setups, PERIOD_S, pacing)
    group.connect()
    group.configure()
    group.enable()
    for _ in range(5):
        assert group.hold().complete
    return group


def put(slave, address, kind, value):
    slave.types[address], slave.values[address] = kind, value


@BOTH
def test_a_slave_that_aborts_a_written_inhibit_time(bus, slaves, setups, pacing):
    """CANopenNode: 0x06090030 while the PDO exists."""
    slaves[0].strict_inhibit = True
    enabled(bus, setups(2), pacing).close()
    assert slaves[0].values[0x1800, 3] == 300
    assert not [write for write in slaves[0].written if write[:2] in ((0x1800, 3), (0x1801, 3))]


@BOTH
def test_a_slave_that_refuses_start_until_its_communication_error_is_gone(bus, slaves, setups, wire, pacing):
    slaves[1].communication_error_until_s = wire.now_s + FREE_S + 1.2
    enabled(bus, setups(2), pacing).close()
    started = [data for can_id, data in wire.sent if can_id == 0 and data == b"\x01\x02"]
    assert 2 <= len(started) <= 8


def says_why(slave, wire, clears):
    """Let a slave say by an emergency why it refuses START, and when it no longer does if `clears`."""
    take = slave.on_frame
    said = []

    def on_frame(can_id, data):
        if can_id == 0x000 and data[1] in (0, slave.node_id):
            refused = data[0] == 1 and wire.now_s < slave.communication_error_until_s
            if refused or (said and clears and data[0] == 1):
                slave.emergency(bytes.fromhex("008111" if refused else "000000"))
            said[:] = [True] if refused else []
        take(can_id, data)

    slave.on_frame = on_frame


@BOTH
def test_a_refused_start_that_was_said_to_be_over_is_no_reason_to_stop(bus, slaves, setups, wire, pacing):
    slaves[1].communication_error_until_s = wire.now_s + FREE_S + 0.5
    says_why(slaves[1], wire, clears=True)
    group = enabled(bus, setups(2), pacing)
    assert [each.code for each in group.statistics.emcy][-2:] == [0x8100, 0]
    group.close()


def test_a_refused_start_that_was_not_said_to_be_over_is(bus, slaves, setups, wire):
    slaves[1].communication_error_until_s = wire.now_s + FREE_S + 0.5
    says_why(slaves[1], wire, clears=False)
    with pytest.raises(DriveFault, match="0x8100") as caught:
        enabled(bus, setups(2))
    assert caught.value.node == 2


@pytest.mark.parametrize("profile", ["generic-cia402", "kollmorgen-akd-x00606"])
def test_a_slave_that_never_starts_is_named_with_its_state(bus, slaves, wire, profile):
    """With a heartbeat that the profile asks for, and without one: by its missing answer to SYNC."""
    slaves[1].communication_error_until_s = wire.now_s + FREE_S + 1e9
    for slave in slaves:
        slave.values[0x1018, 1] = 0x6A
        slave.values[0x1017, 0] = 100
    setups = [AxisSetup(node, load_profile(profile), 0.5, 300.0) for node in (1, 2)]
    with configured(bus, setups, PERIOD_S, "real") as group:
        start_s = wire.now_s
        with pytest.raises(NotOperational, match=r"PREOPERATIONAL.*0x1029.*0x1006") as caught:
            group.enable()
        assert caught.value.node == 2
        assert 2.0 < wire.now_s - start_s < 3.5
    assert {word & 0x08 for slave in slaves for word in slave.controlwords} <= {0}


def test_a_drive_whose_heartbeat_never_comes_is_not_enabled(bus, slaves, setups):
    slaves[0].beats = False
    sends_none = pytest.raises(HeartbeatLost, match="node 1:1017.*sends no heartbeat")
    with configured(bus, setups(2), PERIOD_S) as group, sends_none:
        group.enable()
    assert slaves[0].controlwords.count(0x0F) == 0


@BOTH
def test_a_slave_that_waits_for_sync(bus, slaves, setups, pacing):
    """0x1006 = 1 ms: it falls out of OPERATIONAL with every SYNC that comes later."""
    put(slaves[0], (0x1006, 0), "u32", 1000)
    group = enabled(bus, setups(2), pacing)
    assert slaves[0].values[0x1006, 0] == 0
    assert slaves[0].communication_errors == 0
    group.disable()
    group.restore()
    group.close()
    assert slaves[0].values[0x1006, 0] == 1000


def test_a_slave_that_does_not_take_zero_gets_our_period(bus, slaves, setups):
    put(slaves[0], (0x1006, 0), "u32", 1000)
    slaves[0].refuses_write = lambda *write: 0x06090032 if write == ((0x1006, 0), bytes(4)) else 0
    with configured(bus, setups(2), PERIOD_S, "real"):
        pass
    assert slaves[0].values[0x1006, 0] == 4000


def test_another_sync_period_that_must_not_be_written_is_refused(bus, slaves, generic):
    put(slaves[0], (0x1006, 0), "u32", 1000)
    write = generic.write.model_copy(update={"allow": tuple(i for i in generic.write.allow if i != 0x1006)})
    setups = [AxisSetup(node, generic.model_copy(update={"write": write}), 0.5, 300.0) for node in (1, 2)]
    with DriveGroup(bus, setups, PERIOD_S) as group:
        group.connect()
        with pytest.raises(ConfigurationRefused, match="node 1:1006.*every 1000 us.*4000 us"):
            group.configure()
        slaves[0].values[0x1006, 0] = 4000
        group.configure()


@BOTH
@pytest.mark.parametrize("address", [(0x1019, 0), (0x1014, 0), (0x60C2, 1), (0x1006, 0), (0x1402, 1)])
def test_a_slave_without_data_in_an_optional_object(bus, slaves, setups, pacing, address):
    slaves[0].refused[address] = 0x08000024
    enabled(bus, setups(2), pacing).close()


@BOTH
@pytest.mark.parametrize(("option", "in_run"), [(0, 2), (1, 1), (2, 2), (3, 3), (4, 2), (5, 2), (6, 2), (-1, 2)])
def test_a_quick_stop_option_that_does_not_end_disabled_is_replaced_for_the_run(
    bus, slaves, setups, pacing, option, in_run
):
    put(slaves[1], (0x605A, 0), "i16", option)
    group = enabled(bus, setups(2), pacing)
    assert slaves[1].values[0x605A, 0] == in_run
    group.disable()
    group.restore()
    group.close()
    assert slaves[1].values[0x605A, 0] == option


def test_a_drive_that_keeps_another_quick_stop_option_is_refused_by_name(bus, slaves, setups):
    put(slaves[1], (0x605A, 0), "i16", 6)
    slaves[1].refuses_write = lambda address, data: 0x06010002 if address == (0x605A, 0) else 0
    with DriveGroup(bus, setups(2), PERIOD_S) as group:
        group.connect()
        with pytest.raises(ConfigurationRefused, match=r"node 2:605A.*holds 6 and refuses 2.*SWITCH ON DISABLED"):
            group.configure()


class Interpolating(Slave):
    """A drive that applies an interpolation period once both subindices of 0x60C2 were sent, and may refuse some.

    Attributes
    ----------
    fixed : int or None
        The only exponent that it takes; any write of another one is aborted with `refusal`, of itself too if read-only.
    """

    fixed: int | None = None
    refusal = 0x06090030
    applied_s = 0.0

    def power_up(self, value: int, exponent: int) -> None:
        self.values[0x60C2, 1], self.values[0x60C2, 2] = value, exponent
        self.applied_s, self.sent_subindices = value * 10.0**exponent, set()

    def refuses_write(self, address: tuple[int, int], data: bytes) -> int:
        if address[0] == 0x60C2:
            self.sent_subindices.add(address[1])
            (sent,) = struct.unpack_from("<b" if address[1] == 2 else "<B", data)
            if address[1] == 2 and self.fixed is not None and (sent != self.fixed or self.refusal == 0x06010002):
                return self.refusal
            if self.sent_subindices == {1, 2}:
                value, exponent = ({1: self.values[0x60C2, 1], 2: self.values[0x60C2, 2]} | {address[1]: sent}).values()
                self.applied_s = value * 10.0**exponent
        return 0


@pytest.mark.parametrize("period_ms", [4, 10, 20])
@pytest.mark.parametrize("found", [(1, -3), (0, -3), (8, -3), (10, -3), (1, -2), (100, -4)])
@pytest.mark.parametrize("fixed", [None, 0x06090030, 0x06010002], ids=["any exponent", "-3 only", "-3 read-only"])
def test_the_interpolation_period_is_applied_in_the_exponent_that_the_drive_takes(
    bus, wire, setups, period_ms, found, fixed
):
    slave = Interpolating(wire, 1)
    wire.slaves.append(slave)
    slave.fixed, slave.refusal = (None, 0) if fixed is None else (-3, fixed)
    slave.power_up(found[0], -3 if fixed else found[1])
    with configured(bus, setups(1), period_ms / 1000.0, "real") as group:
        assert slave.applied_s == pytest.approx(period_ms / 1000.0)
        assert slave.values[0x60C2, 1] * 10.0 ** slave.values[0x60C2, 2] == pytest.approx(period_ms / 1000.0)
        if fixed or found[1] == -3:
            assert (slave.values[0x60C2, 1], slave.values[0x60C2, 2]) == (period_ms, -3)
        group.restore()
        assert slave.values[0x60C2, 1] == found[0]


def test_an_axis_whose_interpolation_period_was_left_at_another_one_is_not_enabled(bus, slaves, setups):
    """The timing test changes it, and its drive may refuse to take the period of the cell back."""
    with configured(bus, setups(2), PERIOD_S, "real") as group:
        set_interpolation_period(group.drives[1], 0.010)
        with pytest.raises(ConfigurationRefused, match=r"node 2:60C2.*interpolates over 0\.01 s.*every 0\.004 s"):
            group.enable()
        assert not any(slave.state == "operation enabled" for slave in slaves)
        set_interpolation_period(group.drives[1], PERIOD_S)
        group.configure()
        group.enable()


@BOTH
def test_a_slave_with_tpdo3_on_at_5_khz(bus, slaves, setups, pacing):
    slaves[0].add_pdo(0x1802, 0x1A02, 0x40000381, [0x60410010])
    group = enabled(bus, setups(2), pacing)
    assert slaves[0].values[0x1802, 1] & 1 << 31
    before = bus.counts["unclaimed"]
    for _ in range(20):
        group.hold()
    assert bus.counts["unclaimed"] == before
    assert tuple(map(str, group.left_pdos)) == ()
    group.disable()
    group.restore()
    group.close()
    assert slaves[0].values[0x1802, 1] == 0x40000381


@BOTH
def test_a_slave_with_a_foreign_emergency_id(bus, slaves, setups, pacing):
    put(slaves[1], (0x1014, 0), "u32", 0x0B5)
    group = enabled(bus, setups(2), pacing)
    slaves[1].state = "fault"
    slaves[1].emergency(bytes.fromhex("1186 21"))
    with pytest.raises(DriveFault, match="node 2.*following error too large"):
        group.hold()
    assert [message.node_id for message in group.statistics.emcy] == [2]
    group.close()


@pytest.mark.parametrize("cob_id", [0x80000082, 0x200000B5, 0x080, 0x181, 0x081])
def test_emergencies_that_would_not_be_received_are_refused(bus, slaves, setups, cob_id):
    """Switched off, 29 bits, the SYNC's, that of a TPDO, that of another drive."""
    put(slaves[1], (0x1014, 0), "u32", cob_id)
    with (
        DriveGroup(bus, setups(2), PERIOD_S) as group,
        pytest.raises(ConfigurationRefused, match="node 2:1014") as caught,
    ):
        group.connect()
    assert "set 0x1014 to 0x82" in str(caught.value)


# -- NMT state STOPPED ------------------------------------------------------------------------------------------------


def test_a_node_that_stays_stopped_is_called_stopped(bus, slaves, setups):
    slaves[1].nmt, slaves[1].takes_nmt = 4, False
    slaves[1].values[0x1017, 0] = 1000
    with DriveGroup(bus, setups(2), PERIOD_S) as group, pytest.raises(NodeMissing) as caught:
        group.connect()
    assert "is in NMT state STOPPED" in str(caught.value)
    assert "80 02" in caught.value.advice
    assert "power" not in caught.value.advice


def test_nmt_states_are_received_without_a_message(bus, slaves, wire):
    slaves[0].nmt, slaves[0].values[0x1017, 0] = 4, 500
    slaves[1].nmt, slaves[1].values[0x1017, 0] = 5, 500
    assert nmt_states(bus, [1, 2, 3], 0.6) == {1: NmtState.STOPPED, 2: NmtState.OPERATIONAL, 3: None}
    assert wire.sent == []
