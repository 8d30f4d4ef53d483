"""Adapters that fail as python-can's backends report it: six backends, six faults, and a moving arm that loses its own.

The fakes behave as the sources of python-can 4.6 do: exceptions, texts, codes and rounded time-outs. Exceptions of
ixxat and pyserial are their base classes here, because both need not be installed.
"""

from __future__ import annotations

import errno
import math
from contextlib import suppress
from types import SimpleNamespace

import can
import pytest
from can.interfaces.pcan.pcan import PcanCanOperationError
from can.interfaces.vector.exceptions import VectorOperationError

from drives.bus import Bus, BusSpec, open_bus
from drives.drive import DriveCommand
from drives.errors import BusError, BusOff, IncompleteEpochs
from tests.drives.conftest import configured

BACKENDS = ("socketcan", "pcan", "kvaser", "slcan", "vector", "ixxat")
FAULTS = ("bus-off", "unplugged", "queue full", "error passive", "time-out", "stray")
#: Backends of which neither an exception nor the state shows that the controller is bus-off: sent frames pile up.
MUTE = ("kvaser", "slcan", "vector")
COUNT_RAD = 2 * math.pi / 65536


def caused(text, cause):
    error = can.CanOperationError(text)
    error.__cause__ = cause
    return error


def failed(text, code):
    return can.CanOperationError(text, code)


GONE = {
    "socketcan": failed("Error receiving: No such device", errno.ENODEV),
    "pcan": PcanCanOperationError("The value of a handle (PCAN-Channel, PCAN-Hardware) is invalid"),
    "kvaser": failed("Function canReadWait failed - Specified device not found", -15),
    "slcan": caused("Could not read from serial device", OSError(errno.EIO, "Input/output error")),
    "vector": VectorOperationError(129, "XL_ERR_HW_NOT_PRESENT", "xlReceive"),
    "ixxat": can.CanOperationError("function canChannelReadMessage failed (the device is gone)"),
}
FULL = {
    "socketcan": failed("Failed to transmit: No buffer space available", errno.ENOBUFS),
    "pcan": PcanCanOperationError("Failed to send: The transmit queue is full"),
    "kvaser": failed("Function canWrite failed - Transmit buffer overflow", -13),
    "slcan": caused("Could not write to serial device", OSError("Write timeout")),
    "vector": VectorOperationError(11, "XL_ERR_QUEUE_IS_FULL", "xlCanTransmit"),
    "ixxat": can.CanOperationError("function canChannelPostMessage failed (the transmit FIFO is full)"),
}
#: A frame or text that cannot be decoded, and what the backend raises for it.
STRAY = {each: can.CanOperationError("could not unpack received message") for each in BACKENDS}
STRAY["slcan"] = ValueError("invalid literal for int() with base 16: 'zz'")


class Adapter:
    """A backend on a wire: it fails from the moment in which `fault` is set."""

    def __init__(self, wire, interface):
        self.wire, self.interface, self.fault = wire, interface, ""
        self.receptions = self.acknowledgements = 0
        self.queued = 0
        self.reported = False

    def status(self):
        return 0x10 if self.fault == "bus-off" else 0

    @property
    def state(self):
        is_shown = self.interface == "ixxat" and self.fault == "bus-off"
        return can.BusState.ERROR if is_shown else can.BusState.ACTIVE

    def recv(self, timeout=None):
        self.receptions += 1
        once, self.reported = not self.reported, bool(self.fault)
        is_rounding = self.interface in ("kvaser", "vector", "ixxat", "pcan")
        waited_s = math.floor(timeout * 1e3) / 1e3 if is_rounding else timeout
        if self.fault == "unplugged":
            if self.interface == "socketcan" and not once:
                self.wire.sleep(waited_s)  # the socket reports it once
                return None
            raise GONE[self.interface]
        if self.fault == "stray" and once:
            raise STRAY[self.interface]
        if self.fault == "bus-off":
            if self.interface == "socketcan" and once:
                return can.Message(arbitration_id=0x040, data=bytes(8), is_extended_id=False, is_error_frame=True)
            self.wire.sleep(waited_s)
            if self.interface == "ixxat":
                raise can.CanOperationError("Error warning limit exceeded")
            return None
        if self.fault == "error passive" and once:
            if self.interface == "ixxat":
                raise can.CanOperationError("Error warning limit exceeded")
            if self.interface != "slcan":  # only SocketCAN gives the id of an error frame a meaning
                can_id = 0x004 if self.interface == "socketcan" else 0x040
                return can.Message(arbitration_id=can_id, is_extended_id=False, is_error_frame=True)
        if self.acknowledgements and timeout == 0.0:  # of slcan: no frame, and no time left to read what is behind
            self.acknowledgements -= 1
            return None
        return self.wire.recv(waited_s)

    def send(self, message, timeout=None):
        assert (timeout is not None) == (self.interface == "slcan"), "a serial port blocks, other backends wait"
        if self.fault == "unplugged":
            raise GONE[self.interface]
        self.queued += self.fault in ("bus-off", "queue full")
        if self.fault == "queue full" or self.queued > 16:
            raise FULL[self.interface]
        if not self.queued:
            self.wire.send(message)

    def shutdown(self):
        pass


@pytest.fixture
def adapter(wire, request):
    return Adapter(wire, request.param)


def until_error(bus, wire, sends=True):
    """What a master does, or one that only listens: it goes on until something is wrong; at most 1 s."""
    end_s = wire.now_s + 1.0
    while not bus.bus_off and wire.now_s < end_s:
        bus.receive(0.009)
        if sends:
            bus.send(0x080, b"")


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("adapter", BACKENDS, indirect=True)
def test_each_fault_of_each_backend_has_one_outcome(adapter, wire, fault):
    bus, began_s = Bus(adapter, BusSpec(adapter.interface, "channel7")), wire.now_s
    adapter.fault = fault
    if fault in ("error passive", "stray"):
        wire.emit(0x181, b"\x01")
        frame = bus.receive(0.01)
        assert frame is not None
        assert (frame.arbitration_id, bus.bus_off) == (0x181, False)
        assert sum(bus.counts.values()) == (0 if (adapter.interface, fault) == ("slcan", "error passive") else 1)
    elif fault == "time-out":
        for timeout_s in (0.0, 0.0004, 0.0094):
            began_s, adapter.receptions = wire.now_s, 0
            assert bus.receive(timeout_s) is None
            assert timeout_s <= wire.now_s - began_s < timeout_s + 0.0006
            assert adapter.receptions < 8
    elif fault == "bus-off" and adapter.interface not in MUTE:
        with suppress(BusOff):
            until_error(bus, wire)
        assert bus.bus_off
        assert wire.now_s - began_s < 1.0
    else:
        with pytest.raises(BusError, match=f"{adapter.interface}:channel7.*heartbeat stops") as caught:
            until_error(bus, wire, sends=fault != "unplugged")
        assert wire.now_s - began_s < 1.0
        assert isinstance(caught.value, BusOff) == (fault == "bus-off" and adapter.interface not in MUTE)


@pytest.mark.parametrize("adapter", ["socketcan", "pcan"], indirect=True)
def test_a_full_queue_of_a_controller_that_is_bus_off_is_named_bus_off(adapter, wire):
    bus = Bus(adapter, BusSpec(adapter.interface, "channel7"))
    adapter.fault, adapter.queued = "bus-off", 1 << 10
    with pytest.raises(BusOff):
        bus.send(0x201, b"")


@pytest.mark.parametrize("fault", ["unplugged", "bus-off"])
@pytest.mark.parametrize("adapter", BACKENDS, indirect=True)
def test_a_moving_arm_that_loses_its_adapter_ends_within_a_second(adapter, wire, add_slaves, setups, fault):
    add_slaves(6)
    bus = Bus(adapter, BusSpec(adapter.interface, "channel7"))
    with configured(bus, setups(6), 0.01, "real") as group:
        group.enable()

        def lose():
            for cycle in range(100):
                if cycle == 5:
                    adapter.fault, adapter.lost_s = fault, wire.now_s
                group.exchange([DriveCommand((each.target_count + 100) * COUNT_RAD) for each in group.drives])

        is_mute = fault == "bus-off" and adapter.interface in MUTE
        kind = BusOff if fault == "bus-off" and not is_mute else (BusError, IncompleteEpochs) if is_mute else BusError
        with pytest.raises(kind) as caught:
            lose()
        assert wire.now_s - adapter.lost_s < 1.0
        assert not group.enabled
        adapter.fault, adapter.queued = "", 0
        assert f"{adapter.interface}:channel7" in str(caught.value)
        assert "drives stop by themselves when the master's heartbeat stops" in str(caught.value)


def test_an_adapter_that_echoes_own_frames_is_known_by_its_options(wire):
    options = ({}, {"single_handle": True}, {"receive_own_messages": True}, {"single_handle": False})
    assert [Bus(wire, BusSpec("kvaser", "0", options=each)).echoes for each in options] == [False, True, True, False]


@pytest.mark.parametrize("adapter", ["slcan"], indirect=True)
def test_frames_behind_an_acknowledgement_are_read_before_the_next_sync(adapter, wire):
    bus, adapter.acknowledgements = Bus(adapter, BusSpec("slcan", "/dev/ttyACM0")), 3
    wire.emit(0x181, b"\x01")
    assert bus.drain() == 1


def test_queues_and_time_outs_suit_a_cycle(monkeypatch):
    opened = []
    monkeypatch.setattr(can, "Bus", lambda **options: opened.append(options) or SimpleNamespace(recv=None))
    for text in ("slcan:/dev/ttyACM0", "ixxat:0,tx_fifo_size=64"):
        open_bus(BusSpec.parse(text))
    assert opened[0]["timeout"] < 0.001
    assert (opened[1]["rx_fifo_size"], opened[1]["tx_fifo_size"]) == (1024, 64)
