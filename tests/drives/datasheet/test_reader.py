"""The data sheet reader: every spelling gives the same objects, and what is left out is named by section and line."""

from __future__ import annotations

import time
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
from canopen.objectdictionary import ODVariable, import_od

from benchmarks.chaos import sheet_judge
from benchmarks.chaos.mutated_sheets import NODE_ID, OBJECTS, mutated
from benchmarks.chaos.sheet_judge import judged
from drives.datasheet import building as reader
from drives.datasheet.building import read_sheet
from drives.datasheet.object_values import number
from drives.datasheet.sections import MAX_BYTES
from drives.draft.answers import ProfileAnswers
from drives.draft.device import device_of_sheet
from drives.draft.text import draft
from drives.errors import ProfileError
from drives.profile_file import PROFILE_FOLDER, parse_profile

HEAD = "[DeviceInfo]\nVendorName=maker\nProductName=drive\n"


def variable(name: str, kind: int, access: str = "ro", more: str = "PDOMapping=1") -> str:
    return f"[{name}]\nParameterName=n\nObjectType=0x7\nDataType=0x{kind:04X}\nAccessType={access}\n{more}\n\n"


DRIVE = HEAD + variable("6064", 4) + variable("6077", 3)
LONG = (
    DRIVE
    + "[608F]\nParameterName=encoder\nObjectType=0x9\nSubNumber=3\n\n"
    + variable("608Fsub0", 5, more="PDOMapping=0")
    + variable("608Fsub1", 7, "rw", "PDOMapping=0")
    + variable("608Fsub2", 7, "rw", "PDOMapping=0")
)
SHORT = (
    DRIVE
    + "[608F]\nParameterName=encoder\nObjectType=0x8\nDataType=0x0007\nAccessType=rw\nPDOMapping=0\nCompactSubObj=2\n"
)


@pytest.fixture
def read(tmp_path):
    def read(content: str | bytes, name="drive.eds"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_sheet(path)

    return read


# ------------------------------------------------------------------------------------------------------- one statement


@pytest.mark.parametrize(
    "text",
    [
        LONG,
        SHORT,
        LONG.replace("sub", "SUB"),
        LONG.replace("[608Fsub2]", "[ 608f sub 02 ]"),
        LONG.replace("DataType", "datatype").replace("AccessType", "ACCESSTYPE").replace("=rw", "=RW"),
        LONG.replace("\n", "\n \t").replace("=", " = "),
        SHORT.replace("CompactSubObj=2", "compactsubobj=0x02"),
        SHORT.replace("CompactSubObj", "COMPACTSUBOBJ"),
        LONG.replace("VendorName", "VendorNumber=001\nVendorName"),
        LONG.replace("VendorName", "VendorNumber=\nNrOfRXPDO=\nVendorName"),
        LONG + "[Comments]\nLines=2\nLine1=a\n",
        LONG + "[2000]\nParameterName=n\nObjectType=7\nDataType=3\nAccessType=ro\nPDOMapping=\n",
        LONG + "[2001]\nParameterName=n\nObjectType=7\nAccessType=ro\n",
        LONG + "[2002]\nParameterName=n\nObjectType=7\nDataType=3\nDataType=4\nAccessType=ro\n",
        LONG + variable("2022sub0", 5),
        LONG + "[0060]\nParameterName=s\nObjectType=6\n[0060sub1]\nDataType=5\n[5000]\nObjectType=6\nSubNumber=4\n",
        LONG + "[2003]\nObjectType=8\nDataType=7\nAccessType=rw\nCompactSubObj=3000000\n",
        LONG + "\x1a",
        LONG.replace("\n", "\r\n"),
        LONG.replace("\n", "\r"),
    ],
)
def test_every_spelling_of_a_sheet_gives_the_same_draft(tmp_path, text):
    """Counts of the encoder are those of 608F:01 in 608F:02 revolutions; nothing else may be read from the sheet."""
    path = tmp_path / "drive.eds"
    path.write_bytes(text.encode())
    profile = parse_profile(draft(device_of_sheet(path), ProfileAnswers(), "mine"), "mine.toml")
    counts = profile.position.counts_per_revolution
    assert (counts.object.index, counts.object.subindex, counts.object.type) == (0x608F, 1, "u32")
    assert (counts.per.index, counts.per.subindex, counts.per.type) == (0x608F, 2, "u32")
    assert (profile.position.object.index, profile.torque.object.index) == (0x6064, 0x6077)


@pytest.mark.parametrize(
    ("more", "line", "says"),
    [
        ("[2000]\nAccessType=ro\nPDOMapping=\n", 47, "DataType is missing: object 2000:00 is left out"),
        ("[2000]\nDataType=7\nAccessType=ro\nPDOMapping=\n", 50, "PDOMapping is empty"),
        ("[2000]\nDataType=0xZZ\nAccessType=ro\n", 48, "DataType '0xZZ' is not a number"),
        ("[2000]\nDataType=3\nDataType=4\nAccessType=ro\n", 49, "and '4' here: neither is used"),
        ("[2000]\nDataType=7\n", 47, "AccessType is missing: object 2000:00 counts as read only"),
        ("[2000]\nDatTyp=7\nAccessType=ro\n", 48, "DataType is misspelled?"),
        ("[2000]\nDataType 7\nAccessType=ro\n", 48, "is not KEY=VALUE"),
        ("[2022sub1]\nDataType=7\nAccessType=ro\n", 47, "there is no section [2022]"),
        ("[20O0]\nDataType=7\n", 47, "unknown section"),
        ("[2000\nDataType=7\nAccessType=ro\n", 47, "lacks its closing bracket"),
        ("[2000]\nObjectType=8\nDataType=7\nAccessType=ro\nCompactSubObj=300\n", 51, "at most 254 elements"),
        ("[2000]\nDataType=5\nAccessType=rw\nHighLimit=-1\n", 50, "HighLimit '-1' is not a value of type u8"),
        ("[2000]\nDataType=5\nAccessType=rw\nDefaultValue=012\n", 50, "is read as the decimal number 12"),
        ("[2000]\nObjectType=9\nSubNumber=2\n[2000sub0]\nDataType=5\nAccessType=ro\n", 49, "1 of 2 elements of 2000"),
        ("[OptionalObjects]\nSupportedObjects=1\n1=0x2345\n", 49, "object 2345 is listed and has no section"),
        ("[2000]\nObjectType=6\n", 47, "ObjectType is DEFSTRUCT"),
    ],
)
def test_what_is_left_out_is_named_with_section_and_line(read, more, line, says):
    found = read(LONG + more)
    line += len(LONG.splitlines()) - 46
    assert any(remark.line == line and says in remark.what for remark in found.remarks), found.remarks
    assert all(f"line {remark.line}" in str(remark) for remark in found.remarks)
    assert read(LONG).remarks == ()
    assert {address: replace(entry, line=0) for address, entry in found.entries.items() if address[0] >= 0x6000} == {
        address: replace(entry, line=0) for address, entry in read(LONG).entries.items()
    }


def test_the_packaged_sheet_is_read_as_an_independent_reader_reads_it():
    path = PROFILE_FOLDER / "generic-cia402.eds"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        independent = import_od(str(path), 3)
    wanted = {}
    for index, thing in independent.items():
        for member in [thing] if isinstance(thing, ODVariable) else thing.values():
            value = member.default if isinstance(member.default, int) else None
            wanted[index, member.subindex] = (
                (member.name, member.data_type, member.access_type, member.pdo_mappable),
                (value, member.min, member.max),
            )
    found = read_sheet(path)
    assert found.remarks == ()
    assert {
        address: (
            (entry.name, entry.data_type, entry.access_type, entry.pdo_mappable),
            tuple(entry.read(text, 3) for text in (entry.default, entry.low, entry.high)),
        )
        for address, entry in found.entries.items()
    } == wanted


# ------------------------------------------------------------------------------------------------- numbers, encodings


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("001", (1, False)),
        ("05", (5, False)),
        ("010", (10, False)),
        ("0X1f4", (500, False)),
        ("-0x10", (-16, False)),
        ("1F4h", (500, False)),
        ("7 ; note", (7, False)),
        ("$NODEID", (0, True)),
        ("$NODEID+0x180", (0x180, True)),
        ("0x180 + $nodeid", (0x180, True)),
    ],
)
def test_numbers(text, value):
    assert number(text) == value


@pytest.mark.parametrize("text", ["", "0x", "1_0", "1.5", "$NODEID+", "1+2", "1+$NODEID+2", "9" * 100])
def test_what_is_not_a_number(text):
    if text == "$NODEID+":
        assert number(text) == (0, True)
        return
    with pytest.raises(ValueError, match="not a number"):
        number(text)


@pytest.mark.parametrize(
    ("name", "encoding", "mark"),
    [
        ("Höhe", "utf-8", b""),
        ("Höhe", "utf-8", b"\xef\xbb\xbf"),
        ("Höhe", "utf-16-le", b"\xff\xfe"),
        ("Höhe", "utf-16-be", b"\xfe\xff"),
        ("Höhe", "utf-16-le", b""),
        ("Höhe", "latin-1", b""),
        ("位置", "gbk", b""),
    ],
)
def test_a_name_in_any_encoding(read, name, encoding, mark):
    found = read(mark + LONG.replace("encoder", name).replace("=n\n", f"={name}\n").encode(encoding))
    assert found.entries[0x6064, 0].name == name
    assert found.entries.keys() == read(LONG).entries.keys()


def test_a_line_ends_at_cr_and_lf_alone(read):
    """Byte 0x85 is half a character of GBK, and a line end to Python."""
    content = LONG.replace("=n\n", "=\x85ParameterName\n").encode("latin-1")
    found = read(content)
    assert len(found.entries) == 5
    assert found.remarks == ()


def test_what_depends_on_the_node_id_stays_so(read):
    text = LONG + "[1014]\nDataType=7\nAccessType=rw\nDefaultValue=$NODEID+0x80\n"
    assert read(text).value_of(0x1014) is None
    entry = read(text).entries[0x1014, 0]
    assert [entry.read(entry.default, node) for node in (3, 9)] == [0x83, 0x89]
    for section, node_id in (
        ("DeviceComissioning", "05"),
        ("DeviceCommissioning", "0x5"),
        ("DEVICECOMMISSIONING", "5"),
    ):
        found = read(f"{text}[{section}]\nNodeID={node_id}\nBaudrate=0x1F4\n")
        assert (found.node_id, found.value_of(0x1014)) == (5, 0x85)


# --------------------------------------------------------------------------------------------------------------- bounds


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "it is empty, no data sheet"),
        (b"\r\n\x1a", "it is empty, no data sheet"),
        (b"<?xml version='1.0'?><ISO15745/>", "XML"),
        (b"pose,q1_rad\n1,2\n", "without objects"),
        (b"\n" * (MAX_BYTES + 1), "larger than 4 MB"),
        (b"\n" * 200_000, "empty"),
        (LONG.encode() + b"\n" * 200_000, "lines"),
    ],
)
def test_a_file_that_is_no_sheet_is_refused(read, content, says):
    with pytest.raises(ProfileError, match=says):
        read(content)


def test_a_sheet_that_is_not_a_regular_file_is_not_opened(tmp_path):
    with pytest.raises(ProfileError, match="not a regular file"):
        read_sheet(Path("/dev/zero"))
    with pytest.raises(ProfileError, match="cannot be read"):
        read_sheet(tmp_path / "none.eds")


def test_a_sheet_of_arrays_that_claim_a_million_elements_is_read_within_bounds(read):
    arrays = "".join(
        f"[{index:04X}]\nObjectType=8\nDataType=7\nAccessType=rw\nCompactSubObj=9999999\n"
        for index in range(0x2000, 0x5000)
    )
    start = time.process_time()
    found = read(LONG + arrays)
    assert time.process_time() - start < 3.0
    assert len(found.entries) <= 10_000
    assert found.entries.keys() >= read(LONG).entries.keys()
    assert any("the rest is left out" in remark.what for remark in found.remarks)


# ----------------------------------------------------------------------------------------------------- mutated sheets


def test_no_mutated_sheet_is_read_otherwise_without_a_message(tmp_path):
    """A share of `make chaos`; what the sheet states is known from the table that it was written from."""
    judgements = {seed: judged(mutated(seed), tmp_path)[0] for seed in range(3_000, 3_080)}
    assert {seed: words for seed, words in judgements.items() if words} == {}


def test_the_judge_of_mutated_sheets_sees_a_reader_without_a_message(tmp_path, monkeypatch):
    monkeypatch.setattr(sheet_judge, "read_sheet", lambda path: replace(reader.read_sheet(path), remarks=()))
    judgements = [seed for seed in range(3_000, 3_060) if judged(mutated(seed), tmp_path)[0]]
    assert len(judgements) > 10


def test_the_sheet_that_is_mutated_is_read_whole(tmp_path):
    sheet = mutated(0)
    path = tmp_path / "0.dcf"
    path.write_bytes(sheet.content)
    found = read_sheet(path)
    assert found.entries.keys() == OBJECTS.keys()
    assert (found.node_id, found.vendor_id) == (NODE_ID, 0x1234)
