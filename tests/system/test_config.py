"""config: drives as files, files beside drives, files written to drives; on a bus, with drives that have a mind."""

from __future__ import annotations

import json
import re
import warnings
from xml.etree import ElementTree

import pytest
from canopen.objectdictionary import import_od

from drives.profile_file import PROFILE_FOLDER

SHEET = PROFILE_FOLDER / "generic-cia402.eds"
#: An object of the maker that the simulated drives do not have.
LACKED = """[5000]
ParameterName=notch filter
ObjectType=0x7
DataType=0x0006
AccessType=rw
ParameterValue=5
PDOMapping=0
"""


@pytest.fixture
def drives(serve):
    return serve()


@pytest.fixture
def config(gateway, place, drives):
    """`config` on these drives, with files in a folder of the test."""

    def run(verb, *options, folder=place.folder / "dcf"):
        where = "--output" if verb == "dump" else "--dcf"
        return gateway("config", verb, place.cell, where, folder, "--bus", drives.bus, *options)

    return run


def store_of(drives, node):
    return drives.handle.simulation.arms[0].drives[node - 1].store


def read_by_canopen(path, node=None):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return import_od(str(path), node)


def edit(path, section, old, new):
    text = path.read_text()
    start = text.index(f"\n[{section}]\n")
    end = text.find("\n[", start + 1)
    assert old in text[start:end], text[start:end]
    path.write_text(text[:start] + text[start:end].replace(old, new) + text[end:])


def add(path, section):
    path.write_text(path.read_text().replace("\n[6065]\n", f"\n{section}\n[6065]\n"))


def set_value(path, section, value):
    text = path.read_text()
    start = text.index(f"\n[{section}]\n")
    old = text[start:].split("ParameterValue=")[1].split("\n")[0]
    edit(path, section, f"ParameterValue={old}\n", f"ParameterValue={value}\n")


def ledger(tmp_path):
    found = [path for path in (tmp_path / "state").rglob("*.json") if "stop" not in path.name]
    return [entry for path in found for entry in json.loads(path.read_text())["entries"]]


def test_what_is_dumped_is_read_back_by_an_independent_reader_as_the_drives_hold_it(config, drives, place):
    done = config("dump", "--json", place.folder / "dump.json")
    assert done.exit_code == 0, done.output
    for node in range(1, 7):
        store, found = store_of(drives, node), read_by_canopen(place.folder / "dcf" / f"{node}.dcf")
        assert (found.node_id, found.bitrate) == (node, 1_000_000)
        count = 0
        for index, thing in found.items():
            for variable in thing.values() if hasattr(thing, "values") else [thing]:
                if variable.value is not None:
                    count += 1
                    held = store.find(index, variable.subindex).get()
                    assert variable.value == held, f"{index:04X}:{variable.subindex}"
        assert count > 60
        assert found[0x1018][4].value == store.number((0x1018, 4))
        assert found[0x607D][1].value == store.number((0x607D, 1)) < 0, "a number below zero stays one"
    texts = (place.folder / "dcf" / "3.dcf").read_text()
    for index in ("6040", "607A", "6041", "6064", "1010sub1"):
        section = texts[texts.index(f"\n[{index}]\n") :].split("\n[", 2)[1]
        assert "ParameterValue" not in section, f"{index} is no configuration"
    apart = json.loads((place.folder / "dump.json").read_text())["nodes"][2]["apart"]
    assert "6041:00" in apart
    assert "607A:00" in apart


@pytest.mark.slow
def test_a_dump_is_not_replaced_unasked_and_equal_drives_are_equal(config, place):
    assert config("dump").exit_code == 0
    assert config("dump").exit_code == 3
    done = config("diff", "--junit", place.folder / "junit.xml")
    assert done.exit_code == 0, done.output
    suite = ElementTree.parse(place.folder / "junit.xml").getroot()[0]
    assert suite.get("failures") == "0"
    assert int(suite.get("tests") or 0) > 6 * 30


def test_changed_objects_are_reported_and_exit_7_says_that_something_is(config, drives, place):
    """Drive 2 was changed, file 3 was changed, and both of 4, beside the defaults of a data sheet that has some."""
    sheet = place.folder / "maker.eds"
    sheet.write_text(SHEET.read_text())
    edit(sheet, "6066", "DefaultValue=", "DefaultValue=20")
    assert config("dump", "--eds", sheet).exit_code == 0
    folder = place.folder / "dcf"
    store_of(drives, 2).values[0x6066, 0] = 33
    set_value(folder / "3.dcf", "6066", "0x0028")
    set_value(folder / "4.dcf", "6066", "0x0028")
    store_of(drives, 4).values[0x6066, 0] = 33
    set_value(folder / "5.dcf", "6065", "0x7")
    done = config("diff", "--json", place.folder / "diff.json", "--junit", place.folder / "junit.xml")
    assert done.exit_code == 7, done.output
    assert "and 3 more" in done.stderr
    count = {
        (node["node_id"], row["object"]): (row["state"], row["default"], row["dcf"], row["drive"])
        for node in json.loads((place.folder / "diff.json").read_text())["nodes"]
        for row in node["differences"]
    }
    window = store_of(drives, 5).number((0x6065, 0))
    assert count == {
        (2, "6066:00"): ("changed on drive", 20, 20, 33),
        (3, "6066:00"): ("changed in DCF", 20, 40, 20),
        (4, "6066:00"): ("both", 20, 40, 33),
        (5, "6065:00"): ("differs", None, 7, window),
    }
    suite = ElementTree.parse(place.folder / "junit.xml").getroot()[0]
    failed = {(case.get("classname"), case[0].get("type")) for case in suite.iter("testcase") if len(case)}
    assert failed == {
        ("arm main node 2", "changed on drive"),
        ("arm main node 3", "changed in DCF"),
        ("arm main node 4", "both"),
        ("arm main node 5", "differs"),
    }


@pytest.mark.slow
def test_what_differs_is_written_entered_and_put_back(config, gateway, drives, place, tmp_path):
    """A plain object of one drive, a mapping of another, its emergency identifier; the others are not written to."""
    assert config("dump").exit_code == 0
    folder = place.folder / "dcf"
    window, mapping = store_of(drives, 2), store_of(drives, 3)
    before = {node: dict(store_of(drives, node).values) for node in range(1, 7)}
    set_value(folder / "2.dcf", "6066", "0x0028")
    set_value(folder / "3.dcf", "1800sub1", "0x00000183")
    set_value(folder / "3.dcf", "1800sub2", "0x01")
    set_value(folder / "3.dcf", "1A00sub0", "0x02")
    set_value(folder / "3.dcf", "1A00sub1", "0x60640020")
    set_value(folder / "3.dcf", "1A00sub2", "0x60410010")
    set_value(folder / "3.dcf", "1014", "0x000000A3")
    refused = config("apply")
    assert refused.exit_code == 130, refused.output
    assert "nothing was written" in refused.stderr
    assert window.number((0x6066, 0)) == 20
    done = config("apply", "--yes")
    assert done.exit_code == 0, done.output
    assert window.number((0x6066, 0)) == 40
    held = [mapping.find(0x1A00, sub).get() for sub in range(3)]
    assert held == [2, 0x60640020, 0x60410010]
    assert (mapping.find(0x1800, 1).get(), mapping.find(0x1800, 2).get()) == (0x183, 1)
    assert mapping.find(0x1014, 0).get() == 0xA3
    assert {entry["node_id"] for entry in ledger(tmp_path)} == {2, 3}
    assert config("diff").exit_code == 0
    assert all(dict(store_of(drives, node).values) == before[node] for node in (1, 4, 5, 6))
    assert gateway("restore", place.cell, "--bus", drives.bus).exit_code == 0
    assert window.number((0x6066, 0)) == 20
    assert [mapping.find(0x1A00, sub).get() for sub in range(2)] == [1, 0x60410010]
    assert mapping.find(0x1014, 0).get() == 0x83
    assert ledger(tmp_path) == []


def test_a_value_that_a_drive_refuses_takes_everything_back(config, drives, place, tmp_path):
    """Drive 2 takes its value; drive 4 has an option code that is none: both are then as they were."""
    assert config("dump").exit_code == 0
    folder = place.folder / "dcf"
    set_value(folder / "2.dcf", "6066", "0x0028")
    set_value(folder / "4.dcf", "605E", "77")
    done = config("apply", "--yes")
    assert done.exit_code == 4, done.output
    assert "node 4:605E:00" in done.stderr
    assert "put back" in done.stderr
    assert store_of(drives, 2).number((0x6066, 0)) == 20
    assert store_of(drives, 4).number((0x605E, 0)) == 2
    assert ledger(tmp_path) == []


def test_an_enabled_drive_is_not_written_to(config, drives, place):
    assert config("dump").exit_code == 0
    set_value(place.folder / "dcf" / "2.dcf", "6066", "0x0028")
    drive = drives.handle.simulation.arms[0].drives[4]
    for word in (0x06, 0x07, 0x0F):
        drive.take_controlword(word)
    done = config("apply", "--yes")
    assert done.exit_code == 4, done.output
    assert "node 5" in done.stderr
    assert store_of(drives, 2).number((0x6066, 0)) == 20


def test_parameters_are_stored_only_where_that_is_asked_for(config, drives, place):
    assert config("dump").exit_code == 0
    set_value(place.folder / "dcf" / "2.dcf", "6066", "0x0028")
    assert config("apply", "--yes").exit_code == 0
    assert store_of(drives, 2).number((0x1010, 1)) == 1, "nothing was stored"
    assert config("apply", "--yes", "--store").exit_code == 0
    assert [store_of(drives, node).number((0x1010, 1)) for node in (1, 2)] == [0x65766173, 0x65766173]


@pytest.mark.slow
def test_values_of_a_run_are_never_stored_in_a_drive(config, gateway, drives, place):
    declined = gateway("move", place.cell, "--bus", drives.bus, "--to", "home", input="n\n")
    assert declined.exit_code == 130, "the drives are configured, and the ledger holds what a run has written"
    assert config("dump").exit_code == 0
    set_value(place.folder / "dcf" / "6.dcf", "6065", 70000)
    window = store_of(drives, 6).number((0x6065, 0))
    done = config("apply", "--yes", "--store")
    assert done.exit_code == 5, done.output
    assert "servo-gateway restore" in done.stderr
    assert store_of(drives, 6).number((0x6065, 0)) == window
    assert {store_of(drives, node).number((0x1010, 1)) for node in range(1, 7)} == {1}
    assert gateway("restore", place.cell, "--bus", drives.bus).exit_code == 0
    assert config("apply", "--yes", "--store").exit_code == 0
    assert store_of(drives, 6).number((0x1010, 1)) == 0x65766173


@pytest.mark.parametrize(
    ("section", "old", "new", "code", "says"),
    [
        ("1018sub2", "ParameterValue=0x00000001", "ParameterValue=0x00000002", 3, "it is of another product"),
        ("DeviceComissioning", "NodeID=2", "NodeID=3", 3, "it is of node 3, not of node 2"),
        ("6066", "PDOMapping=0", "PDOMapping=0\nHighLimit=10", 3, "6066:00.*20 is above its HighLimit 10"),
        ("6066", "PDOMapping=0", "PDOMapping=0\nLowLimit=0x20", 3, "6066:00.*20 is below its LowLimit 32"),
        ("6066", "0x0014", "twenty", 3, "6066:00.*'twenty' is not a value of its type"),
        ("6066", "0x0014", "0x10014", 3, "6066:00.*'0x10014' is not a value of its type"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_in_one_line(config, place, section, old, new, code, says):
    assert config("dump").exit_code == 0
    edit(place.folder / "dcf" / "2.dcf", section, old, new)
    for verb in ("diff", "apply"):
        done = config(verb)
        assert done.exit_code == code, done.output
        assert "2.dcf" in done.stderr
        assert re.search(says, done.stderr), done.stderr


def test_a_file_that_was_cut_short_is_refused_wherever_it_ends(config, place):
    assert config("dump").exit_code == 0
    path = place.folder / "dcf" / "2.dcf"
    text = path.read_text()
    for end in (0, 100, len(text) // 3, len(text) // 2, text.index("[DeviceComissioning]"), text.index("NodeID=") + 7):
        path.write_text(text[:end])
        done = config("diff")
        assert done.exit_code == 3, f"{end}: {done.output}"
        assert "2.dcf" in done.stderr
    path.unlink()
    done = config("diff")
    assert done.exit_code == 3
    assert "2.dcf: file missing; create it from the drives with: servo-gateway config dump" in " ".join(
        done.stderr.split()
    )


def test_another_drive_of_the_same_product_is_said_and_compared(config, place):
    assert config("dump").exit_code == 0
    edit(place.folder / "dcf" / "2.dcf", "1018sub4", "ParameterValue=0x0051", "ParameterValue=0x0052")
    done = config("diff")
    assert done.exit_code == 0, done.output
    assert "node 2: serial number 0x520002 in 2.dcf, 0x510002 on the drive" in done.stdout


def test_what_the_drive_lacks_is_named_and_stops_a_write_before_it_begins(config, drives, place):
    assert config("dump").exit_code == 0
    set_value(place.folder / "dcf" / "1.dcf", "6066", "0x0028")
    add(place.folder / "dcf" / "2.dcf", LACKED)
    done = config("diff")
    assert done.exit_code == 7, done.output
    assert "not on drive" in done.stdout
    done = config("apply", "--yes")
    assert done.exit_code == 4, done.output
    assert "node 2:5000:00" in done.stderr
    assert "object does not exist" in done.stderr
    assert store_of(drives, 1).number((0x6066, 0)) == 20


def test_a_node_that_does_not_respond_is_named_and_no_file_is_written(config, drives, place):
    drives.handle.simulation.arms[0].drives[2].node.unpowered = True
    done = config("dump")
    assert done.exit_code == 4, done.output
    assert "node 3" in done.stderr
    assert not (place.folder / "dcf").exists()


def test_objects_that_the_drive_does_not_give_are_named(config, place):
    sheet = place.folder / "maker.eds"
    sheet.write_text(SHEET.read_text())
    add(sheet, LACKED.replace("ParameterValue=5\n", ""))
    done = config("dump", "--eds", sheet, "--json", place.folder / "dump.json")
    assert done.exit_code == 0, done.output
    assert "4 objects could not be read: 5000:00" in done.stdout
    unread = json.loads((place.folder / "dump.json").read_text())["nodes"][0]["unread"]
    assert "object does not exist" in unread["5000:00"]


def test_a_value_is_compared_in_whatever_case_its_key_is_written_and_nothing_is_an_error(config, place):
    """A file whose values another tool has written; one in it differs from the drive; one file has none at all."""
    assert config("dump").exit_code == 0
    path = place.folder / "dcf" / "2.dcf"
    set_value(path, "6066", "0x0028")
    path.write_text(path.read_text().replace("ParameterValue", "PARAMETERVALUE").replace("sub", "SUB"))
    done = config("diff")
    assert done.exit_code == 7, done.output
    assert "node 2:6066:00" in done.stderr
    path.write_text(re.sub("PARAMETERVALUE=.*\n", "", path.read_text()))
    for verb in ("diff", "apply"):
        done = config(verb)
        assert done.exit_code == 3, done.output
        assert "nothing to compare" in " ".join(done.stderr.split())


def test_a_dump_is_not_refused_for_what_the_makers_sheet_lacks_or_the_drive_does_not_keep(config, place):
    sheet = place.folder / "maker.eds"
    sheet.write_text(SHEET.read_text().replace("SubNumber=9", "SubNumber=10").replace("1=0x1003", "1=0x2345"))
    edit(sheet, "6066", "PDOMapping=0", "PDOMapping=0\nHighLimit=10")
    done = config("dump", "--eds", sheet)
    assert done.exit_code == 0, done.output
    assert "object 2345 is listed and has no section" in done.stderr
    assert "20 is above its HighLimit 10 of the data sheet" in done.stdout
    assert config("diff").exit_code == 0
    assert config("apply", "--yes").exit_code == 0


@pytest.mark.slow
def test_a_file_of_another_node_gives_a_drive_none_of_its_identifiers(config, drives, place, tmp_path):
    """The file of node 3 as file of node 2; then an emergency identifier of node 3, typed by hand."""
    assert config("dump").exit_code == 0
    folder = place.folder / "dcf"
    own = (folder / "2.dcf").read_text()
    assert "ParameterValue=$NODEID+0x00000080" in own
    (folder / "2.dcf").write_text((folder / "3.dcf").read_text().replace("NodeID=3", "NodeID=2"))
    assert config("diff", "--json", tmp_path / "diff.json").exit_code == 7
    differences = json.loads((tmp_path / "diff.json").read_text())["nodes"][1]["differences"]
    assert differences
    assert not [row["object"] for row in differences if row["object"][:2] in ("10", "14", "18")]
    (folder / "2.dcf").write_text(own)
    set_value(folder / "2.dcf", "1014", "0x00000083")
    before = dict(store_of(drives, 2).values)
    done = config("apply", "--yes", "--json", tmp_path / "apply.json")
    assert done.exit_code == 0, done.output
    assert "not written: node 2:1014:00" in done.stdout
    assert "identifier of node 3" in done.stdout
    assert "nothing to write" in done.stdout
    assert dict(store_of(drives, 2).values) == before
    assert json.loads((tmp_path / "apply.json").read_text())["nodes"][1]["left_out"] == ["1014:00"]
    assert config("apply", "--yes", "--also", "1014:00").exit_code == 0
    assert store_of(drives, 2).find(0x1014, 0).get() == 0x83
