"""A measuring device beside the drives: frames packed and unpacked by hand, units compared, kinds refused."""

from __future__ import annotations

import struct
import threading
import uuid
from collections.abc import Callable, Iterator

import can
import canopen
import pytest

from drives import bringup
from drives.bus import Bus, BusSpec, open_bus
from drives.errors import ConfigurationRefused, DriveError, IdentityMismatch, NodeMissing
from drives.instrument import Instrument, InstrumentSetup
from drives.ledger import WriteLedger
from drives.nodes import GroupOptions, Nodes
from drives.values import AxisSetup
from sim.measuring import FakeMeasuringDevice, MeasuringSite

SETUP = InstrumentSetup(21, 0x9130, "i32", (1, 2, 3), 1e-6, status_index=0x6150)


@pytest.fixture
def ends() -> Iterator[tuple[str, FakeMeasuringDevice]]:
    """Channel of a bus on which a device at node 21 measures 1, 2 and 100 mm, and the device."""
    channel = uuid.uuid4().hex
    bus = can.Bus(interface="virtual", channel=channel)
    site = MeasuringSite(21, 0x9130, "i32", 0x6150, (1, 2, 3), 1e-6, (0.0, 0.05))
    device = FakeMeasuringDevice(site, lambda: [1e-3, 2e-3, 0.1], bus.send)
    network = canopen.Network(bus)
    device.node.associate_network(network)
    device.node.boot()
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            message = bus.recv(0.01)
            if message is not None and message.arbitration_id == 0x80:
                device.sync()
            elif message is not None:
                network.notify(message.arbitration_id, message.data, message.timestamp)

    thread = threading.Thread(target=serve, name="device")
    thread.start()
    yield channel, device
    ended.set()
    thread.join()
    device.node.remove_network()
    bus.shutdown()


def nodes_with(bus: Bus, setup: InstrumentSetup, setups: Callable[[int], list[AxisSetup]]) -> Nodes:
    """A measuring device that answers, without the drives."""
    nodes = Nodes(bus, setups(1), 0.004, options=GroupOptions(instruments=(setup,)))
    nodes.instruments = (Instrument(bus, setup, nodes.ledger),)
    return nodes


def test_values_then_status_fill_frames_of_eight_bytes() -> None:
    plans = SETUP.plans()
    assert [(plan.cob_id, plan.size_bytes) for plan in plans] == [(0x195, 8), (0x295, 7)]
    assert [entry.mapping for entry in plans[1].entries] == [0x91300320, 0x61500108, 0x61500208, 0x61500308]


def test_a_reading_is_of_one_sync_or_there_is_none(ends: tuple[str, FakeMeasuringDevice]) -> None:
    first, second = struct.pack("<ii", 20000, -5), struct.pack("<iBBB", 7, 0, 0, 0)

    with open_bus(BusSpec("virtual", ends[0])) as bus:
        instrument = Instrument(bus, SETUP, WriteLedger())
        reading = instrument.decode(9, [b"", first, second], 1)
        assert reading is not None
        assert (reading.sync_index, reading.raw) == (9, (20000, -5, 7))
        assert reading.values == pytest.approx((0.02, -5e-6, 7e-6))
        assert instrument.decode(9, [b"", None, second], 1) is None
        assert instrument.decode(9, [b"", first, None], 1) is None
        invalid = instrument.decode(9, [b"", first, struct.pack("<iBBB", 7, 0, 1, 4)], 1)
        assert invalid is not None
        assert invalid.values == (pytest.approx(0.02), None, None)

        instrument.access.sdo.close()


def test_what_is_mapped_is_what_the_device_sends(ends: tuple[str, FakeMeasuringDevice], setups) -> None:
    channel, device = ends
    with open_bus(BusSpec("virtual", channel)) as bus:
        nodes = nodes_with(bus, SETUP, setups)
        (instrument,), ledger = nodes.instruments, nodes.ledger
        bringup.configure(nodes)
        frames: dict[int, bytes] = {}
        for can_id, _ in instrument.answers:
            bus.subscribe(can_id, lambda can_id, data, _time_s: frames.__setitem__(can_id, bytes(data)))
        bus.send(0, bytes([1, 21]))
        bus.send(0x80, b"")
        bus.listen(0.2)
        reading = instrument.decode(1, [frames[can_id] for can_id, _ in instrument.answers], 0)
        assert reading is not None
        assert reading.values == (pytest.approx(1e-3), pytest.approx(2e-3), None)
        assert ledger.of_node(21)
        nodes.restore()
        assert not ledger.of_node(21)
        nodes.close()
    assert not any(tpdo.enabled for tpdo in device.tpdos)


@pytest.mark.parametrize(
    ("setup", "kind", "said"),
    [
        (InstrumentSetup(21, 0x9130, "i32", (1,), 1e-5), ConfigurationRefused, "the cell 1e-05 per bit"),
        (InstrumentSetup(21, 0x9130, "i32", (1,), 1e-6, unit=0x02), ConfigurationRefused, "says unit 0xfa010000"),
        (InstrumentSetup(21, 0x7130, "i16", (1,), 1e-6), DriveError, "object does not exist"),
    ],
)
def test_a_device_that_does_not_fit_is_refused(
    ends: tuple[str, FakeMeasuringDevice], setups, setup: InstrumentSetup, kind: type[DriveError], said: str
) -> None:
    with open_bus(BusSpec("virtual", ends[0])) as bus, pytest.raises(kind, match=said):
        bringup.configure(nodes_with(bus, setup, setups))


def test_a_missing_device_and_another_kind_of_device_are_refused(ends: tuple[str, FakeMeasuringDevice], setups) -> None:
    ends[1].store.constant((0x1000, 0), "u32", 0x0002_0192)
    absent = InstrumentSetup(22, 0x9130, "i32", (1,), 1e-6)
    with open_bus(BusSpec("virtual", ends[0])) as bus:
        nodes = Nodes(bus, setups(1), 0.004, options=GroupOptions(instruments=(SETUP, absent)))
        bringup.connect_for_restore(nodes)
        assert nodes.all == ()
    failures = {failure.node: failure for failure in nodes.failures_found}
    assert "not a CiA 404" in str(failures[21])
    assert isinstance(failures[21], IdentityMismatch)
    assert isinstance(failures[22], NodeMissing)


def test_nine_channels_do_not_fit() -> None:
    with pytest.raises(ConfigurationRefused, match="9 channels need 5 TPDOs"):
        InstrumentSetup(21, 0x9130, "i32", tuple(range(1, 10)), 1e-6).plans()
