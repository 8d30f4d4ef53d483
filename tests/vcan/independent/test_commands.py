"""Commands against six drives on another CANopen stack (`durand`), in a process of their own and in real time."""

from __future__ import annotations

import math

import pytest

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(900), pytest.mark.xdist_group("by-the-clock")]
#: Quick stop ramp of axis 3 as delivered: 5 rad/s2 behind a gear of 80, in 0.1 rpm/s.
QUICK_STOP_3 = round(5.0 * 80 * 600 / (2 * math.pi))


def test_scan_and_check(place, drives, failed):
    nodes = place.result("scan", "--listen", 0.5, bus=True)["nodes"]
    product = {"zero-extended": 0x0402_0001, "no-size": 0x0402_0002}[drives.variant]
    assert [node["node_id"] for node in nodes] == [1, 2, 3, 4, 5, 6]
    for node in nodes:
        found = (node["vendor_id"], node["product_code"], node["revision"], node["serial_number"])
        assert found == (0x0D5A, product, 0x0002_0007, 0x2600_0000 + node["node_id"])
        assert (node["software_version"], node["devices"], node["nmt_state"]) == ("2.07", 1, "preoperational")
    report = place.result("check", place.cell)
    assert failed(report) == []
    said = {line["where"]: line["what"] for line in report["findings"]}
    assert said["J2 node 2:6064:00 (position)"].startswith("stands at -0.200 rad")
    assert said["J6 node 6:6076:00 (rated_torque)"] == "0.25 Nm is 1000 per mille"


def test_the_proof_stops_the_arm_twice_at_speed(place, drives, failed):
    """Once by the lost heartbeat, once by the quick stop word: both at about 0.05 rad/s, before the arm slows down."""
    report = place.result("check", place.cell, "--prove-stop", "--yes")
    assert failed(report) == []
    for lost, word, *_ in drives.stop_speeds():
        assert abs(lost) > 0.025
        assert abs(word) > 0.025
    for joint in range(1, 7):
        said = [line["what"] for line in report["findings"] if line["where"].startswith(f"J{joint} node {joint}:")]
        assert any("left OPERATION ENABLED after" in what for what in said)
        assert any("quick stop: at rest after" in what for what in said)


def test_configuration_is_kept_compared_written_and_put_back(place, drives):
    dcf = ("--dcf", place.folder / "dcf")
    place.types("config", "dump", place.cell, "--eds", place.folder / "drive.eds", "--output", place.folder / "dcf")
    place.types("config", "diff", place.cell, *dcf)
    path = place.folder / "dcf" / "3.dcf"
    before = path.read_text(encoding="utf-8")
    written = f"ParameterValue=0x{QUICK_STOP_3:08X}"
    assert before.count(written) == 1
    path.write_text(before.replace(written, "ParameterValue=0x00009C40"), encoding="utf-8")
    place.types("config", "diff", place.cell, *dcf, code=7)
    place.types("config", "apply", place.cell, *dcf, "--yes")
    place.types("config", "diff", place.cell, *dcf)
    assert drives.read(3, 0x6085, 0) == 0x9C40
    place.types("restore", place.cell)
    assert drives.read(3, 0x6085, 0) == QUICK_STOP_3
    for node in (1, 2, 3, 4, 5, 6):
        assert drives.read(node, 0x6072, 0) == 3000
        assert drives.read(node, 0x1016, 1) == 0
        assert drives.read(node, 0x1A00, 1) == 0x6041_0010
    place.types("config", "diff", place.cell, *dcf, code=7)
