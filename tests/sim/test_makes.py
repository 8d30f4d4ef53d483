"""What the master makes of the words of a fake that counts as its make does, and that a wrong profile shows."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from drives.profile import CountsFromObjects
from drives.profile_file import PROFILE_FOLDER, parse_profile
from drives.scaling import Constants, motor_scale
from sim.makes import LACKING, MAKES
from sim.units import drive_units

KT = 1.81


def shown(units, rated):
    """What a rated value comes to, read from the fake."""
    if rated is None or rated.object is None:
        return None if rated is None else rated.value
    return units.constants[rated.object.index, rated.object.subindex][1] * rated.unit


def read_back(axis, text):
    """Torque, current, velocity and position that the master reads, as parts of the true ones."""
    profile = parse_profile(text, "mine.toml")
    units = drive_units(replace(axis, profile=tomllib.loads(text)))
    counts = profile.position.counts_per_revolution
    if isinstance(counts, CountsFromObjects):
        turn = units.constants[counts.object.index, counts.object.subindex][1]
        turn /= 1 if counts.per is None else units.constants[counts.per.index, counts.per.subindex][1]
    else:
        turn = counts.value
    current = None if profile.current is None else shown(units, profile.current.rated)
    scale = motor_scale(profile, Constants(shown(units, profile.torque.rated), current, None, turn), KT)
    parts = {
        "torque": scale.torque_nm * units.torque.bits_per_unit,
        "position": scale.count_rad * units.counts_per_rad,
    }
    if scale.velocity_rad_s is not None:
        parts["velocity"] = scale.velocity_rad_s * units.velocity.bits_per_unit
    if scale.current_a is not None:
        parts["current"] = scale.current_a * KT * units.current.bits_per_unit
    assert (profile.torque.object.index, profile.torque.object.subindex) == units.torque.address
    return parts


@pytest.fixture
def axis(arm_of):
    """Axis 2 of the large arm: 1.81 Nm/A, rated 23.875 Nm."""
    return arm_of("large").axes[1]


@pytest.mark.parametrize("name", sorted(MAKES))
def test_the_master_reads_what_is_true(name, axis):
    parts = read_back(axis, (PROFILE_FOLDER / f"{name}.toml").read_text())
    assert parts == pytest.approx(dict.fromkeys(parts, 1.0), rel=1e-4)


@pytest.mark.parametrize(
    ("name", "old", "new", "quantity", "factor"),
    [
        ("maxon-epos4", "unit = 0.000001", "unit = 0.001", "torque", 1000.0),
        ("elmo-gold", "unit = 0.001", "unit = 0.000001", "torque", 1e-3),
        ("novanta-emcl", 'current_reference = "peak"', 'current_reference = "rms"', "current", math.sqrt(2.0)),
        ("kinco-fd123", 'current_reference = "rms"', 'current_reference = "peak"', "torque", math.sqrt(0.5)),
        ("kinco-fd123", "value = 0.06103515625", "value = 0.06", "velocity", 0.06 / 0.06103515625),
        ("kollmorgen-akd-x00606", "value = 6.0", "value = 3.0", "torque", 0.5),
        ("technosoft-ipos8010", "value = 0.0006105006105006105", "value = 0.000305", "torque", 0.000305 * 1638.0),
    ],
)
def test_a_profile_that_says_otherwise_than_the_make_shows(name, old, new, quantity, factor, axis):
    text = (PROFILE_FOLDER / f"{name}.toml").read_text()
    assert old in text
    assert read_back(axis, text.replace(old, new, 1))[quantity] == pytest.approx(factor, rel=1e-3)


def test_a_drive_lacks_what_its_make_lacks():
    for path in sorted(PROFILE_FOLDER.glob("*.toml")):
        table = tomllib.loads(path.read_text())
        lacking = LACKING.get(table["name"], ())
        reasons = " ".join(table.get("no_motion", ()))
        assert all(f"0x{index:04X}" in reasons for index in lacking), path
        assert bool(lacking) == bool(table.get("no_motion")), path


def test_every_make_has_its_profile():
    assert all(Path(PROFILE_FOLDER, f"{name}.toml").is_file() for name in MAKES)
