"""Drives made to public data sheets on canopen's own server: every reading command gives the right answer.

`public_drives/MAKE.csv` holds facts of a public EDS or DCF: objects, types, access, defaults. canopen writes the EDS
and answers by it: no value where the sheet has none (SDO abort 0x060A0023), no heartbeat, no boot-up.
"""

from __future__ import annotations

import csv
import json
import uuid
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import ObjectDictionary, ODRecord, ODVariable, datatypes, export_od

pytestmark = pytest.mark.slow
SHEETS = Path(__file__).parent / "public_drives"
TYPES = {"i": "INTEGER", "u": "UNSIGNED", "f": "REAL"}
#: What a drive measures and what its motor set, which no sheet holds: index -> values from its first subindex on.
LIVE = {0x1000: (0x20192,), 0x1001: (0,), 0x6041: (0x0250,), 0x6061: (0,), 0x6064: (9000,), 0x606C: (0,), 0x6077: (0,)}
#: Make -> the same for it; objects that make `check` refuse; mode of its draft, and what the draft asks.
MAKES = {
    "elmo-gold": ({0x1018: (0x9A, 0x30923), 0x608F: (65536, 1), 0x6076: (1300,)}, {"6085:00"}, 8, "rated_unit"),
    "elmo-simpliq": ({0x1018: (0x9A, 1), 0x6007: (1,), 0x6076: (1300,)}, {"", "6085:00"}, 7, "rated_unit"),
    "maxon-epos4": (
        {0x1018: (0xFB, 1, 0x1700000), 0x3000: (1, 1, 1, 0, 65536), 0x6076: (1300000,)},
        set(),
        8,
        "counts",
    ),
    "nanotec": ({0x1018: (0x26C, 0x10)}, {"", "6072:00", "6085:00"}, 8, "rated_value"),
    "trinamic": ({0x608F: (51200,), 0x607D: (1 - 2**31,), 0x60C2: (1, -3)}, {"", "6077:00", "6085:00"}, None, "0x6078"),
    "zeroerr-erob": ({0x6076: (1300,)}, {"", "6077:00", "6085:00"}, 8, "counts_per_revolution"),
    "schunk-lwa4p": ({0x1018: (0x3CA, 1)}, {"", "6077:00"}, 7, "rated_value"),
}


def write_sheet(make, path):
    """EDS of the facts."""
    sheet = ObjectDictionary()
    lines = (SHEETS / f"{make}.csv").read_text(encoding="utf-8").splitlines()
    for row in csv.DictReader(line for line in lines if not line.startswith("#")):
        index, (first, _, last) = int(row["index"], 16), row["sub"].partition("-")
        if first and index not in sheet:
            sheet.add_object(ODRecord(row["index"], index))
        for sub in range(int(first or 0), int(last or first or 0) + 1):
            entry = ODVariable(f"{row['index']}:{sub:02X}", index, sub)
            kind = {"text": "VISIBLE_STRING", "bytes": "OCTET_STRING"}.get(row["type"])
            entry.data_type = getattr(datatypes, kind or TYPES[row["type"][0]] + row["type"][1:])
            entry.access_type, entry.pdo_mappable = row["access"], row["mappable"] == "1"
            entry.default_raw = row["default"] or None
            (sheet[index].add_member if first else sheet.add_object)(entry)
    export_od(sheet, str(path))


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Folder with the sheets, bus, and the nodes 1 to 7."""
    folder, bus, nodes = tmp_path_factory.mktemp("public"), f"virtual:{uuid.uuid4().hex}", {}
    with canopen.Network().connect(interface="virtual", channel=bus.partition(":")[2]) as network:
        for node_id, (make, (live, *_)) in enumerate(MAKES.items(), start=1):
            write_sheet(make, folder / f"{make}.eds")
            node = nodes[node_id] = network.create_node(node_id, str(folder / f"{make}.eds"))
            for index, values in (LIVE | live).items():
                for sub, value in enumerate(values, start=1):
                    if (entry := node.sdo.get_variable(index, sub)) is not None:
                        entry.raw = value
        yield folder, bus, nodes


@pytest.fixture(params=[1, 2])
def cell(request, bench, place):
    """Cell file of six of the seven nodes, beginning with this one, and the make of each node."""
    makes = dict([*enumerate(MAKES, start=1)][request.param - 1 : request.param + 5])
    path = place.variant("real", ('"lockstep"', '"real"\nallow_real_drive = true'))
    text, *axes = path.read_text(encoding="utf-8").split("node_id")
    for (node_id, make), axis in zip(makes.items(), axes, strict=True):
        text += f'node_id = {node_id}\nprofile = "{make}"' + axis.partition('"generic-cia402"')[2]
    path.write_text(text, encoding="utf-8")
    return path, makes


def test_scan_names_every_drive_with_its_profile(bench, gateway):
    scanned = gateway("scan", "--bus", bench[1], "--listen", 0.05, "--json", "-")
    for node, make in zip(json.loads(scanned.stdout)["nodes"], MAKES, strict=True):
        assert make in node["profiles"] or make == "schunk-lwa4p"  # its sheet has no vendor


def test_check_refuses_what_a_sheet_leaves_open_and_nothing_else(bench, cell, gateway):
    checked = gateway("check", cell[0], "--bus", bench[1], "--json", "-")
    refused = {make: set() for make in cell[1].values()}
    for line in json.loads(checked.stdout)["findings"]:
        if line["severity"] == "fail" and "node" in line["where"]:
            node_id, _, entry = line["where"].partition("node ")[2].partition(":")
            refused[cell[1][int(node_id)]].add(entry[:7])
            assert line["advice"]
    assert refused == {make: MAKES[make][1] for make in refused}


def test_a_configuration_is_dumped_and_a_changed_object_is_named(bench, cell, gateway, tmp_path):
    (folder, bus, nodes), (path, makes) = bench, cell
    sheets = [word for node_id, make in makes.items() for word in ("--eds", f"{node_id}={folder / make}.eds")]
    dumped = gateway("config", "dump", path, "--bus", bus, "--output", tmp_path, *sheets, "--json", "-")
    assert [node["configuration"]["1017:00"] for node in json.loads(dumped.stdout)["nodes"]] == [0] * 6
    for option, code in ((2, 0), (6, 7), (2, 0)):
        nodes[4].sdo[0x605A].raw = option
        differs = gateway("config", "diff", path, "--bus", bus, "--dcf", tmp_path)
        assert (differs.exit_code, "605A" in differs.output) == (code, code == 7)


@pytest.mark.parametrize(("node_id", "make"), [*enumerate(MAKES, start=1)])
def test_a_draft_asks_what_sheet_and_drive_do_not_state(node_id, make, bench, gateway, tmp_path):
    words = ("--from-drive", node_id, "--bus", bench[1], "-o", tmp_path / "my.toml")
    drafted = gateway("profiles", "new", "--eds", bench[0] / f"{make}.eds", *words)
    _, _, mode, asked = MAKES[make]
    assert (drafted.exit_code, asked in drafted.output) == (0 if mode else 3, True)
    assert not mode or f"cyclic_mode = {mode}" in (tmp_path / "my.toml").read_text(encoding="utf-8")
