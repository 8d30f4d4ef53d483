"""Rotors and friction of two arms: identified where a result is named, else typed, each with its source."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from gateway.errors import ConfigError
from gateway.pair.pair_cell import load_pair
from gateway.result.drawn import Drawn
from gateway.result.result import AxisMotion, Result, to_json

EXAMPLE = Path(__file__).parents[3] / "examples" / "pair"
KEYS = ("rotor_inertia_kg_m2", "coulomb_nm", "viscous_nm_s_rad")


@pytest.fixture
def folder(tmp_path):
    for file in EXAMPLE.iterdir():
        shutil.copy(file, tmp_path / file.name)
    return tmp_path


def identified(joint, typed, factor):
    """An axis identified in motion at `factor` times what is typed, to within 5 %."""
    values = {key: factor * getattr(typed, key).value for key in KEYS}
    stds = {
        "rotor_inertia_std_kg_m2": 0.02 * values["rotor_inertia_kg_m2"],
        "coulomb_std_nm": 0.02 * values["coulomb_nm"],
        "viscous_std_nm_s_rad": 0.02 * values["viscous_nm_s_rad"],
    }
    return AxisMotion(joint, **values, **stds)


def named(folder, motion):
    """The cell with a result of the left arm, in which nothing is typed for that arm."""
    data = Drawn(cell="pair", arm="left", created="2026-05-04 10:00 UTC")
    (folder / "moving.json").write_text(to_json(Result(robot="bar_arm", motion=motion, data=data)))
    text = (folder / "cell.toml").read_text()
    left, right = text.split('[[arm]]\nname = "right"')
    left = re.sub(rf"(?m)^({'|'.join(KEYS)}) = .*\n", "", left)
    left = left.replace('name = "left"\n', 'name = "left"\nidentified = "moving.json"\n')
    (folder / "cell.toml").write_text(f'{left}[[arm]]\nname = "right"{right}')


def test_identified_constants_take_the_place_of_typed_ones_and_say_so(folder):
    typed = load_pair(folder / "cell.toml").arms[0]
    axes = typed.config.axis
    named(folder, tuple(identified(joint, axis, 1.1) for joint, axis in enumerate(axes, start=1)))
    left, right = load_pair(folder / "cell.toml").arms
    for name in ("rotor_kg_m2", "coulomb_nm", "viscous_nm_s_rad"):
        np.testing.assert_allclose(getattr(left, name), 1.1 * getattr(typed, name))
        np.testing.assert_allclose(getattr(right, name), getattr(typed, name))
    source = "identified, moving.json of 2026-05-04 10:00 UTC"
    assert left.said == (f"rotor inertia, Coulomb friction, viscous friction: {source}",)
    assert not any("moving.json" in line for line in right.said)


def test_what_is_neither_identified_nor_typed_is_refused(folder):
    axes = load_pair(folder / "cell.toml").arms[0].config.axis
    named(folder, tuple(identified(joint, axis, 1.0) for joint, axis in enumerate(axes[:5], start=1)))
    with pytest.raises(ConfigError, match=r"arm 'left', axis 6: rotor_inertia_kg_m2 is missing.*identified"):
        load_pair(folder / "cell.toml")
