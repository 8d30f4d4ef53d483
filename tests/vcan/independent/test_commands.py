"""Commands against six drives on another CANopen stack (`durand`), in a process of their own and in real time."""

from __future__ import annotations

import math

import pytest

from tests.support.independent_drives import SIX
from tests.vcan.independent.conftest import VARIANTS, on_buses

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
#: Mass [kg] and centre of gravity in the frame of the last link [m].
LOAD = (3.2, (0.12, 0.02, -0.03))
#: Joint angles [rad].
POSES = ("0.1,0,0.4,0,0.5,0", "0.1,0.3,0.2,0.6,0.9,0.5", "0.1,0.4,-0.2,-0.6,-0.6,-0.5")
#: Where `move` goes, in counts: 65536 to a motor revolution, behind each gear, from each zero.
AT_TARGET = [
    65536 / (2 * math.pi) * ratio * (angle - zero)
    for ratio, angle, zero in zip(
        (100, -100, 80, -60, 60, 50), (0.1, -0.1, 0.4, 0.0, 0.4, 0.0), (0, 0.02, 0, 0, -0.015, 0), strict=True
    )
]
#: Quick stop ramp of axis 3 as delivered: 5 rad/s2 behind a gear of 80, in 0.1 rpm/s.
QUICK_STOP_3 = round(5.0 * 80 * 600 / (2 * math.pi))


@on_buses([*VARIANTS, "interpolated"], ["no-size"])
def test_scan_and_check(place, drives, failed):
    nodes = place.result("scan", "--listen", 0.5, bus=True)["nodes"]
    product = {"zero-extended": 0x0402_0001, "no-size": 0x0402_0002, "interpolated": 0x0402_0003}[drives.variant]
    assert [node["node_id"] for node in nodes] == list(SIX)
    for node in nodes:
        found = (node["vendor_id"], node["product_code"], node["revision"], node["serial_number"])
        assert found == (0x0D5A, product, 0x0002_0007, 0x2600_0000 + node["node_id"])
        assert (node["software_version"], node["devices"], node["nmt_state"]) == ("2.07", 1, "preoperational")
    report = place.result("check", place.cell)
    assert failed(report) == []
    said = {line["where"]: line["what"] for line in report["findings"]}
    assert said["J2 node 2:6064:00 (position)"].startswith("is at -0.200 rad")
    assert said["J6 node 6:6076:00 (rated_torque)"] == "0.25 Nm is 1000 per mille"


@on_buses([*VARIANTS, "interpolated"], ["no-size"])
@pytest.mark.clock
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


@on_buses(["no-size", "interpolated"], ["no-size"])
@pytest.mark.clock
def test_from_the_first_motion_to_the_load(place, drives):
    """`move`, two recordings, `estimate`, on an arm with friction and gears that take a tenth of the work."""
    place.types("move", place.cell, "--to", "0.1,-0.1,0.4,0,0.4,0", "--override", 100, "--yes")
    counts = [drives.read(node, 0x6064, 0) for node in SIX]
    assert counts == pytest.approx([round(each) for each in AT_TARGET], abs=20)
    bare, loaded = place.folder / "bare.h5", place.folder / "loaded.h5"
    poses = [word for pose in POSES for word in ("--poses", pose)]
    place.types("record", place.cell, "--load", "none", "--yes", *poses, output=bare)
    drives.attach(*LOAD)
    place.types("record", place.cell, "--load", "part", "--yes", *poses, output=loaded)
    (load,) = place.result("estimate", bare, loaded, "--cell", place.cell, bus=False)["loads"]
    mass, com = LOAD
    print(f"load {load['mass_kg']:.3f} +- {1.96 * load['mass_std_kg']:.3f} kg of {mass} kg (95 %)")
    assert abs(load["mass_kg"] - mass) < 1.96 * load["mass_std_kg"]
    assert load["mass_std_kg"] < 0.03 * mass
    for found, std, true in zip(load["com_m"], load["com_std_m"], com, strict=True):
        assert abs(found - true) < 3.29 * std  # 99.9 %
        assert std < 0.005


@on_buses(VARIANTS)
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
    for node in SIX:
        assert drives.read(node, 0x6072, 0) == 3000
        assert drives.read(node, 0x1016, 1) == 0
        assert drives.read(node, 0x1A00, 1) == 0x6041_0010
    place.types("config", "diff", place.cell, *dcf, code=7)
