"""Configuration files in the small: values of every type, short forms of sheets, order of writes, what is undone."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from unittest.mock import Mock

import pytest
from canopen.objectdictionary import datatypes, import_od

from drives.access import ObjectAccess
from drives.configuration.applying import NodeWrites, planned_writes, questions, require_at_rest, write_all
from drives.configuration.dcf import beyond_limits, dcf_text, read_dcf
from drives.configuration.difference import Readout, compare, differing, read_drive
from drives.configuration.kinds import confirmation_reason, kind_of, mapped_objects, why_never_written
from drives.datasheet.building import read_sheet
from drives.datasheet.object_values import decoded, encoded, ledger_value, understood, written
from drives.datasheet.sheet import SheetObject
from drives.errors import ConfigurationRefused, DriveFault, ProfileError, SdoAbort, SdoTimeout, SeveralFailures
from drives.ledger import KnownDevice, WriteLedger
from drives.profile import DriveProfile
from tests.drives.conftest import Slave

SHEET = """[DeviceInfo]
VendorName=a maker
VendorNumber=0x1234
ProductNumber=0x5678

[OptionalObjects]
SupportedObjects=2
1=0x2000
2=0x2001

"""
SITE = (KnownDevice(3, serial_number=0x51), "cell main J3", 500_000, "a")
MOMENT = datetime(2024, 2, 3, 14, 5, tzinfo=UTC)

VALUES = [
    (datatypes.BOOLEAN, 1, b"\x01"),
    (datatypes.INTEGER8, -2, b"\xfe"),
    (datatypes.INTEGER16, -300, struct.pack("<h", -300)),
    (datatypes.INTEGER24, -70_000, (-70_000).to_bytes(3, "little", signed=True)),
    (datatypes.INTEGER64, -(1 << 40), struct.pack("<q", -(1 << 40))),
    (datatypes.UNSIGNED16, 65_000, struct.pack("<H", 65_000)),
    (datatypes.UNSIGNED32, 0x8000_0183, struct.pack("<I", 0x8000_0183)),
    (datatypes.UNSIGNED64, 1 << 60, struct.pack("<Q", 1 << 60)),
    (datatypes.REAL32, struct.unpack("<f", struct.pack("<f", 0.1))[0], struct.pack("<f", 0.1)),
    (datatypes.REAL64, 0.1, struct.pack("<d", 0.1)),
    (datatypes.VISIBLE_STRING, "axis 3, left", b"axis 3, left"),
    (datatypes.OCTET_STRING, b"\x00\xff\x10", b"\x00\xff\x10"),
]


def objects(*lines: tuple[int, int, str]) -> str:
    """Sections of objects 2000, 2001, .. by type and further keys."""
    return "".join(
        f"[{index:04X}]\nParameterName=p{index:04X}\nObjectType=0x7\nDataType=0x{kind:04X}\n"
        f"AccessType=rw\nPDOMapping=0\n{more}\n\n"
        for index, kind, more in lines
    )


@pytest.mark.parametrize(("kind", "value", "wire"), VALUES)
def test_a_value_of_every_type_comes_back_from_wire_file_and_an_independent_reader(tmp_path, kind, value, wire):
    assert decoded(kind, wire) == value
    assert encoded(kind, value) == wire
    assert understood(kind, written(kind, value), 3) == value
    sheet = tmp_path / "maker.eds"
    sheet.write_text(SHEET + objects((0x2000, kind, "DefaultValue="), (0x2001, datatypes.UNSIGNED8, "")))
    path = tmp_path / "3.dcf"
    path.write_text(dcf_text(sheet, {(0x2000, 0): value}, MOMENT, *SITE))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        independent = import_od(str(path))
    assert independent[0x2000].value == value
    assert (independent.node_id, independent.bitrate) == (3, 500_000)
    assert read_dcf(path, 3).values == {(0x2000, 0): value}


def test_a_number_below_zero_may_stand_as_twos_complement_and_an_identifier_by_node():
    assert understood(datatypes.INTEGER16, "0xFFFE", 1) == -2
    assert understood(datatypes.UNSIGNED32, "$NODEID+0x180", 5) == 0x185
    assert understood(datatypes.REAL32, "0.1", 1) == struct.unpack("<f", struct.pack("<f", 0.1))[0]
    with pytest.raises(ValueError, match="is no u8"):
        understood(datatypes.UNSIGNED8, "256", 1)


def test_the_ledger_takes_numbers_and_the_bits_of_floats():
    assert ledger_value(datatypes.INTEGER64, -5) == ("i64", -5)
    assert ledger_value(datatypes.REAL32, 1.5) == ("u32", 0x3FC00000)
    assert ledger_value(datatypes.VISIBLE_STRING, "x") is None
    assert ledger_value(datatypes.UNSIGNED24, 5) is None


def test_an_array_in_short_form_has_every_element_in_the_file(tmp_path):
    """CompactSubObj (CiA 306): one section stands for all elements; names are in a section of their own."""
    sheet = tmp_path / "maker.eds"
    sheet.write_text(
        SHEET.replace("SupportedObjects=2", "SupportedObjects=1").replace("2=0x2001\n", "")
        + "[2000]\nParameterName=gain\nObjectType=0x8\nDataType=0x0006\nAccessType=rw\nDefaultValue=7\n"
        + "PDOMapping=0\nCompactSubObj=3\n\n[2000Name]\nNrOfEntries=1\n2=middle\n"
    )
    found = read_sheet(sheet)
    assert [found.entries[0x2000, sub].name for sub in range(4)] == ["Number of entries", "gain1", "middle", "gain3"]
    path = tmp_path / "3.dcf"
    path.write_text(dcf_text(sheet, {(0x2000, sub): 10 * sub for sub in (1, 2, 3)}, MOMENT, *SITE))
    file = read_dcf(path, 3)
    assert file.values == {(0x2000, 1): 10, (0x2000, 2): 20, (0x2000, 3): 30}
    assert file.defaults[0x2000, 3] == 7
    path.write_text(path.read_text().replace("[2000sub3]", "[2001]"))
    with pytest.raises(ProfileError, match="1 elements of 2000"):
        read_dcf(path, 3)


def test_a_file_with_several_faults_names_them_all(tmp_path):
    sheet = tmp_path / "3.dcf"
    lines = [(0x2000, datatypes.UNSIGNED8, "HighLimit=3"), (0x2001, datatypes.UNSIGNED8, "ParameterValue=nine")]
    sheet.write_text(dcf_text(_written(tmp_path, lines), {(0x2000, 0): 4}, MOMENT, *SITE))
    text = sheet.read_text().replace("[2001]\n", "[2001]\nParameterValue=nine\n")
    sheet.write_text(text)
    with pytest.raises(ProfileError) as caught:
        read_dcf(sheet, 3)
    assert len(caught.value.lines) == 2
    assert "2000:00: 4 is above its HighLimit 3" in str(caught.value)
    assert "2001:00: 'nine' is not a value" in str(caught.value)


def _written(folder: Path, lines: list[tuple[int, int, str]]) -> Path:
    path = folder / "maker.eds"
    path.write_text(SHEET + objects(*lines))
    return path


# ------------------------------------------------------------------------------------------------ what is configuration


@pytest.mark.parametrize(
    ("index", "access", "mappable", "kind"),
    [
        (0x6065, "rw", False, "configuration"),
        (0x6081, "rww", True, "configuration"),
        (0x2005, "rw", True, "process"),
        (0x6040, "rww", True, "process"),
        (0x6064, "ro", True, "actual"),
        (0x603F, "rw", False, "actual"),
        (0x1018, "ro", False, "fixed"),
        (0x6502, "const", False, "fixed"),
        (0x1010, "rw", False, "command"),
        (0x2006, "wo", False, "write only"),
    ],
)
def test_what_an_object_is(index, access, mappable, kind):
    entry = SheetObject(index, 0, "x", access_type=access, pdo_mappable=mappable)
    carried = mapped_objects({(0x1400, 1): 0x201, (0x1600, 0): 1, (0x1600, 1): 0x20050010, (0x1600, 2): 0x60810020})
    assert carried == {(0x2005, 0)}
    assert mapped_objects({(0x1400, 1): 0x8000_0201, (0x1600, 0): 1, (0x1600, 1): 0x20050010}) == frozenset()
    assert kind_of(entry, carried) == kind


@pytest.mark.parametrize("index", [0x1018, 0x1200, 0x1301, 0x13FF, 0x6640, 0x1010, 0x1011])
def test_safety_identity_and_commands_are_never_written(generic, index):
    assert why_never_written((index, 1), generic) is not None
    assert why_never_written((0x6065, 0), generic) is None


# --------------------------------------------------------------------------------------------------------- written


@pytest.fixture
def slave(make_slave: Callable[..., Slave]) -> Slave:
    slave = make_slave(3)
    for index, sub, kind, value in ((0x607D, 1, "i32", -10), (0x607D, 2, "i32", 10), (0x6065, 0, "u32", 100)):
        slave.types[index, sub], slave.values[index, sub] = kind, value
    return slave


@pytest.fixture
def ledger(tmp_path) -> WriteLedger:
    return WriteLedger(tmp_path / "ledger.json")


@pytest.fixture
def access(bus, slave, generic, ledger):
    node = ObjectAccess(bus, 3, generic, ledger)
    yield node
    node.sdo.close()


def planned(access: ObjectAccess, profile: DriveProfile, tmp_path: Path, wanted: dict) -> NodeWrites:
    """Dump, change values, compare, plan."""
    assert profile.eds_path is not None
    found = read_drive(access, read_sheet(profile.eds_path))
    path = tmp_path / "3.dcf"
    path.write_text(dcf_text(profile.eds_path, found.of_kind("configuration", "fixed") | wanted, MOMENT, *SITE))
    file = read_dcf(path, 3)
    rows = compare(file, found)
    assert {row.address for row in differing(rows)} == set(wanted)
    return planned_writes(access, file, found, rows)


def test_only_what_differs_is_written_and_each_write_is_entered_before(access, slave, generic, tmp_path, ledger):
    work = planned(access, generic, tmp_path, {(0x6065, 0): 90, (0x6007, 0): 2})
    entered = []
    reply = slave.reply

    def watched(request, answer):
        if request[0] & 0xE0 == 0x20:
            address = (request[1] | request[2] << 8, request[3])
            entered.append(address in {(entry.index, entry.subindex) for entry in ledger.entries})
        return reply(request, answer)

    slave.reply = watched
    write_all([work])
    assert slave.written == [(0x6007, 0, 2), (0x6065, 0, 90)]
    assert entered == [True, True]
    assert {(entry.index, entry.old, entry.new) for entry in ledger.entries} == {(0x6007, 1, 2), (0x6065, 100, 90)}
    assert access.restore() == []
    assert (slave.values[0x6065, 0], slave.values[0x6007, 0]) == (100, 1)


def test_limits_that_move_beyond_the_old_ones_are_written_in_an_order_that_a_drive_takes(
    access, generic, tmp_path, slave
):
    assert [step.subindex for step in planned(access, generic, tmp_path, LIMITS_UP).steps] == [2, 1]
    assert [step.subindex for step in planned(access, generic, tmp_path, LIMITS_DOWN).steps] == [1, 2]


LIMITS_UP = {(0x607D, 1): 20, (0x607D, 2): 40}
LIMITS_DOWN = {(0x607D, 1): -40, (0x607D, 2): -20}


def test_a_mapping_is_written_whole_and_switched_off_meanwhile(access, slave, generic, tmp_path):
    """Only the second of two entries differs; a drive takes an entry of an empty mapping of a PDO that is off alone."""
    slave.values[0x1A00, 0], slave.values[0x1A00, 1], slave.values[0x1A00, 2] = 2, 0x60410010, 0x60640020
    work = planned(access, generic, tmp_path, {(0x1A00, 2): 0x60770010})
    write_all([work])
    assert [slave.values[0x1A00, sub] for sub in range(3)] == [2, 0x60410010, 0x60770010]
    assert slave.values[0x1800, 1] == 0x40000183
    assert slave.written[0] == (0x1800, 1, 0xC0000183)


def test_what_a_refusal_leaves_behind_is_nothing(access, slave, generic, tmp_path, ledger):
    """An object that the ledger held before keeps the value of before, and its entry."""
    write_all([planned(access, generic, tmp_path, {(0x6007, 0): 3})])
    before = ledger.entries
    work = planned(access, generic, tmp_path, {(0x6007, 0): 2, (0x6065, 0): 90})
    slave.refuses_write = lambda address, data: 0x06090030 if address == (0x6065, 0) else 0
    with pytest.raises(SdoAbort, match="6065:00") as caught:
        write_all([work])
    assert caught.value.__notes__ == ["what had been written is put back"]
    assert slave.values[0x6007, 0] == 3
    assert ledger.entries == before


def before_write(slave, act):
    """Call `act` before each write to 0x6065."""
    real = slave.on_frame

    def acting(can_id, data):
        if (data[0] & 0xE0, data[1:4]) == (0x20, b"\x65\x60\x00"):
            act()
        real(can_id, data)

    slave.on_frame = acting


def test_what_cannot_be_put_back_is_named_and_stays_in_the_ledger(access, slave, generic, tmp_path, ledger):
    work = planned(access, generic, tmp_path, {(0x6007, 0): 2, (0x6065, 0): 90})
    before_write(slave, lambda: setattr(slave, "alive", False))
    with pytest.raises(SdoTimeout) as caught:
        write_all([work])
    (note,) = caught.value.__notes__
    assert "node 3:6007:00" in note
    assert "stays in the write ledger" in note
    assert [(entry.index, entry.old) for entry in ledger.entries] == [(0x6007, 1), (0x6065, 100)]


def test_a_drive_that_takes_another_value_than_it_is_given_ends_it(access, slave, generic, tmp_path, ledger):
    work = planned(access, generic, tmp_path, {(0x6065, 0): 90})
    real = slave.on_frame

    def clipping(can_id, data):
        real(can_id, data)
        slave.values[0x6065, 0] = min(slave.values[0x6065, 0], 80) if slave.values[0x6065, 0] != 100 else 100

    slave.on_frame = clipping
    with pytest.raises(ConfigurationRefused, match="0x5a was written, but 0x50 is read back"):
        write_all([work])
    assert slave.values[0x6065, 0] == 100
    assert ledger.entries == ()


def test_a_person_who_interrupts_finds_everything_as_it_was(access, slave, generic, tmp_path, ledger):
    work = planned(access, generic, tmp_path, {(0x6007, 0): 2, (0x6065, 0): 90})
    before_write(slave, Mock(side_effect=[KeyboardInterrupt, None]))
    with pytest.raises(KeyboardInterrupt):
        write_all([work])
    assert (slave.values[0x6007, 0], slave.values[0x6065, 0]) == (1, 100)
    assert ledger.entries == ()


def test_an_enabled_drive_is_refused(access, slave):
    require_at_rest([access])
    slave.state = "operation enabled"
    with pytest.raises(DriveFault, match="OPERATION ENABLED"):
        require_at_rest([access])


def test_every_obstacle_to_a_write_is_reported_before_it(access, generic, tmp_path):
    """One object that the drive lacks, one of a safety function; nothing is written."""
    lines = [(0x2000, datatypes.UNSIGNED8, ""), (0x2001, datatypes.UNSIGNED8, "")]
    text = SHEET + objects(*lines)
    text = text.replace("2=0x2001", "2=0x1301").replace("[2001]", "[1301]")
    sheet = tmp_path / "maker.eds"
    sheet.write_text(text)
    path = tmp_path / "3.dcf"
    path.write_text(dcf_text(sheet, {(0x2000, 0): 1, (0x1301, 0): 1}, MOMENT, *SITE))
    file = read_dcf(path, 3)
    found = Readout(3, {(0x1301, 0): 0}, {}, {(0x2000, 0): "SDO abort 0x06020000, object does not exist"})
    with pytest.raises(SeveralFailures) as caught:
        planned_writes(access, file, found, compare(file, found))
    assert "belongs to a safety function" in str(caught.value)
    assert "the drive does not give it: SDO abort 0x06020000" in str(caught.value)


# ------------------------------------------------------------------------------------- files of other tools and nodes

PRODUCER = (
    "[1800]\nParameterName=TPDO1\nObjectType=0x9\nSubNumber=2\n\n[1800sub0]\nParameterName=n\nDataType=5\n"
    "AccessType=ro\nDefaultValue=1\n\n[1800sub1]\nParameterName=COB-ID\nDataType=7\nAccessType=rw\n"
    "DefaultValue=$NODEID+0x180\n\n"
)


def test_identifiers_of_a_node_follow_the_node_that_the_file_is_given_to(tmp_path):
    """Node 3 sends with 0x183; its file, given to node 7, has 0x187, and what was set by hand stays as it was set."""
    sheet = tmp_path / "maker.eds"
    sheet.write_text(SHEET + objects((0x2000, datatypes.UNSIGNED8, ""), (0x2001, datatypes.UNSIGNED8, "")) + PRODUCER)
    path = tmp_path / "3.dcf"
    for held, node_7 in ((0x183, 0x187), (0x4000_0183, 0x4000_0187), (0x295, 0x295)):
        path.write_text(dcf_text(sheet, {(0x1800, 1): held}, MOMENT, *SITE))
        assert read_dcf(path, 3).values == {(0x1800, 1): held}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            assert import_od(str(path))[0x1800][1].value == held
        other = tmp_path / "7.dcf"
        other.write_text(path.read_text().replace("NodeID=3", "NodeID=7"))
        assert read_dcf(other, 7).values == {(0x1800, 1): node_7}
    with pytest.raises(ProfileError, match="it is of node 7, not of node 3") as caught:
        read_dcf(other, 3)
    assert "$NODEID" in str(caught.value)


VALUED = objects((0x2000, datatypes.UNSIGNED8, "ParameterValue=9"))
IN_A_LIST = (
    "[608F]\nParameterName=encoder\nObjectType=0x8\nDataType=0x0007\nAccessType=rw\nCompactSubObj=2\n\n"
    "[608FName]\nNrOfEntries=1\n2=turns\n\n[608FDenotation]\nNrOfEntries=0\n\n[608FValue]\nNrOfEntries=1\n2=9\n\n"
)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        (VALUED, (0x2000, 0)),
        (VALUED.replace("ParameterValue", "PARAMETERVALUE"), (0x2000, 0)),
        (VALUED.replace("ParameterValue=9", "  parameterValue = 0x009 ; mine"), (0x2000, 0)),
        (IN_A_LIST, (0x608F, 2)),
        (IN_A_LIST.replace("608FValue", "608fVALUE"), (0x608F, 2)),
        (PRODUCER.replace("sub1]", "SUB1]\nParameterValue=9"), (0x1800, 1)),
    ],
)
@pytest.mark.parametrize(
    "site", ["[DeviceComissioning]\nNodeID=3\n", "[DeviceCommissioning]\nNodeID=03\nBaudrate=0x1F4\n"]
)
def test_a_value_is_read_wherever_a_file_may_have_it(tmp_path, text, address, site):
    path = tmp_path / "3.dcf"
    path.write_text(text + site)
    assert read_dcf(path, 3).values == {address: 9}


def test_a_file_without_values_is_refused(tmp_path):
    path = tmp_path / "3.dcf"
    path.write_text(objects((0x2000, datatypes.UNSIGNED8, "")) + "[DeviceComissioning]\nNodeID=3\n")
    with pytest.raises(ProfileError, match="nothing to compare"):
        read_dcf(path, 3)


def test_two_values_of_one_object_are_refused_and_not_chosen_from(tmp_path):
    path = tmp_path / "3.dcf"
    path.write_text(VALUED.replace("=9", "=9\nPARAMETERVALUE=8") + "[DeviceComissioning]\nNodeID=3\n")
    with pytest.raises(ProfileError, match="neither is used"):
        read_dcf(path, 3)
    own = "[608Fsub2]\nDataType=7\nAccessType=rw\nParameterValue=8\n"
    path.write_text(f"{IN_A_LIST}{own}[DeviceComissioning]\nNodeID=3\n")
    with pytest.raises(ProfileError, match="608F:2 has the value '8'"):
        read_dcf(path, 3)


FAULTY = (
    "[OptionalObjects]\nSupportedObjects=3\n1=0x2000\n2=0x2345\n3=0x2022\n\n"
    + objects((0x2000, datatypes.UNSIGNED8, "HighLimit=3"))
    + "[2022]\nParameterName=gains\nObjectType=0x8\nSubNumber=5\n\n"
    + "[2022sub0]\nParameterName=n\nDataType=5\nAccessType=ro\nDefaultValue=4\n\n"
    + "[2022sub1]\nParameterName=gain\nDataType=5\nAccessType=rw\n\n"
)


def test_what_the_makers_sheet_lacks_is_not_missed_in_the_file_that_was_dumped_from_it(tmp_path):
    """The sheet lists an object and counts elements that it does not have; what is lost later is missed."""
    sheet, path = tmp_path / "maker.eds", tmp_path / "3.dcf"
    sheet.write_text(FAULTY)
    path.write_text(dcf_text(sheet, {(0x2000, 0): 2, (0x2022, 1): 5}, MOMENT, *SITE))
    assert read_dcf(path, 3).values == {(0x2000, 0): 2, (0x2022, 1): 5}
    path.write_text(path.read_text().replace("[2022sub1]", "[2023]"))
    with pytest.raises(ProfileError, match="1 elements of 2022"):
        read_dcf(path, 3)
    path.write_text(FAULTY.replace("PDOMapping", "ParameterValue=2\nPDOMapping") + "[DeviceComissioning]\nNodeID=3\n")
    assert read_dcf(path, 3).values == {(0x2000, 0): 2}, "another tool writes what the maker's sheet lacks"


def test_a_limit_that_the_drive_does_not_keep_is_a_comment_of_the_file(tmp_path):
    sheet, path = tmp_path / "maker.eds", tmp_path / "3.dcf"
    sheet.write_text(FAULTY)
    beyond = beyond_limits(read_sheet(sheet), {(0x2000, 0): 4}, 3)
    assert [what for _, _, what in beyond] == ["2000:00: 4 is above its HighLimit 3"]
    path.write_text(dcf_text(sheet, {(0x2000, 0): 4}, MOMENT, *SITE, beyond))
    assert ";HighLimit=3" in path.read_text()
    assert read_dcf(path, 3).values == {(0x2000, 0): 4}


@pytest.mark.parametrize(
    ("name", "action"),
    [
        ("Save all parameters", True),
        ("Store configuration", True),
        ("Restore factory defaults", True),
        ("Load default parameters", True),
        ("Save", True),
        ("Reset drive", True),
        ("StoreParameters", True),
        ("Software reset", True),
        ("Start auto tuning", True),
        ("Load inertia", False),
        ("Default speed", False),
        ("Storage temperature", False),
        ("Position gain", False),
    ],
)
def test_an_object_that_acts_when_it_is_written_is_no_configuration(name, action):
    entry = SheetObject(0x2010, 0, name)
    assert kind_of(entry, ()) == ("command" if action else "configuration")
    assert kind_of(replace(entry, index=0x6010), ()) == "configuration"


@pytest.mark.parametrize(
    ("index", "name", "value", "says"),
    [
        (0x2000, "Node-ID", 4, "node id"),
        (0x2009, "CANopen node id", 4, "node id"),
        (0x2001, "NodeId", 4, "node id"),
        (0x2F00, "CAN address", 4, "node id"),
        (0x2005, "CAN bitrate", 4, "bit rate"),
        (0x2005, "BaudRate", 4, "bit rate"),
        (0x2100, "magic", 0x65766173, "command of CiA 301"),
        (0x1800, "COB-ID", 0x185, "node 5"),
        (0x1014, "EMCY", 0x85, "node 5"),
        (0x1800, "COB-ID", 0x183, None),
        (0x1800, "COB-ID", 0x8000_0185, None),
        (0x1014, "EMCY", 0xA3, None),
        (0x2100, "Position gain", 4, None),
        (0x6065, "Node id", 4, None),
    ],
)
def test_what_takes_a_drive_off_the_bus_needs_a_question_of_its_own(index, name, value, says):
    why = confirmation_reason(SheetObject(index, 1 if index == 0x1800 else 0, name), value, {1, 2, 4, 5, 6})
    assert why is None if says is None else says in why


def test_what_is_left_out_is_not_written_with_its_record_either(access, slave, generic, tmp_path):
    """The mapping of a PDO is written whole, with its identifier: the drive's own, where the file's was left out."""
    slave.values[0x1800, 1] = 0x4000_0183
    found = read_drive(access, read_sheet(generic.eds_path))
    path = tmp_path / "3.dcf"
    wanted = {(0x1A00, 0): 1, (0x1A00, 1): 0x60640020, (0x1800, 1): 0x185}
    path.write_text(dcf_text(generic.eds_path, found.of_kind("configuration", "fixed") | wanted, MOMENT, *SITE))
    file = read_dcf(path, 3)
    rows = compare(file, found)
    asked = questions(file, rows, [3, 5])
    assert [row.address for row, _ in asked] == [(0x1800, 1)]
    work = planned_writes(access, file, found, rows, [row.address for row, _ in asked])
    assert {step.value & 0x7FF for step in work.steps if (step.index, step.subindex) == (0x1800, 1)} == {0x183}
