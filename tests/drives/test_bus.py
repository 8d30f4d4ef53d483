"""The bus: configuration, the receive path, other masters, send failures, life."""

from __future__ import annotations

import socket
import struct
import threading

import can
import pytest

from drives.bus import Bus, BusSpec, open_bus
from drives.errors import BusError
from sim.cellfile import CellBus
from sim.simulation import open_bus as open_simulated

GROUP = "239.74.163.2"
IP_RECVTTL = 12  # of Linux; not in Python's `socket`


def test_a_bus_in_words_of_the_command_line():
    spec = BusSpec.parse("udp_multicast:239.74.163.2,port=43113")
    assert (spec.interface, spec.channel, spec.options) == ("udp_multicast", "239.74.163.2", {"port": 43113})
    assert str(spec) == "udp_multicast:239.74.163.2,port=43113"
    assert BusSpec.parse("socketcan:can0,bitrate=500000").bitrate_bit_s == 500_000
    assert BusSpec.parse("virtual:cell,receive_own_messages=true").options == {"receive_own_messages": True}


@pytest.mark.parametrize(
    "text", ["", "virtual", "virtual:", ":cell", "virtual:a,port", "virtual:a,=3", "x:y,bitrate=0"]
)
def test_a_bus_that_is_not_understood(text):
    with pytest.raises(BusError, match="does not have the form|positive integer") as caught:
        BusSpec.parse(text)
    assert caught.value.exit_code == 4


@pytest.mark.parametrize("text", ["nonsense:can0", "socketcan:can77", "udp_multicast:239.74.163.2,port=no"])
def test_a_bus_that_cannot_be_opened_says_what_to_do(text):
    with pytest.raises(BusError, match="cannot be opened"):
        open_bus(BusSpec.parse(text))


@pytest.mark.parametrize(("options", "hops"), [({}, 0), ({"hop_limit": 1}, 1)])
def test_multicast_frames_leave_this_computer_only_where_they_are_given_a_hop(options, hops):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        options = {"port": probe.getsockname()[1]} | options
    simulated = open_simulated(CellBus("udp_multicast", GROUP, 1_000_000, 0.01, "real", options))
    with (
        open_bus(BusSpec("udp_multicast", GROUP, options=options)) as bus,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener,
    ):
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        listener.bind((GROUP, options["port"]))
        membership = struct.pack("4sI", socket.inet_aton(GROUP), socket.INADDR_ANY)
        listener.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        listener.setsockopt(socket.IPPROTO_IP, IP_RECVTTL, 1)
        listener.settimeout(1.0)
        bus.send(0x181, b"\x01\x02")
        assert bytes(simulated.recv(1.0).data) == b"\x01\x02"
        simulated.send(can.Message(arbitration_id=0x201, is_extended_id=False))
        notes = [listener.recvmsg(4096, 64)[1] for _ in range(2)]
        assert notes == [[(socket.IPPROTO_IP, socket.IP_TTL, struct.pack("i", hops))]] * 2
    simulated.shutdown()


def test_frames_pass_between_two_buses_without_a_thread():
    before = threading.active_count()
    with open_bus(BusSpec("virtual", "pass")) as left, open_bus(BusSpec("virtual", "pass")) as right:
        seen = []
        right.subscribe(0x181, lambda can_id, data, time_s: seen.append((can_id, bytes(data))))
        left.send(0x181, b"\x01\x02")
        right.drain()
        assert seen == [(0x181, b"\x01\x02")]
        assert threading.active_count() == before


def test_a_closed_bus_says_so():
    bus = open_bus(BusSpec("virtual", "closed"))
    bus.close()
    bus.close()
    with pytest.raises(BusError, match="closed"):
        bus.send(0x181, b"")
    with pytest.raises(BusError, match="closed"):
        bus.receive(0.0)


def test_many_own_frames_may_be_in_transit_at_once(bus, wire):
    """NMT commands to every node of a large bus, before the first of them is received."""
    wire.echo = bus.echoes = True
    for node_id in range(1, 100):
        bus.send(0x000, bytes([1, node_id]))
    bus.drain()
    assert bus.foreign == {}


@pytest.mark.parametrize("echo", [False, True])
def test_own_frames_are_distinguished_from_another_masters(bus, wire, echo):
    wire.echo = bus.echoes = echo
    for _ in range(20):
        bus.send(0x080, b"")
        bus.drain()
    assert bus.foreign == {}
    wire.emit(0x080, b"")
    wire.emit(0x000, b"\x01\x00")
    bus.drain()
    assert bus.foreign == {0x080: 1, 0x000: 1}


@pytest.mark.parametrize(
    ("can_id", "masters"),
    [(0x000, 1), (0x080, 1), (0x601, 1), (0x67F, 1), (0x600, 0), (0x680, 0), (0x581, 0), (0x5FF, 0), (0x081, 0)],
)
def test_only_what_a_master_sends_is_another_masters(bus, wire, can_id, masters):
    """CiA 301, predefined connection set: NMT, SYNC, and SDO requests to nodes 1 to 127; answers are the nodes'."""
    wire.emit(can_id, bytes(8))
    bus.drain()
    assert (bus.foreign[can_id], bus.foreign_count) == (masters, masters)


def test_a_full_transmit_queue_is_waited_for(bus, wire):
    wire.send_errors = 3
    bus.send(0x201, b"")
    assert wire.sent == [(0x201, b"")]
    assert bus.counts["send_retries"] == 3


def test_a_transmit_queue_that_stays_full_is_an_error_in_bounded_time(bus, wire):
    wire.send_errors = 1 << 30
    start = wire.now_s
    with pytest.raises(BusError, match="201 could not be sent.*Transmit buffer full.*txqueuelen"):
        bus.send(0x201, b"")
    assert wire.now_s - start < 0.03


def test_bus_off_is_seen(bus, wire):
    wire.emit(0x004, b"\0" * 8, is_error_frame=True)
    bus.drain()
    assert not bus.bus_off
    wire.emit(0x040, b"\0" * 8, is_error_frame=True)
    bus.drain()
    assert bus.bus_off


def test_stray_datagrams_are_counted_and_a_dead_adapter_is_an_error_in_bounded_time(wire):
    stray, received = iter(range(5)), wire.recv

    def recv(timeout=None):
        for _ in stray:
            raise can.CanOperationError("could not unpack received message")
        return received(timeout)

    def gone(timeout=None):
        raise can.CanOperationError("no answer of the driver")

    wire.recv = recv
    bus = Bus(wire, BusSpec("test", "broken"))
    assert bus.receive(0.0) is None
    assert bus.counts["malformed"] == 5
    wire.recv, start = gone, wire.now_s
    with pytest.raises(BusError, match="test:broken: receiving failed"):
        Bus(wire, BusSpec("test", "broken")).receive(10.0)
    assert wire.now_s - start < 0.6


def test_stray_datagrams_far_apart_are_never_an_error(wire):
    """One a second on a bus on which nothing else comes: between two of them receiving has succeeded."""
    is_stray, received = iter([True, False] * 100), wire.recv

    def recv(timeout=None):
        if next(is_stray):
            raise can.CanOperationError("could not unpack received message")
        return received(timeout)

    wire.recv = recv
    with Bus(wire, BusSpec("test", "wire")) as bus:
        for _ in range(100):
            assert bus.receive(1.0) is None
        assert bus.counts["malformed"] == 100


@pytest.mark.parametrize("kind", [ValueError, AttributeError, OSError, can.CanOperationError, struct.error])
def test_whatever_a_backend_raises_is_a_frame_that_is_counted_or_a_bus_error(wire, kind):
    """slcan raises ValueError on one bad character, pyserial its own errors, an unplugged adapter OSError."""
    good, raised = wire.recv, iter([kind("invalid literal")])

    def recv(timeout=None):
        for error in raised:
            raise error
        return good(timeout)

    wire.recv = recv
    with Bus(wire, BusSpec("test", "wire")) as bus:
        wire.emit(0x181, b"\x01")
        frame = bus.receive(0.01)
        assert frame is not None
        assert (frame.arbitration_id, bus.counts["malformed"]) == (0x181, 1)

        def gone(*arguments, **named):
            raise kind("no such device")

        wire.send = gone
        start = wire.now_s
        with pytest.raises(BusError, match="201 could not be sent.*no such device"):
            bus.send(0x201, b"")
        assert wire.now_s - start < 0.03
    wire.recv = gone
    with pytest.raises(BusError, match="receiving failed.*no such device"):
        Bus(wire, BusSpec("test", "wire")).receive(10.0)


def test_an_adapter_that_cannot_be_shut_down_does_not_hide_what_went_wrong_before(wire):
    def gone():
        raise OSError(5, "Input/output error")

    wire.shutdown = gone
    with pytest.raises(BusError, match="the first error"), Bus(wire, BusSpec("test", "wire")) as bus:
        raise BusError("the first error")
    assert bus.counts["shutdown_failed"] == 1
    with pytest.raises(BusError, match="closed"):
        bus.send(0x201, b"")


def test_what_an_interface_raises_when_it_is_opened_is_a_bus_error(monkeypatch):
    def failing(**options):
        raise IndexError("no adapter found")

    monkeypatch.setattr(can, "Bus", failing)
    with pytest.raises(BusError, match="cannot be opened: no adapter found"):
        open_bus(BusSpec("pcan", "PCAN_USBBUS1"))


def test_a_listener_that_raises_is_left_out_and_delays_no_frame(bus, wire):
    received_ids = []

    def broken(frame, received):
        received_ids.append(frame)
        raise OSError(28, "No space left on device")

    bus.add_tap(broken)
    for _ in range(3):
        bus.send(0x201, b"")
        wire.emit(0x181, b"")
        assert bus.receive(0.01) is not None
    assert (len(received_ids), bus.counts["taps_failed"]) == (1, 1)


@pytest.mark.parametrize("flag", ["is_error_frame", "is_remote_frame", "is_extended_id"])
@pytest.mark.parametrize("timeout_s", [0.0, 0.01, 0.1])
def test_a_deadline_is_a_deadline_whatever_else_comes(wire, flag, timeout_s):
    """An odd frame every 0.3 ms, for ever: fewer than the 3 s and 9194 frames that 10 ms took once."""

    def storm(timeout=None):
        wire.now_s += 0.0003
        return can.Message(arbitration_id=0x20, data=bytes(8), **{"is_extended_id": False, flag: True})

    wire.recv = storm
    bus, start = Bus(wire, BusSpec("test", "wire")), wire.now_s
    assert bus.receive(timeout_s) is None
    assert wire.now_s - start <= timeout_s + 64 * 0.00031
    assert 0 < sum(bus.counts.values()) <= timeout_s / 0.0003 + 65


def test_an_adapter_that_fails_does_not_extend_the_deadline(wire):
    def failing(timeout=None):
        wire.now_s += 0.001
        raise can.CanOperationError("broken")

    wire.recv = failing
    bus, start = Bus(wire, BusSpec("test", "wire")), wire.now_s
    assert bus.receive(0.1) is None
    assert wire.now_s - start <= 0.102


def test_a_good_frame_among_odd_ones_is_received(bus, wire):
    for _ in range(20):
        wire.emit(0x020, bytes(8), is_error_frame=True)
    wire.emit(0x181, b"\x01")
    frame = bus.receive(0.0)
    assert frame is not None
    assert frame.arbitration_id == 0x181


def test_frames_without_end_do_not_block_the_reading_of_what_has_arrived(wire):
    def flood(timeout=None):
        wire.now_s += 0.0001
        return can.Message(arbitration_id=0x7FF, data=bytes(8), is_extended_id=False)

    wire.recv = flood
    bus, start = Bus(wire, BusSpec("test", "wire")), wire.now_s
    assert bus.drain() > 100
    assert wire.now_s - start < 0.06


@pytest.mark.parametrize(
    ("interface", "stamped"),
    [*((each, True) for each in ("socketcan", "udp_multicast", "virtual")), ("pcan", False), ("slcan", False)]
    + [(each, False) for each in ("kvaser", "vector", "ixxat")],
)
def test_stamps_of_hardware_with_a_clock_of_its_own_are_not_compared_with_ours(wire, interface, stamped):
    assert Bus(wire, BusSpec(interface, "x")).stamped == stamped
