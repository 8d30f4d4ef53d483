"""Cell, profile, payload files and bus specifications: complete examples load, bad files are named in one paragraph."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.cell.config import load_cell
from sim.cellfile import CellBus, CellFileError, compact_inertia, parse_bus_spec, read_cell, read_payloads, read_profile
from sim.units import drive_units

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
CELL = (EXAMPLES / "small" / "cell.toml").read_text(encoding="utf-8")
BUS = CellBus("udp_multicast", "239.74.163.2", 1_000_000, 0.01, "lockstep", {"port": 1})


@pytest.mark.parametrize("name", ["large", "small"])
def test_gateway_and_simulator_read_the_same_cell(name):
    strict, ours = load_cell(EXAMPLES / name / "cell.toml").cell, read_cell(EXAMPLES / name / "cell.toml")
    assert ours.name == strict.name
    for theirs, axis in zip(strict.arm[0].axis, ours.arms[0].axes, strict=True):
        assert (axis.node_id, axis.gear_ratio) == (theirs.node_id, theirs.gear_ratio.value)
        assert (axis.position_sign, axis.torque_sign) == (theirs.position_sign, theirs.torque_sign)
        assert axis.zero_offset_rad == theirs.zero_offset_rad
    assert ours.buses["a"].pacing == strict.bus["a"].pacing


@pytest.mark.parametrize(("name", "mass"), [("large", 70.0), ("small", 6.0)])
def test_payloads_of_the_examples(name, mass):
    loads = read_payloads(EXAMPLES / name / "payload.toml")
    assert [load.mass_kg for load in loads.values()] == [mass]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace("gear_ratio", "ratio", 1), "'gear_ratio' is missing"),
        (lambda text: text.replace('robot = "robot.urdf"', 'robot = "none.urdf"'), "none.urdf: cannot be read"),
        (lambda text: text.replace('robot = "robot.urdf"', ""), "names no robot"),
        (lambda text: text.replace("generic-cia402", "unknown", 1), "cannot be read"),
        (lambda text: text.replace('bus = "a"', 'bus = "b"'), r"no \[bus.b\]"),
        (lambda text: text + "\n[[arm.axis]]\nnode_id = 7\n", r"has 7 \[\[arm.axis\]\] tables, its robot 6 joints"),
        (lambda text: text.replace("value = 120", 'value = "x"', 1), "wrong kind"),
        (lambda text: "name = ", "not valid TOML"),
    ],
)
def test_a_bad_cell_is_named(change, words, tmp_path):
    (tmp_path / "robot.urdf").write_bytes((EXAMPLES / "small" / "robot.urdf").read_bytes())
    path = tmp_path / "cell.toml"
    path.write_text(change(CELL), encoding="utf-8")
    with pytest.raises(CellFileError, match=words):
        read_cell(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[load]]\nlabel = 'a'\nmass_kg = 1", "com_m"),
        ("[[load]]\nlabel = 'a'\nmass_kg = -1\ncom_m = [0, 0, 0]", "must be positive"),
        ("[[load]]\nlabel = 'a'\nmass_kg = nan\ncom_m = [0, 0, 0]", "finite"),
        ("[[load]]\nlabel = 'a'\nmass_kg = 1\ncom_m = [0, 0]", "three finite numbers"),
        ("\n[[load]]\nlabel = 'a'\nmass_kg = 1\ncom_m = [0, 0, 100]", "payload.toml:2: load 1: com_m"),
        ("[[load]]\nlabel = 'none'\nmass_kg = 1\ncom_m = [0, 0, 0]", "is already used"),
        ("load = [1]", "wrong kind"),
        ("[[lode]]\nlabel = 'a'", "holds no"),
    ],
)
def test_a_bad_payload_is_named(text, words, tmp_path):
    path = tmp_path / "payload.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CellFileError, match=words):
        read_payloads(path)


def test_inertia_of_a_load_without_shape_is_that_of_a_ball():
    radius = (8.0 / (2500.0 * 4.0 / 3.0 * math.pi)) ** (1 / 3)
    np.testing.assert_allclose(compact_inertia(8.0), np.eye(3) * 0.4 * 8.0 * radius**2)


def test_bus_specifications():
    spec = parse_bus_spec("socketcan:vcan0", BUS)
    assert (spec.interface, spec.channel, spec.options) == ("socketcan", "vcan0", {})
    spec = parse_bus_spec("udp_multicast:239.74.163.2,port=43113,fd=false,bitrate=500000", BUS)
    assert spec.options == {"port": 43113, "fd": False}
    assert (spec.bitrate_bit_s, spec.sync_period_s, spec.pacing) == (500_000, 0.01, "lockstep")
    for wrong in ("vcan0", "socketcan:", ":vcan0", "virtual:a,b"):
        with pytest.raises(CellFileError, match="INTERFACE:CHANNEL"):
            parse_bus_spec(wrong, BUS)


def axis_with(arm, profile):
    return replace(arm.axes[1], profile=read_profile(profile, Path()))


def test_each_profile_states_its_torque_as_its_manual_does(arm_of):
    """Motor torque of 7 Nm on axis 2 of the large arm: Kt 1.81 Nm/A, rated 23.875 Nm."""
    arm, torque, kt, rated = arm_of("large"), 7.0, 1.81, 23.875
    generic = drive_units(axis_with(arm, "generic-cia402"))
    assert generic.constants[0x6076, 0] == ("u32", 23875)
    assert torque * generic.torque.bits_per_unit == pytest.approx(torque / rated * 1000)
    assert generic.current is not None
    assert torque * generic.current.bits_per_unit == pytest.approx(torque / kt / (rated / kt) * 1000, rel=1e-3)
    uncounted = drive_units(axis_with(arm, "nanotec"))
    assert torque * uncounted.torque.bits_per_unit == pytest.approx(torque / rated * 1000, rel=1e-3)


def test_known_makes_count_as_their_manuals_say(arm_of):
    """Motor torque of 7 Nm on axis 2 of the large arm: Kt 1.81 Nm/A, rated 23.875 Nm at 13.1906 A."""
    arm, torque, kt, rated = arm_of("large"), 7.0, 1.81, 23.875
    epos = drive_units(axis_with(arm, "maxon-epos4"))
    nominal_ma, constant_unm = epos.constants[0x3001, 1][1], epos.constants[0x3001, 5][1]
    assert (nominal_ma, constant_unm) == (13191, 1_810_000)
    assert epos.constants[0x6076, 0][1] == pytest.approx(23.8757e6, rel=1e-5)
    assert torque * epos.torque.bits_per_unit == pytest.approx(1000 * torque / 23.8757, rel=1e-4)
    emcl = drive_units(axis_with(arm, "novanta-emcl"))
    assert emcl.constants[0x6075, 0][1] == pytest.approx(13190.6 * math.sqrt(2), abs=1)
    assert emcl.current is not None
    assert torque * emcl.current.bits_per_unit == pytest.approx(1000 * torque / rated, rel=1e-4)
    kinco = drive_units(axis_with(arm, "kinco-fd123"))
    assert torque * kinco.torque.bits_per_unit == pytest.approx(torque / kt * 1.414 * 2048 / 45)
    # 100 rpm at 65536 counts are 1789570 units (manual), twice as many at 131072
    assert 100 * math.tau / 60 * kinco.velocity.bits_per_unit == pytest.approx(2 * 1789570, rel=1e-6)
    akd = drive_units(axis_with(arm, "kollmorgen-akd-x00606"))
    assert torque * akd.torque.bits_per_unit == pytest.approx(torque / kt / 6.0 * 1000)


def test_a_profile_beside_the_cell_is_found_with_and_without_its_suffix(tmp_path):
    (tmp_path / "mine.toml").write_text('name = "mine"', encoding="utf-8")
    assert read_profile("mine", tmp_path) == read_profile("mine.toml", tmp_path) == {"name": "mine"}
    with pytest.raises(CellFileError, match="other"):
        read_profile("other", tmp_path)
