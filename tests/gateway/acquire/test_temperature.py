"""A drive that reports its temperature has it in the recording; simulated drives that warm up."""

from __future__ import annotations

import shutil
import uuid
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from drives.bus import BusSpec
from gateway.acquire.planning import make_plan
from gateway.acquire.session import record
from gateway.cell.config import load_cell, with_pacing
from gateway.cli import main
from gateway.data.recording.reader import read
from gateway.motion.opening import open_arm
from gateway.result.result import read_result
from sim.serve import running
from tests.support.rigs.pacing import measured_shortly

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("session")]
ROOT = Path(__file__).parents[3]
TEMPERATURE = """
[temperature]
object = { index = 0x2A00, type = "i16" }
unit_c = { value = 0.1, source = "test" }
of = "motor"
"""


@pytest.fixture
def cell(tmp_path) -> Path:
    """The small example; the drives of axes 2 to 6 report a temperature, that of axis 1 does not."""
    shutil.copytree(ROOT / "examples" / "small", tmp_path, dirs_exist_ok=True)
    profile = (ROOT / "drives" / "profiles" / "generic-cia402.toml").read_text(encoding="utf-8")
    profile = profile.replace('name = "generic-cia402"', 'name = "warm"').replace('eds = "generic-cia402.eds"\n', "")
    (tmp_path / "warm.toml").write_text(profile + TEMPERATURE, encoding="utf-8")
    first, *others = (tmp_path / "cell.toml").read_text(encoding="utf-8").split("[[arm.axis]]")
    others[1:] = [axis.replace('"generic-cia402"', '"warm"') for axis in others[1:]]
    (tmp_path / "cell.toml").write_text(measured_shortly("[[arm.axis]]".join([first, *others])), encoding="utf-8")
    return tmp_path / "cell.toml"


def test_the_recording_holds_the_temperature_of_the_drives(cell, tmp_path):
    pytest.importorskip("pybullet")
    loaded = with_pacing(load_cell(cell), "lockstep")
    plan = make_plan(loaded, n_poses=3)
    truth = {}
    options = {"pacing": "lockstep", "payload": cell.parent / "payload.toml"}
    with running(cell, bus=f"virtual:{uuid.uuid4()}", **options) as simulation:
        world = simulation.simulation.arms[0].world
        # not the course of any model: 20 deg C at first, 0.5 K a second, each motor a degree above the one before
        world.plant = replace(world.plant, temperature_c=lambda time_s: 20.0 + 0.5 * time_s + np.arange(6.0))
        begun_s = world.time_s
        with open_arm(loaded, BusSpec.parse(simulation.bus)) as opened:
            record(opened, plan, "none", tmp_path / "run.h5")
            simulation.mount("load")
            record(opened, plan, "load", tmp_path / "run.h5", read(tmp_path / "run.h5"))
        truth["least"], truth["most"] = 20.0 + 0.5 * begun_s, 20.0 + 0.5 * world.time_s
    arm = read(tmp_path / "run.h5").arms[0]
    found = np.array([visit.temperature_c for visit in arm.visits])
    assert np.isnan(found[:, 0]).all()
    assert np.isfinite(found[:, 1:]).all()
    warmed = found[:, 1:] - np.arange(1.0, 6.0)
    assert (warmed >= truth["least"] - 0.06).all()
    assert (warmed <= truth["most"] + 0.06).all()
    # one answer comes after the other: axes of one visit are apart by less than the visit lasts
    assert np.ptp(warmed, axis=1).max() < 1.0
    assert (np.diff(warmed.mean(axis=1)) > 0.0).all()
    assert np.array_equal(read(tmp_path / "run.h5").table().temperature_c, found, equal_nan=True)

    result, page = tmp_path / "result.json", tmp_path / "page.html"
    for words in (["estimate", tmp_path / "run.h5", "--json", result], ["report", result, "-o", page]):
        done = CliRunner().invoke(main, [str(word) for word in words])
        assert done.exit_code == 0, done.output
    ranges = np.array(read_result(result).data.temperature_c)
    assert ranges[1:] == pytest.approx(np.array([found.min(axis=0), found.max(axis=0)]).T[1:])
    assert np.isnan(ranges[0]).all()
    assert "Temperature of motor or drive while measuring: J2" in page.read_text(encoding="utf-8")
