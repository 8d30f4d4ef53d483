"""The master against a slave written by others (npm `canopen`): SDO, NMT, heartbeat, PDO, EMCY on the wire.

The expectations are the constants of `independent/slave.js` and CiA 301; nothing of this project is on the other end.
"""

from __future__ import annotations

import struct
import time
import uuid
from collections.abc import Callable, Iterator

import pytest

from drives.bus import Bus, BusSpec, open_bus
from drives.errors import SdoAbort, SdoTimeout
from drives.sdo import SdoClient
from tests.vcan.slave_process import PATIENCE, IndependentSlave

NODE = 5
MASTER = 127
PRE_OPERATIONAL, OPERATIONAL, STOPPED, BOOT_UP = 0x7F, 0x05, 0x04, 0x00


@pytest.fixture(params=["virtual", pytest.param("socketcan", marks=pytest.mark.vcan)])
def spec(request: pytest.FixtureRequest, slave_ready: None) -> BusSpec:
    if request.param == "socketcan":
        return BusSpec("socketcan", request.getfixturevalue("vcan"))
    return BusSpec("virtual", f"independent-{uuid.uuid4().hex}")


@pytest.fixture
def bus(spec: BusSpec) -> Iterator[Bus]:
    with open_bus(spec) as opened:
        yield opened


@pytest.fixture
def slave(spec: BusSpec, bus: Bus) -> Iterator[IndependentSlave]:
    with IndependentSlave(NODE, spec.interface, spec.channel) as running:
        yield running


@pytest.fixture
def sdo(bus: Bus, slave: IndependentSlave) -> Iterator[SdoClient]:
    client = SdoClient(bus, NODE, timeout_s=1.0 * PATIENCE)
    yield client
    client.close()


def frames(bus: Bus, can_id: int) -> tuple[list[bytes], Callable[[int, float], None]]:
    """A list that fills with the frames of an id, and a function that waits for so many of them."""
    seen: list[bytes] = []
    bus.subscribe(can_id, lambda _id, data, _time: seen.append(bytes(data)))

    def wait(count: int, timeout_s: float) -> None:
        deadline_s = time.monotonic() + timeout_s * PATIENCE
        while len(seen) < count and time.monotonic() < deadline_s:
            bus.listen(0.01)

    return seen, wait


def test_expedited_read_write_and_the_value_that_reads_back(sdo: SdoClient) -> None:
    assert sdo.upload(0x1000) == (0x00020192).to_bytes(4, "little")
    assert struct.unpack("<i", sdo.upload(0x6064)) == (-123456,)
    assert struct.unpack("<h", sdo.upload(0x6077)) == (-321,)
    sdo.download(0x607A, 0, struct.pack("<i", -77))
    assert struct.unpack("<i", sdo.upload(0x607A)) == (-77,)


def test_segmented_read_and_write(sdo: SdoClient) -> None:
    assert sdo.upload(0x1008) == b"a servo drive that others have written"
    text = b"0123456789" * 20
    sdo.download(0x2000, 0, text)
    assert sdo.upload(0x2000) == text


def test_aborts_are_typed_and_name_the_object(sdo: SdoClient) -> None:
    with pytest.raises(SdoAbort) as missing:
        sdo.upload(0x9999)
    assert (missing.value.node, missing.value.index, missing.value.code) == (NODE, 0x9999, 0x06020000)
    with pytest.raises(SdoAbort) as forbidden:
        sdo.download(0x6041, 0, b"\x00\x00")
    assert forbidden.value.code == 0x06010002
    assert sdo.upload(0x1000) == (0x00020192).to_bytes(4, "little")


def test_nmt_commands_show_in_the_heartbeat(bus: Bus, slave: IndependentSlave) -> None:
    seen, wait = frames(bus, 0x700 + NODE)
    for command, state in ((0x01, OPERATIONAL), (0x80, PRE_OPERATIONAL), (0x02, STOPPED)):
        bus.send(0x000, bytes([command, NODE]))
        for _ in range(20):
            wait(len(seen) + 1, 1.0)
            if seen[-1:] == [bytes([state])]:
                break
        assert seen[-1] == bytes([state])


def test_slave_watches_the_masters_heartbeat(bus: Bus, slave: IndependentSlave) -> None:
    bus.send(0x700 + MASTER, bytes([OPERATIONAL]))
    slave.wait_for(f"heartbeat {MASTER}", timeout_s=5.0)
    slave.wait_for(f"timeout {MASTER}", timeout_s=5.0)


def test_synchronous_pdos_go_round(bus: Bus, slave: IndependentSlave) -> None:
    seen, wait = frames(bus, 0x180 + NODE)
    bus.send(0x000, bytes([0x01, NODE]))
    bus.send(0x080, b"")
    wait(1, 2.0)
    assert struct.unpack("<Hih", seen[0]) == (0x0240, -123456, -321)
    bus.send(0x200 + NODE, struct.pack("<Hih", 0x000F, 1234, -5))
    bus.send(0x080, b"")
    wait(2, 2.0)
    assert struct.unpack("<Hih", seen[1]) == (0x020F, 1234, -321)


def test_emergency_arrives_whole(bus: Bus, sdo: SdoClient) -> None:
    seen, wait = frames(bus, 0x080 + NODE)
    bus.send(0x000, bytes([0x01, NODE]))
    sdo.download(0x2001, 0, struct.pack("<H", 0x3210))
    wait(1, 2.0)
    assert seen == [bytes([0x10, 0x32, 0x00, 1, 2, 3, 4, 5])]


def test_slave_that_dies_is_a_timeout_not_an_old_answer(bus: Bus, slave: IndependentSlave) -> None:
    client = SdoClient(bus, NODE, timeout_s=0.1 * PATIENCE)
    assert client.upload(0x1000)
    slave.kill()
    with pytest.raises(SdoTimeout):
        client.upload(0x1000)
    client.close()
