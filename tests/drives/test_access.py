"""Writing to a node: only what may be written, entered before, read back after, and put back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest

from drives.access import NodeAccess
from drives.bringup import set_mode, settle_sync_period
from drives.errors import ConfigurationRefused, SdoAbort, SdoProtocolError, SdoTimeout, SeveralFailures
from drives.files import replace_file
from drives.group import DriveGroup, GroupOptions
from drives.ledger import LedgerEntry, WriteLedger
from drives.objects import OBJECTS
from tests.drives.conftest import Slave, configured

MODE = OBJECTS["mode"]


@pytest.fixture
def slave(make_slave: Callable[..., Slave]) -> Slave:
    return make_slave(3)


@pytest.fixture
def ledger() -> WriteLedger:
    return WriteLedger()


@pytest.fixture
def access(bus, slave, ledger) -> Iterator[NodeAccess]:
    node = NodeAccess(bus, 3, "test", (0x6060, 0x6007), ledger)
    yield node
    node.sdo.close()


def test_only_what_is_allowed_is_written(access, slave):
    with pytest.raises(ConfigurationRefused, match=r"3:607A:00.*profile test does not allow it.*write\.allow"):
        access.write(OBJECTS["target_position"], 1, "for fun")
    assert slave.written == []


@pytest.mark.parametrize(("taken", "times"), [(True, 1), (False, 2)])
def test_a_write_whose_answer_stays_away_is_repeated_only_if_it_is_not_there(access, slave, taken, times):
    """The drive took the value and its answer was lost; or the request was lost."""
    asked = []

    def reply(request: bytes, answer: bytes) -> list[tuple[float, bytes]]:
        if request[0] & 0xE0 != 0x20:
            return [(0.001, answer)]
        asked.append(request)
        if len(asked) > 1:
            return [(0.001, answer)]
        if not taken:
            slave.values[0x6060, 0] = 0
        return []

    slave.reply = reply
    access.write(MODE, 8, "a mode")
    assert slave.values[0x6060, 0] == 8
    assert len(asked) == times


def test_an_object_that_is_not_there_is_none_and_any_other_refusal_an_error(access, slave):
    assert access.read_optional(OBJECTS["torque_demand"]) is None
    slave.refused[0x6060, 0] = 0x08000022
    with pytest.raises(SdoAbort, match="0x08000022"):
        access.read_optional(MODE)


def test_a_value_that_does_not_fit_its_type_is_not_sent(access, slave):
    with pytest.raises(SdoProtocolError, match="200 is no i8"):
        access.write(MODE, 200, "too large")
    assert slave.written == []


def test_a_mode_that_is_shown_with_delay_is_waited_for_and_one_that_is_not_shown_refused(bus, add_slaves, setups):
    """Generic profile: 1 s."""
    (slave,) = add_slaves(1)
    with DriveGroup(bus, setups(1), 0.004) as group:
        group.connect()
        plain, start = slave.get, slave.wire.now_s
        shown_after_s = 0.5

        def get(address: tuple[int, int]) -> int:
            if address == (0x6061, 0):
                return 8 if slave.wire.now_s - start > shown_after_s else 1
            return plain(address)

        slave.get = get  # type: ignore[method-assign]
        set_mode(group.drives[0], 0.004)
        assert slave.wire.now_s - start == pytest.approx(0.5, abs=0.05)
        start, shown_after_s = slave.wire.now_s, 5.0
        with pytest.raises(ConfigurationRefused, match="shows mode 1 instead of 8"):
            set_mode(group.drives[0], 0.004)
        assert slave.wire.now_s - start == pytest.approx(1.0, abs=0.05)


# -- PDOs --------------------------------------------------------------------------------------------------------------


def test_a_drive_whose_pdos_are_fixed_is_refused(bus, add_slaves, setups):
    """It confirms every write and changes nothing."""
    (slave,) = add_slaves(1)
    plain = slave.on_frame

    def deaf(can_id: int, data: bytes) -> None:
        plain(can_id, data)
        slave.values[0x1A00, 1] = 0x60640020

    slave.on_frame = deaf  # type: ignore[method-assign]
    slave.values[0x1A00, 1] = 0x60640020
    with DriveGroup(bus, setups(1), 0.004) as group:
        group.connect()
        with pytest.raises(ConfigurationRefused, match="TPDO1.*after it was written.*may be fixed"):
            group.configure()


def test_mapping_entries_that_do_not_exist_yet_were_nothing(bus, add_slaves, setups):
    """A drive with an empty mapping may have no entries to read (CiA 301, 0x1A00: sub-index 0 says how many)."""
    (slave,) = add_slaves(1)

    def reply(request: bytes, answer: bytes) -> list[tuple[float, bytes]]:
        index, reads = request[1] | request[2] << 8, request[0] & 0xE0 == 0x40
        if reads and index in (0x1600, 0x1A00, 0x1A01) and request[3] > slave.values[index, 0]:
            answer = b"\x80" + request[1:4] + bytes.fromhex("11000906")
        return [(0.001, answer)]

    slave.reply = reply
    before = {address: value for address, value in slave.values.items() if address[0] in (0x1A00, 0x1600)}
    with configured(bus, setups(1), 0.004) as group:
        assert group.enable().complete
        group.disable()
        group.restore()
    assert {address: slave.values[address] for address in before if address[1] <= 1} == {
        address: value for address, value in before.items() if address[1] <= 1
    }


@pytest.mark.parametrize("writable", [True, False])
@pytest.mark.parametrize(("found_us", "refused"), [(0, False), (4000, False), (8000, True)])
def test_a_drive_that_supervises_sync_expects_what_comes(bus, make_slave, ledger, writable, found_us, refused):
    slave = make_slave(3)
    slave.types[0x1006, 0], slave.values[0x1006, 0] = "u32", found_us
    access = NodeAccess(bus, 3, "test", (0x1006,) if writable else (), ledger)
    if refused and not writable:
        with pytest.raises(ConfigurationRefused, match="SYNC every 8000 us, the master sends one every 4000 us"):
            settle_sync_period(SimpleNamespace(access=access), 0.004)
    else:
        settle_sync_period(SimpleNamespace(access=access), 0.004)
        assert slave.values[0x1006, 0] == (0 if writable else found_us)
    access.sdo.close()


# -- putting back ------------------------------------------------------------------------------------------------------


def test_what_cannot_be_put_back_stays_in_the_ledger_and_is_named(bus, add_slaves, setups, tmp_path):
    slaves = add_slaves(2)
    with configured(bus, setups(2), 0.004, options=GroupOptions(tmp_path / "ledger.json")) as group:
        slaves[1].refused[0x6060, 0] = 0x08000022
        with pytest.raises(SdoAbort, match="node 2:6060:00"):
            group.restore()
        assert [(entry.node_id, entry.index) for entry in group.ledger.entries] == [(2, 0x6060)]
        slaves[1].refused.clear()
        group.restore()
        assert group.ledger.entries == ()
    assert slaves[1].values[0x6060, 0] == 0


def test_a_drive_that_stays_enabled_is_not_put_back(bus, add_slaves, setups):
    slaves = add_slaves(2)
    with configured(bus, setups(2), 0.004) as group:
        slaves[0].state = slaves[0].stuck_in = "operation enabled"
        written = len(slaves[0].written)
        with pytest.raises(SeveralFailures, match="node 1.*stays in OPERATION ENABLED.*emergency stop") as refused:
            group.restore()
        assert "node 1: is enabled: its objects are not restored" in str(refused.value)
        assert {index for index, _, _ in slaves[0].written[written:]} == {0x6040}
        assert {entry.node_id for entry in group.ledger.entries} == {1}
        slaves[0].state = "switch on disabled"


def test_drives_that_do_not_answer_are_named_together(bus, add_slaves, setups):
    slaves = add_slaves(3)
    with configured(bus, setups(3), 0.004) as group:
        for slave in slaves[:2]:
            slave.alive = False
        with pytest.raises(SeveralFailures, match="nodes 1, 2:.*no SDO answer") as caught:
            group.restore()
        assert {error.node for error in caught.value.failures} == {1, 2}
        assert all(isinstance(error, SdoTimeout) for error in caught.value.failures)


def test_an_entry_in_words():
    entry = LedgerEntry(3, 0x6060, 0, "i8", 0, 8, "mode cyclic")
    assert str(entry) == "node 3:6060:00 (mode): 0x0 -> 0x8 (mode cyclic)"


def test_entries_of_one_node_leave_with_it(ledger):
    one, two = (LedgerEntry(node, 0x6060, 0, "i8", 0, 8, "mode") for node in (1, 2))
    ledger.note(one, two)
    assert ledger.of_node(2) == (two,)
    ledger.forget(one)
    assert ledger.entries == (two,)


# -- files -------------------------------------------------------------------------------------------------------------


def test_a_file_that_cannot_be_replaced_stays_as_it_was_and_nothing_is_left_beside_it(tmp_path, monkeypatch):
    path = tmp_path / "folder" / "a.json"
    replace_file(path, "old")
    replace_file(path, b"older")
    assert path.read_bytes() == b"older"

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OSError, match="No space"):
        replace_file(path, "new")
    assert [(each.name, each.read_bytes()) for each in path.parent.iterdir()] == [("a.json", b"older")]
