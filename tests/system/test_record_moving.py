"""Excitations of a plan, recorded bare and loaded, up to what a comparison of a fed path takes from the result."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from gateway.cell.config import load_cell
from gateway.excite.plan_file import plan_as_plain, read_plan
from gateway.excite.sweep_choice import Sweep
from gateway.model.arm_model import arm_robot
from gateway.motion.workspace import workspace_of
from gateway.result.follow import follow_from_json
from gateway.result.result import read_result
from sim.cellfile import read_payloads
from tests.data.excitations import swing

#: Sweeps of these joints alone, at two of the planned speeds: the others' friction shows in the series.
SWEPT, SPEEDS = ("friction J2", "friction J5"), [2, 4]
#: A box of half a metre: what turns the wrist shows its inertia.
LOAD = """[[load]]
label = "load"
mass_kg = 6.0
com_m = [0.02, 0.01, 0.10]
inertia_kg_m2 = [[0.13, 0.0, 0.01], [0.0, 0.11, 0.0], [0.01, 0.0, 0.05]]
"""
PATH = """name = "nod"
waypoints_rad = [[0.0, -0.2, 0.4, 0.0, 0.3, 0.0], [0.3, 0.2, 0.1, 0.0, 0.3, 0.0]]
speed_share = 0.9
"""
#: Results of motion, of which joints (friction of those that were swept), and its largest standard deviation, share.
DETERMINED = {
    "coulomb_nm": ([1, 4], 0.05),
    "viscous_nm_s_rad": ([1, 4], 0.1),
    "rotor_inertia_kg_m2": ([0, 1, 2, 3, 4, 5], 0.05),
}


@pytest.fixture
def untyped(place, monkeypatch):
    """A cell without typed rotor or friction; friction is the same in every motion, as its truth is."""
    monkeypatch.setattr("sim.nominal.SCATTER", 0.0)
    text = place.cell.read_text(encoding="utf-8")
    place.cell.write_text(re.sub(r"(?m)^(rotor_inertia_kg_m2|coulomb_nm|viscous_nm_s_rad) = .*\n", "", text))
    place.payload.write_text(LOAD, encoding="utf-8")
    (place.folder / "path.toml").write_text(PATH, encoding="utf-8")
    return place


@pytest.fixture
def plan(untyped, gateway):
    """A short series of all joints, and sweeps as they are planned, fewer and shorter."""
    path = untyped.folder / "plan.json"
    planned = gateway("plan", untyped.cell, "--moving", "--for", "friction", "-o", path)
    assert planned.exit_code == 0, planned.output
    loaded = load_cell(untyped.cell)
    moving_plan = read_plan(path, loaded.cell.arm[0])
    workspace = workspace_of(loaded.cell.arm[0], arm_robot(loaded, loaded.cell.arm[0]))
    sweeps = [each for each in moving_plan.excitations if isinstance(each, Sweep)]
    assert [each.joint for each in sweeps] == [1, 2, 3, 4, 5, 6]
    fewer = tuple(
        replace(each, speeds_rad_s=each.speeds_rad_s[SPEEDS], ends_rad=each.ends_rad[SPEEDS])
        for each in sweeps
        if each.name in SWEPT
    )
    series = swing(workspace, period_s=3.0, periods=2, share=0.9)
    plans = {"series": (series,), "whole": (series, *fewer)}
    for name, excitations in plans.items():
        text = json.dumps(plan_as_plain(replace(moving_plan, excitations=excitations)))
        (untyped.folder / f"{name}.json").write_text(text, encoding="utf-8")
    return {name: untyped.folder / f"{name}.json" for name in plans}


@pytest.mark.slow
def test_what_motion_determines_is_what_is_there(untyped, plan, serve, gateway):
    """Recorded, gone on with, estimated, diagnosed, drawn, and used: every number within its own deviations.

    The unloaded arm goes on with a plan that has more in it.
    """
    drives = serve()

    def drive(label, *more):
        to_file = ["--load", label, "-o", untyped.run, "--bus", drives.bus]
        return gateway("record", untyped.cell, *to_file, "--yes", *more)

    bare = drive("none", "--plan", plan["series"])
    assert bare.exit_code == 0, bare.output
    drives.mount("load")
    loaded = drive("load", "--resume", "--plan", plan["series"], "--json", untyped.folder / "summary.json")
    assert loaded.exit_code == 0, loaded.output
    assert drives.stand_still()
    drives.mount("none")
    swept = drive("none", "--resume", "--plan", plan["whole"])
    assert "4 periods under load none, 2 already recorded" in swept.output
    _check_recording(untyped.recording())
    result = untyped.folder / "result.json"
    done = gateway("estimate", untyped.run, "--cell", untyped.cell, "--json", result)
    assert done.exit_code == 0, done.output
    _check_load(read_result(result).loads[0], read_payloads(untyped.payload)["load"])
    _check_axes(read_result(result).motion, drives.handle.simulation.arms[0].world.plant)
    _check_diagnosis(untyped, gateway)
    _check_page(untyped, gateway, result)
    drives.mount("load")
    _check_use(untyped, gateway, drives, result)


def _check_recording(recording):
    """The load is tried slowly first; each period is there once."""
    (arm,) = recording.arms
    moving_plan = [(each.load, each.name, each.speed, each.period) for each in arm.periods if each.complete]
    series = [("load", "load", 0.25, 1), *((load, "load", 1.0, k) for load in ("load", "none") for k in (1, 2))]
    assert sorted(moving_plan) == sorted([*series, *(("none", name, 1.0, k) for name in SWEPT for k in (1, 2))])
    assert len(moving_plan) == len(arm.periods)


def _check_load(load, true):
    parts = true.inertia_kg_m2[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    off = [load.mass_kg - true.mass_kg, *(load.com_m - true.com_m), *(load.inertia_kg_m2 - parts)]
    std = np.array([load.mass_std_kg, *load.com_std_m, *load.inertia_std_kg_m2])
    _check_scores(np.array(off) / std)
    assert load.mass_std_kg < 0.2
    assert load.inertia_std_kg_m2[2] < 0.01
    assert load.unidentifiable == ()


def _check_axes(motion, plant):
    for name, (joints, most) in DETERMINED.items():
        std = name.replace("_nm", "_std_nm").replace("_kg", "_std_kg")
        done, spread = (np.array([getattr(motion[joint], key) for joint in joints]) for key in (name, std))
        _check_scores((done - getattr(plant, name)[joints]) / spread)
        assert (spread < most * done).all(), name


def _check_scores(score):
    """None is far out, and all together are no further out than their deviations say."""
    assert np.abs(score).max() < 4.0
    assert np.sqrt(np.mean(score**2)) < 1.8


def _check_diagnosis(place, gateway):
    out = place.folder / "diagnosed.json"
    done = gateway("diagnose", place.run, "--cell", place.cell, "--json", out)
    assert done.exit_code == 0, done.output
    result = read_result(out)
    assert {effect.name for effect in result.effects} <= {"velocity_friction"}
    (load,) = result.loads
    assert abs(load.mass_kg - 6.0) < 4.0 * load.mass_std_kg


def _check_page(place, gateway, result):
    page = place.folder / "report.html"
    done = gateway("report", result, "-o", page)
    assert done.exit_code == 0, done.output
    text = page.read_text(encoding="utf-8")
    for heading in ("Inertia about the centre of gravity", "Friction over speed", "One period of the motion"):
        assert heading in text


def _check_use(place, gateway, drives, result):
    """What is fed comes from the file, and the arm follows better with it."""
    out = place.folder / "follow.json"
    files = ["--path", place.folder / "path.toml", result, "--identified", result, "--json", out]
    done = gateway("follow", place.cell, *files, "--bus", drives.bus, "--yes")
    assert done.exit_code == 0, done.output
    followed = follow_from_json(out.read_text(), "follow.json")
    peak = {setting.name: np.array(setting.peak_rad) for setting in followed.settings}
    assert (peak["identified"][[1, 2]] < 0.1 * peak["off"][[1, 2]]).all()
