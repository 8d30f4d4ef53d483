"""scan, check, plan and Ctrl-C on simulated drives."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import can
import pytest

from drives.bringup import steps
from drives.discovery import ScanResult
from drives.heartbeat import NmtState
from drives.values import Identity
from gateway.data.recording.reader import read
from sim.serve import running

BEAT = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)


def test_scan_and_check_of_a_healthy_cell(place, gateway, serve):
    drives = serve()
    done = gateway("scan", "--bus", drives.bus, "--listen", 0.2, "--json", "-")
    assert done.exit_code == 0, done.output
    nodes = json.loads(done.stdout)["nodes"]
    assert [node["node_id"] for node in nodes] == [1, 2, 3, 4, 5, 6]
    assert all("generic-cia402" in node["profiles"] and node["devices"] == 1 for node in nodes)
    done = gateway("check", place.cell, "--bus", drives.bus, "--json", "-", "-v")
    assert done.exit_code == 0, done.output
    assert all(step in done.output for step in steps())
    findings = json.loads(done.stdout)["findings"]
    assert {finding["severity"] for finding in findings} <= {"ok", "info"}
    assert any(finding["where"] == "bus" for finding in findings)
    assert drives.stand_still()


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("node_missing", "no device answers"),
        ("duplicate_node", "2 devices answer"),
        ("rated_zero", "all torques"),
        ("wrong_rated", "Nm at the joint"),
    ],
)
def test_check_reports_every_drive_that_must_not_be_used(place, gateway, serve, kind, says):
    drives = serve(fault=f'[[fault]]\nkind = "{kind}"\nnode = 3\n')
    done = gateway("check", place.cell, "--bus", drives.bus, "--json", place.folder / "check.json")
    assert done.exit_code == 7, done.output
    findings = json.loads((place.folder / "check.json").read_text())["findings"]
    failed = [item for item in findings if item["severity"] == "fail"]
    assert len(failed) == 1
    assert failed[0]["where"].startswith("J3 node 3")
    assert says in failed[0]["what"]
    assert failed[0]["advice"]
    assert drives.stand_still()


def test_scan_names_an_id_that_two_devices_share(gateway, serve):
    drives = serve(fault='[[fault]]\nkind = "duplicate_node"\nnode = 5\n')
    done = gateway("scan", "--bus", drives.bus, "--listen", 0.2)
    assert done.exit_code == 7, done.output
    assert "node id 5" in done.stderr


def test_scan_names_a_node_whose_identity_cannot_be_read(gateway, monkeypatch):
    unresponsive = Identity(3, *[None] * 8)
    found = (ScanResult(unresponsive, 1, NmtState.OPERATIONAL, (), "node 3: no SDO answer within 300 ms"),)
    monkeypatch.setattr("drives.discovery.scan", lambda bus, listen_s: found)
    done = gateway("scan", "--bus", "virtual:unanswered", "--json", "-")
    assert done.exit_code == 4
    assert "node 3 answers, but its identity cannot be read: node 3: no SDO answer" in done.stderr
    (node,) = json.loads(done.stdout)["nodes"]
    assert (node["node_id"], node["vendor_id"], node["unread"]) == (3, None, "node 3: no SDO answer within 300 ms")


@pytest.mark.slow
def test_plan_says_what_will_be_measured_and_how_well(place, gateway):
    done = gateway("plan", place.cell, "--json", "-")
    assert done.exit_code == 0, done.output
    body = json.loads(done.stdout)
    assert [pose["purpose"] for pose in body["poses"]] == ["fit"] * 4 + ["validation"] * 2
    assert body["duration_s"] > 0
    assert 0 < body["expected"]["mass_std_kg"] < 1
    more = json.loads(gateway("plan", place.cell, "--poses", 8, "--json", "-").stdout)
    assert more["expected"]["mass_std_kg"] < body["expected"]["mass_std_kg"]
    assert "expected standard deviation" in gateway("plan", place.cell).stdout


@pytest.mark.slow
def test_ctrl_c_stops_the_arm_and_keeps_the_data(place, fast_arm):
    words = [sys.executable, "-m", "gateway.cli", "record", str(place.cell), "--load", "none", "-o", str(place.run)]
    with running(place.cell, payload=place.payload) as drives:
        fast_arm(drives)
        process = subprocess.Popen(
            [*words, "--yes", "-v", "--bus", drives.bus],
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ,
        )
        said = []
        for line in process.stderr:
            said.append(line)
            if line.startswith("visit 2/"):
                process.send_signal(signal.SIGINT)
                break
        _, rest = process.communicate(timeout=60)
    assert process.returncode == 130, rest
    assert "Traceback" not in rest
    assert "kept" in rest
    recording = read(place.run)
    assert recording.exit_status == "abort"
    assert sum(visit.complete for visit in recording.arms[0].visits) >= 2


@pytest.mark.parametrize("frame", [can.Message(arbitration_id=0x80, is_extended_id=False), BEAT])
def test_scan_and_check_beside_a_running_master_send_nothing(place, gateway, serve, frame):
    drives = serve()
    channel = drives.bus.removeprefix("virtual:")
    with can.Bus(interface="virtual", channel=channel) as master:
        beating = master.send_periodic(frame, 0.02)
        with can.Bus(interface="virtual", channel=channel) as ear:
            for words in (("scan", "--listen", 0.1), ("check", place.cell)):
                done = gateway(*words, "--bus", drives.bus)
                assert done.exit_code == 4, done.output
                assert "another master is active" in done.stderr
                assert "nothing was sent" in done.stderr
            beating.stop()
            node_ids = set()
            while (message := ear.recv(0.0)) is not None:
                node_ids.add(message.arbitration_id)
        assert not [can_id for can_id in node_ids if 0x600 < can_id <= 0x67F or can_id == 0]
        assert frame.arbitration_id in node_ids
    assert gateway("scan", "--bus", drives.bus, "--listen", 0.1).exit_code == 0
