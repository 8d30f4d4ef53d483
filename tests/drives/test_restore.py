"""Whose original a ledger entry is, and what restore leaves: exchanged drives, other buses, bus errors, refusals."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable

import can
import pytest

from drives import bringup
from drives.bus import Bus, BusSpec
from drives.configuration.applying import NodeWrites, write_all
from drives.errors import ConfigurationRefused, DriveError, IdentityMismatch
from drives.files import replace_file
from drives.group import DriveGroup, GroupOptions
from drives.ledger import KnownDevice, LedgerEntry, WriteLedger
from drives.pdo import Step
from drives.values import AxisSetup

TORQUE = (0x6072, 0)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.json"


@pytest.fixture
def group_of(bus, generic, path) -> Callable[..., DriveGroup]:
    def group(limit_nm: float | None = None, nodes: tuple[int, ...] = (1,), on: Bus = bus) -> DriveGroup:
        setups = [AxisSetup(node, generic, 0.5, 300.0, torque_limit_nm=limit_nm) for node in nodes]
        return DriveGroup(on, setups, 0.01, "lockstep", options=GroupOptions(ledger_path=path))

    return group


@pytest.fixture
def drive(make_slave, wire):
    """A drive with a torque limit; a second call takes the first one off the wire."""

    def add(serial: int = 111, torque: int = 3000):
        wire.slaves.clear()
        slave = make_slave(1, serial)
        slave.types[TORQUE], slave.values[TORQUE] = "u16", torque
        return slave

    return add


def run(group: DriveGroup) -> None:
    with group:
        group.connect()
        group.configure()


def restored(group: DriveGroup) -> None:
    with group:
        group.connect()
        group.restore()


@pytest.mark.parametrize("node", [1, 2])
def test_a_consumer_time_that_another_tool_wrote_after_a_run_stays(make_slave, group_of, path, node):
    slaves = [make_slave(each) for each in (1, 2)]
    with group_of(nodes=(1, 2)) as group:
        group.connect()
        group.configure()
        group.enable()
        group.disable()
        assert not any(entry.open for entry in WriteLedger(path).entries)
    slaves[node - 1].values[0x1016, 1] = 0x7F0064
    restored(group_of(nodes=(1, 2)))
    assert slaves[node - 1].values[0x1016, 1] == 0x7F0064


def test_the_limit_of_an_exchanged_drive_is_its_own_original(drive, group_of):
    run_in = drive()
    run(group_of(2.0))
    assert run_in.values[TORQUE] == 1000
    successor = drive(222, 800)
    run(group_of(2.0))
    assert successor.values[TORQUE] == 800, "never raised"
    run(group_of(1.0))
    assert successor.values[TORQUE] == 500
    with pytest.raises(IdentityMismatch, match=r"node 1.*serial number 111, here is 222.*--forget"):
        restored(group_of())
    assert successor.values[TORQUE] == 800
    drive(111, 1000)
    restored(group_of())


def test_a_limit_set_by_another_master_is_a_new_original(drive, group_of):
    slave = drive()
    run(group_of(1.0))
    slave.values[TORQUE] = 800
    run(group_of(2.0))
    assert slave.values[TORQUE] == 800
    restored(group_of())
    assert slave.values[TORQUE] == 800


def test_config_apply_waits_for_restore_and_its_values_are_then_the_original(drive, group_of):
    slave = drive()
    run(group_of(1.0))

    def apply() -> None:
        with group_of() as group:
            group.connect()
            step = Step(*TORQUE, "u16", 800, "config apply: 1.dcf")
            write_all([NodeWrites(group.drives[0].access, (step,))])

    with pytest.raises(ConfigurationRefused, match=r"node 1.*6072:00.*servo-gateway restore CELL"):
        apply()
    assert slave.values[TORQUE] == 500
    restored(group_of())
    apply()
    restored(group_of())
    assert slave.values[TORQUE] == 3000, "before a run restore takes it back"
    apply()
    run(group_of(2.0))
    assert slave.values[TORQUE] == 800, "never raised"
    run(group_of(1.0))
    restored(group_of())
    assert slave.values[TORQUE] == 800


def test_a_config_apply_that_was_cut_off_is_not_driven_on(drive, group_of):
    slave = drive()

    class PowerCut(BaseException):
        pass

    def interrupted(group: DriveGroup) -> None:
        group.connect()
        access = group.drives[0].access
        access.note_steps(
            [Step(*TORQUE, "u16", 800, "config apply"), Step(0x6007, 0, "i16", 2, "config apply")], "applying"
        )
        access.write_step(Step(*TORQUE, "u16", 800, "config apply"))
        raise PowerCut

    with group_of() as group, pytest.raises(PowerCut):
        interrupted(group)
    with pytest.raises(ConfigurationRefused, match="was interrupted"):
        run(group_of(2.0))
    assert slave.values[TORQUE] == 800
    restored(group_of())
    assert slave.values[TORQUE] == 3000


def test_two_drives_have_both_a_complete_configuration_or_both_a_part_of_one(add_slaves, group_of, path, monkeypatch):
    """A power cut after `config apply` wrote to both drives, before or within the marking of their entries."""
    slaves = add_slaves(2)
    for slave in slaves:
        slave.types[TORQUE], slave.values[TORQUE] = "u16", 3000

    class PowerCut(BaseException):
        pass

    def cut(ledger: WriteLedger, change: object = None) -> None:
        if calls:
            raise PowerCut
        calls.append(change)
        settle(ledger, change)

    settle, calls = WriteLedger.settle, []
    with group_of(nodes=(1, 2)) as group:
        group.connect()
        steps = (Step(*TORQUE, "u16", 800, "config apply: 1.dcf"),)
        monkeypatch.setattr(WriteLedger, "settle", cut)
        with contextlib.suppress(PowerCut):
            write_all([NodeWrites(drive.access, steps) for drive in group.drives])
    monkeypatch.undo()
    assert {entry.writer for entry in WriteLedger(path).entries} == {"applied"}


def test_no_drive_is_configured_on_top_of_a_config_apply_that_another_drive_has_a_part_of(add_slaves, group_of, path):
    slaves = add_slaves(2)
    for slave in slaves:
        slave.types[TORQUE], slave.values[TORQUE] = "u16", 3000
    step = Step(*TORQUE, "u16", 800, "config apply: 1.dcf")
    with group_of(nodes=(1, 2)) as group:
        group.connect()
        write_all([NodeWrites(group.drives[0].access, (step,))])
        group.drives[1].access.note_steps([step], "applying")
    with pytest.raises(ConfigurationRefused, match=r"node 2.*was interrupted"):
        run(group_of(nodes=(1, 2)))
    restored(group_of(nodes=(1, 2)))
    assert [slave.values[TORQUE] for slave in slaves] == [3000, 3000]


@pytest.mark.parametrize("frames", [3, 6, 20, 60, 90])
def test_a_bus_error_in_the_middle_of_restore_loses_nothing(wire, add_slaves, group_of, path, frames):
    slaves = add_slaves(2)
    run(group_of(nodes=(1, 2)))
    original = {(each.node_id, *each.address): each.old for each in WriteLedger(path).entries}
    real, left = wire.send, [frames]

    def send(message, timeout=None):
        left[0] -= 1
        if left[0] < 0:
            raise can.CanOperationError("Failed to transmit: No such device")
        real(message, timeout)

    with group_of(nodes=(1, 2)) as group:
        group.connect()
        wire.send = send
        with pytest.raises(DriveError):
            group.restore()
        wire.send = real
    kept = {(each.node_id, *each.address) for each in WriteLedger(path).entries}
    assert kept, "not everything was put back"
    for (node, *address), old in original.items():
        if not (0x1600 <= address[0] < 0x1C00 and address[1]):
            assert slaves[node - 1].get(tuple(address)) == old or (node, *address) in kept


def test_a_drive_that_acknowledges_and_ignores_stays_in_the_ledger(drive, group_of, path):
    slave = drive()
    run(group_of(1.0))
    real, kept = slave.on_frame, slave.values[TORQUE]

    def ignoring(can_id, data):
        real(can_id, data)
        slave.values[TORQUE] = kept

    slave.on_frame = ignoring
    with pytest.raises(ConfigurationRefused, match="6072:00.*0x1f4 is read back"):
        restored(group_of())
    assert [entry.address for entry in WriteLedger(path).entries] == [TORQUE]
    slave.on_frame = real
    restored(group_of())
    assert slave.values[TORQUE] == 3000
    assert WriteLedger(path).entries == ()


def test_a_write_that_the_drive_refused_needs_no_restore(drive, group_of, path):
    slave = drive()
    slave.refuses_write = lambda address, data: 0x06090030 if address == TORQUE else 0
    with pytest.raises(DriveError, match="6072:00"):
        run(group_of(1.0))
    restored(group_of())
    assert WriteLedger(path).entries == ()


def test_a_missing_drive_does_not_keep_the_others_from_being_put_back(add_slaves, group_of, path):
    slaves = add_slaves(2)
    run(group_of(nodes=(1, 2)))
    slaves[1].alive = False
    with group_of(nodes=(1, 2)) as group:
        bringup.connect_for_restore(group)
        (absent,) = group.failures_found
        assert absent.node == 2
        group.restore()
        assert {entry.node_id for entry in group.noted} == {2}
    assert slaves[0].values[0x6007, 0] == 1


def test_entries_are_found_from_another_spelling_of_the_bus_and_not_on_another_bus():
    def device(text: str, serial: int | None = 5, node: int = 3) -> KnownDevice:
        return KnownDevice(node, BusSpec.parse(text).name, 2, 7, 1, serial)

    def entry(of: KnownDevice) -> LedgerEntry:
        numbers = {"vendor_id": of.vendor_id, "product_code": of.product_code, "revision": of.revision, "bus": of.bus}
        return LedgerEntry(of.node_id, *TORQUE, "u16", 3000, 500, "run", of.serial_number, **numbers)

    multicast = entry(device("udp_multicast:239.74.163.2"))
    assert multicast.is_of(device("udp_multicast:239.74.163.2,port=43113,hop_limit=0"))
    assert not multicast.is_of(device("udp_multicast:239.74.163.2,port=43114")), "simulated drives share serial numbers"
    assert not multicast.is_of(device("udp_multicast:239.74.163.2", serial=6))
    wired = entry(device("socketcan:can0"))
    assert wired.is_of(device("slcan:/dev/ttyACM0", node=9)), "the drive is the same at any adapter and node id"
    unnumbered = entry(device("socketcan:can0", serial=None))
    assert unnumbered.is_of(device("socketcan:can0", serial=None))
    assert not unnumbered.is_of(device("socketcan:can1", serial=None))
    assert not unnumbered.is_of(device("socketcan:can0", serial=None, node=4))


def test_two_ledgers_of_one_file_keep_each_others_entries(path):
    first, second = WriteLedger(path), WriteLedger(path)
    first.note(LedgerEntry(1, *TORQUE, "u16", 1, 2, "one", 11))
    second.note(LedgerEntry(2, *TORQUE, "u16", 1, 2, "two", 22))
    first.forget(*first.of_node(1))
    assert [entry.serial_number for entry in WriteLedger(path).entries] == [22]


def test_a_file_is_replaced_without_following_a_planted_link_and_keeps_its_mode(tmp_path):
    other, target = tmp_path / "other", tmp_path / "a.json"
    other.write_text("precious")
    (tmp_path / ".a.json.tmp").symlink_to(other)
    target.write_text("old")
    target.chmod(0o640)
    replace_file(target, "new")
    assert (other.read_text(), target.read_text(), target.stat().st_mode & 0o777) == ("precious", "new", 0o640)


def test_a_pipe_is_not_turned_into_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="only a regular file is replaced"):
        replace_file(tmp_path / "pipe", "text")
    assert (tmp_path / "pipe").is_fifo()
    assert [each.name for each in tmp_path.iterdir()] == ["pipe"]


def test_a_drive_without_serial_number_at_a_renamed_adapter_is_refused_until_a_person_identifies_it(
    wire, generic, path, drive
):
    """Its lowered torque limit would count as its original; an equal drive that was never written is not concerned."""
    slave = drive(serial=0)

    def at(channel: str, action: Callable[[DriveGroup], object]) -> None:
        with Bus(wire, BusSpec("slcan", channel)) as bus:
            wire.shutdown = lambda: None
            setups = [AxisSetup(1, generic, 0.5, 300.0, torque_limit_nm=1.0)]
            with DriveGroup(bus, setups, 0.01, options=GroupOptions(ledger_path=path)) as group:
                group.connect()
                action(group)

    def taken_over(group: DriveGroup) -> None:
        access = group.drives[0].access
        access.take_over(group.ledger.of_other_bus(access.device))
        group.restore()
        assert group.noted == ()

    at("/dev/ttyACM0", DriveGroup.configure)
    assert slave.values[TORQUE] == 500
    with pytest.raises(ConfigurationRefused, match=r"holds 0x\w+, which a run wrote over slcan:/dev/ttyACM0"):
        at("/dev/ttyACM1", DriveGroup.configure)
    equal = drive(serial=0)
    at("/dev/ttyACM1", DriveGroup.configure)
    assert equal.values[TORQUE] == 500
    at("/dev/ttyACM1", DriveGroup.restore)
    assert equal.values[TORQUE] == 3000
    wire.slaves.clear()
    wire.slaves.append(slave)
    at("/dev/ttyACM1", taken_over)
    assert slave.values[TORQUE] == 3000
