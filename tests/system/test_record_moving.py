"""record --moving against simulated drives: bare, then loaded, then the load's mass."""

from __future__ import annotations

import json

import pytest

from gateway.cell.config import load_cell
from gateway.excite.plan_file import plan_as_plain
from gateway.model.arm_model import arm_robot
from gateway.motion.workspace import workspace_of
from tests.excitations import plan_of

pytestmark = pytest.mark.system


@pytest.fixture
def drive(place, gateway):
    """Record a short plan in motion; fewer SYNCs than usual, which only the accelerations mind."""
    loaded = load_cell(place.cell)
    workspace = workspace_of(loaded.cell.arm[0], arm_robot(loaded, loaded.cell.arm[0]))
    path = place.folder / "plan.json"
    path.write_text(json.dumps(plan_as_plain(plan_of(workspace, period_s=2.5, periods=2, share=0.6))), encoding="utf-8")

    def run(drives, label, *more):
        arguments = ["record", place.cell, "--moving", "--load", label, "-o", place.run, "--bus", drives.bus]
        return gateway(*arguments, "--rate", 100, "--yes", *more)

    run.plan = path
    return run


def test_a_load_is_weighed_in_motion(place, serve, drive, gateway):
    """The load is tried slowly first; the file's own plan is gone on with."""
    drives = serve()
    bare = drive(drives, "none", "--plan", drive.plan)
    assert bare.exit_code == 0, bare.output
    drives.hang("load")
    loaded = drive(drives, "load", "--resume", "--json", place.folder / "summary.json")
    assert loaded.exit_code == 0, loaded.output
    assert drives.stand_still()
    (arm,) = place.recording().arms
    whole = [(each.load, each.speed, each.period) for each in arm.periods if each.complete]
    assert sorted(whole) == [("load", 0.25, 1), ("load", 1.0, 1), ("load", 1.0, 2), ("none", 1.0, 1), ("none", 1.0, 2)]
    assert len(whole) == len(arm.periods)
    again = drive(drives, "load", "--resume")
    assert "0 periods under load load, 2 were there already" in again.output
    result = gateway("estimate", place.run, "--cell", place.cell, "--json", place.folder / "result.json")
    assert result.exit_code == 0, result.output
    (load,) = json.loads((place.folder / "result.json").read_text())["loads"]
    assert abs(load["mass_kg"] - 6.0) < 2.5 * load["mass_std_kg"]
    assert load["mass_std_kg"] < 0.5


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--moving", "--pose", "0,0,0,0,0,0"], "give one of them"),
        (["--rate", "100"], "belong to --moving"),
        (["--moving", "--plan", "nowhere.json"], "nowhere.json"),
    ],
)
def test_what_does_not_fit_together_is_refused(place, gateway, options, says):
    refused = gateway("record", place.cell, "--load", "none", "-o", place.run, *options)
    assert refused.exit_code in (2, 3)
    assert says in refused.output
