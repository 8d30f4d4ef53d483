"""Commands against six drives on another CANopen stack (`durand`), in a process of their own and in real time."""

from __future__ import annotations

import pytest

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(900), pytest.mark.xdist_group("by-the-clock")]


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
