"""An effect is one file: put beside the others, it is looked for at rest and in motion, and named in the report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.data.table import write_csv
from sim.effects import add_passive
from tests.data.moving_arm import URDF, World, measured
from tests.data.product_copy import ProductCopy
from tests.data.resting_arm import Bench

MADE_UP = '''
"""A rope wound over a cam of axis 3."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gateway.model.effect import Effect, Over
from gateway.model.term import AngleTorque


@dataclass(frozen=True, slots=True)
class CamRope(AngleTorque):
    name = "cam_rope"
    parameters = ("pull_nm",)
    bounds = {"pull_nm": (0.0, 1e4)}

    def shape(self, q_rad, fixed):
        return -np.abs(np.sin(3.0 * q_rad[:, [self.axis]]))


def _on_axis_3(rows, setup):
    yield CamRope(2)


EFFECT = Effect(
    name="cam_rope",
    words="a rope over a cam",
    meaning="a rope is wound over a cam",
    over=Over.ANGLE,
    at_rest=_on_axis_3,
    in_motion=_on_axis_3,
)
'''


@pytest.fixture(scope="module")
def repository(tmp_path_factory) -> ProductCopy:
    """The product with one file more."""
    repository = ProductCopy(tmp_path_factory.mktemp("copy"))
    repository.add("gateway/model/effects/cam_rope.py", MADE_UP)
    return repository


def diagnosed(repository: ProductCopy, csv: Path, *options: str) -> tuple[dict, str]:
    """Result and page of the command, run from the copy with the added file."""
    out, page = csv.with_suffix(".json"), csv.with_suffix(".html")
    line = ("diagnose", csv.name, "--robot", "robot.urdf", "--json", out.name, *options)
    for arguments in (line, ("report", out.name, "--output", page.name)):
        done = repository.command(*arguments, cwd=csv.parent)
        assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(out.read_text()), page.read_text()


def write(table, path: Path, urdf: str) -> Path:
    """A table as the CSV that an engineer has, and the URDF beside it."""
    (path.parent / "robot.urdf").write_text(urdf)
    write_csv(table, path)
    return path


@pytest.mark.slow
def test_the_added_effect_is_found_at_rest(repository, tmp_path):
    bench = Bench(4, [])

    def rope(q_rad, _time_s, _tau_nm):
        return -np.array([0.0, 0.0, 6.0 * bench.arm.floor_nm[2] * abs(np.sin(3.0 * q_rad[2])), 0.0, 0.0, 0.0])

    bench.plant = add_passive(replace(bench.plant, gear_efficiency=np.ones(6)), rope)
    result, page = diagnosed(repository, write(bench.both(), tmp_path / "rest.csv", bench.arm.urdf))
    assert [(entry["name"], entry["joints"]) for entry in result["effects"]] == [("cam_rope", [3])]
    (found,) = result["effects"]
    assert abs(found["parameters"]["pull_nm"] - 6.0 * bench.arm.floor_nm[2]) < 4.0 * found["std"]["pull_nm"]
    assert "a rope over a cam" in page


@pytest.mark.slow
def test_the_added_effect_is_found_in_motion(repository, tmp_path):
    table, _, scale = measured(1, World())
    pull = 0.3 * scale[2]
    table.tau_nm[:, 2] += pull * np.abs(np.sin(3.0 * table.q_rad[:, 2]))
    csv = write(table, tmp_path / "moving.csv", URDF)
    result, page = diagnosed(repository, csv, "--inertials", "ignore")
    assert [(entry["name"], entry["joints"]) for entry in result["effects"]] == [("cam_rope", [3])]
    assert result["effects"][0]["parameters"]["pull_nm"] == pytest.approx(pull, rel=0.1)
    assert "a rope over a cam" in page
