"""The master's services against a drive on another stack (`durand`): SDO, NMT, heartbeat, PDO, EMCY on the wire.

The expectations are CiA 301 and the constants of `tests/support/independent_drive`; nothing of this project is on the
other end.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator

import pytest

from drives.bus import Bus, BusSpec, open_bus
from drives.errors import SdoAbort, SdoTimeout
from drives.sdo import SdoClient
from tests.support.independent_drives import PATIENCE, IndependentDrives
from tests.vcan.independent.conftest import VARIANTS, on_buses

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
NODES = (NODE,) = (5,)
MASTER = 127
PRE_OPERATIONAL, OPERATIONAL, STOPPED = 0x7F, 0x05, 0x04
#: 0 rad of the first axis, whose motor turns 100 times as much and counts 65536 to a turn.
POSITION = 0
#: Bit 12 of the statusword: the drive follows its targets; in mode 7 "ip mode active".
ACTIVE = 0x1000
SWITCH_ON_DISABLED, READY = 0x0250, 0x0231


@pytest.fixture
def opened(drives: IndependentDrives) -> Iterator[Bus]:
    with open_bus(BusSpec.parse(drives.bus)) as opened:
        yield opened


@pytest.fixture
def sdo(opened: Bus) -> Iterator[SdoClient]:
    client = SdoClient(opened, NODE, timeout_s=1.0 * PATIENCE)
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


def map_pdo(sdo: SdoClient, communication: int, cob_id: int, entries: tuple[int, ...]) -> None:
    """One synchronous PDO, in the order of CiA 301."""
    mapping = communication + 0x200
    sdo.write(communication, 1, "u32", cob_id | 1 << 31)
    sdo.write(communication, 2, "u8", 1)
    sdo.write(mapping, 0, "u8", 0)
    for number, entry in enumerate(entries, start=1):
        sdo.write(mapping, number, "u32", entry)
    sdo.write(mapping, 0, "u8", len(entries))
    sdo.write(communication, 1, "u32", cob_id)


both = on_buses(VARIANTS, ["zero-extended"])
one = on_buses(["zero-extended"], ["zero-extended"])


@both
def test_expedited_read_write_and_the_value_that_reads_back(sdo: SdoClient) -> None:
    assert sdo.read(0x1000, 0, "u32") == 0x0002_0192
    assert sdo.read(0x6064, 0, "i32") == POSITION
    for index, data_type, value in ((0x607A, "i32", -77), (0x60B2, "i16", -321), (0x60C2, "i8", -3)):
        subindex = 2 if index == 0x60C2 else 0
        before = sdo.read(index, subindex, data_type)
        sdo.write(index, subindex, data_type, value)
        assert sdo.read(index, subindex, data_type) == value
        sdo.write(index, subindex, data_type, before)


@both
def test_segmented_read_and_write(sdo: SdoClient) -> None:
    assert sdo.read_text(0x1008) in ("AXD-40", "SVC-8")
    text = b"0123456789" * 20
    sdo.download(0x2000, 0, text)
    assert sdo.upload(0x2000) == text


@both
def test_aborts_are_typed_and_name_the_object(sdo: SdoClient) -> None:
    with pytest.raises(SdoAbort) as missing:
        sdo.upload(0x9999)
    assert (missing.value.node, missing.value.index, missing.value.code) == (NODE, 0x9999, 0x06020000)
    with pytest.raises(SdoAbort) as forbidden:
        sdo.download(0x6041, 0, b"\x00\x00")
    assert forbidden.value.code == 0x06010002
    with pytest.raises(SdoAbort) as unknown:
        sdo.write(0x6060, 0, "i8", 1)
    assert unknown.value.code == 0x06090030
    assert sdo.read(0x1000, 0, "u32") == 0x0002_0192


@one
def test_nmt_commands_show_in_the_heartbeat(opened: Bus, drives: IndependentDrives) -> None:
    seen, wait = frames(opened, 0x700 + NODE)
    for command, state in ((0x01, OPERATIONAL), (0x02, STOPPED), (0x80, PRE_OPERATIONAL)):
        opened.send(0x000, bytes([command, NODE]))
        for _ in range(20):
            wait(len(seen) + 1, 1.0)
            if seen[-1:] == [bytes([state])]:
                break
        assert seen[-1] == bytes([state])


@one
def test_a_mapping_changes_only_while_its_pdo_is_off(sdo: SdoClient) -> None:
    map_pdo(sdo, 0x1800, 0x180 + NODE, (0x60410010,))
    with pytest.raises(SdoAbort) as refused:
        sdo.write(0x1A00, 0, "u8", 0)
    assert (refused.value.index, refused.value.code) == (0x1A00, 0x08000022)


@one
def test_a_synchronous_rpdo_takes_effect_with_sync_and_a_tpdo_samples_before(sdo: SdoClient, opened: Bus) -> None:
    map_pdo(sdo, 0x1800, 0x180 + NODE, (0x60410010, 0x60640020, 0x60770010))
    map_pdo(sdo, 0x1400, 0x200 + NODE, (0x60400010, 0x607A0020, 0x60B20010))
    seen, wait = frames(opened, 0x180 + NODE)
    opened.send(0x000, bytes([0x01, NODE]))
    opened.send(0x200 + NODE, struct.pack("<Hih", 0x0006, 1234, -5))
    assert sdo.read(0x6041, 0, "u16") == SWITCH_ON_DISABLED
    assert sdo.read(0x607A, 0, "i32") == 0
    opened.send(0x080, b"")
    wait(1, 2.0)
    assert struct.unpack("<Hih", seen[0]) == (SWITCH_ON_DISABLED, POSITION, 0)
    assert sdo.read(0x607A, 0, "i32") == 1234
    opened.send(0x080, b"")
    wait(2, 2.0)
    assert struct.unpack("<Hih", seen[1]) == (READY, POSITION, 0)


@on_buses(["interpolated"])
def test_an_interpolating_drive_follows_its_records_with_bit_4_alone(sdo: SdoClient, opened: Bus) -> None:
    map_pdo(sdo, 0x1800, 0x180 + NODE, (0x60410010, 0x60640020))
    map_pdo(sdo, 0x1400, 0x200 + NODE, (0x60400010, 0x60C10120))
    sdo.write(0x6060, 0, "i8", 7)
    opened.send(0x000, bytes([0x01, NODE]))
    seen, _ = frames(opened, 0x180 + NODE)

    def cycles(controlword: int, record: int, count: int = 20) -> tuple[int, int]:
        for _ in range(count):
            opened.send(0x200 + NODE, struct.pack("<Hi", controlword, record))
            opened.send(0x080, b"")
            opened.listen(0.01)
        statusword, position = struct.unpack("<Hi", seen[-1])
        return statusword & (ACTIVE | 0x6F), position

    for controlword in (0x06, 0x07):
        cycles(controlword, POSITION, 2)
    assert cycles(0x0F, 2000) == (0x27, pytest.approx(POSITION, abs=20))
    assert cycles(0x1F, 2000) == (0x27 | ACTIVE, pytest.approx(2000, abs=20))
    with pytest.raises(SdoAbort):
        sdo.write(0x60C2, 1, "u8", 4)
    assert cycles(0x0F, POSITION) == (0x27, pytest.approx(2000, abs=20))
    assert cycles(0x00, POSITION)[0] == 0x40


@one
def test_loss_of_the_watched_heartbeat_is_an_emergency_and_disables(sdo: SdoClient, opened: Bus) -> None:
    seen, wait = frames(opened, 0x080 + NODE)
    sdo.write(0x6040, 0, "u16", 0x0006)
    assert sdo.read(0x6041, 0, "u16") == READY
    sdo.write(0x6007, 0, "i16", 2)
    sdo.write(0x1016, 1, "u32", MASTER << 16 | 200)
    opened.listen(0.3)
    assert seen == []  # the time counts from the first heartbeat
    opened.send(0x700 + MASTER, bytes([OPERATIONAL]))
    wait(1, 2.0)
    assert seen == [bytes([0x30, 0x81, 0x11, MASTER, 0, 0, 0, 0])]
    assert sdo.read(0x6041, 0, "u16") == SWITCH_ON_DISABLED
    assert sdo.read(0x1003, 1, "u32") == 0x8130
    sdo.write(0x1016, 1, "u32", 0)


@one
def test_drive_that_dies_is_a_timeout_not_an_old_answer(opened: Bus, drives: IndependentDrives) -> None:
    """The last test of these drives."""
    client = SdoClient(opened, NODE, timeout_s=0.1 * PATIENCE)
    assert client.upload(0x1000)
    drives.kill()
    with pytest.raises(SdoTimeout):
        client.upload(0x1000)
    client.close()
