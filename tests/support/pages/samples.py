"""The pages that are opened: every kind, from results that hold all that such a page can show."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

from benchmarks.pictures import SHOTS, SOURCES
from gateway.report.fleet_page import render_robot
from gateway.report.render import render
from gateway.report.stop import render_stop
from gateway.result.acceptance import Expected, Rating, accepted, not_hung
from gateway.result.fleet import read_robot
from gateway.result.result import NuisanceResult, Result, SetAside, from_json
from tests.support.pages.moving import moving_result
from tests.support.pages.other import forces, gaps, repetitions
from tests.support.pages.result import full_result
from tests.support.pages.stop import stopped

SIX = (0.012, -0.031, 0.004, 0.02, -0.011, 0.007)
BUDGET = {"constants": 0.72, "links": 0.08, "friction": 0.05, "noise": 0.15}


def _stop() -> str:
    with tempfile.TemporaryDirectory() as folder:
        return render_stop(stopped(Path(folder)))


def _with_effects() -> Result:
    """Effects, nuisances, a budget, outlier visits, acceptance that passes, fails and is undecided."""
    found = from_json(json.dumps(full_result()))
    loads = tuple(replace(load, budget=BUDGET) for load in found.loads)
    found = replace(
        found,
        loads=loads,
        nuisance={key: NuisanceResult(SIX, (0.02,) * 6) for key in ("gain", "bias_nm", "load_friction")},
        set_aside=(SetAside("out/run.h5", "tool", 2, 8.4, pose=7, reason="as if a brake had held"),),
    )
    expected = [Expected("tool", 25.0, 0.5), Expected("tool+part", 71.5, 0.3)]
    return accepted(found, expected, [Rating("mass", 60.0, "rated load, datasheet p. 2")])


def _estimated(found: Result) -> Result:
    return replace(found, verdict=None, effects=(), rejected=(), holdout_kind=None, acceptance=(), findings=())


def _refused(found: Result) -> Result:
    first, *rest = found.loads
    reason = "rows 9 and 10 exceed the rated torque of the motor: 31.2 Nm against 23.9 Nm"
    nothing = replace(first, mass_kg=float("nan"), com_m=None, com_flange_m=None, per_pose_mass_kg={}, refused=reason)
    return replace(_estimated(found), loads=(nothing, *rest))


def _not_mounted(found: Result) -> Result:
    load = replace(found.loads[0], mass_kg=0.004, mass_std_kg=0.006, com_m=None, com_flange_m=None)
    bare = replace(_estimated(found), loads=(load,), verdict="none_needed")
    return replace(bare, findings=not_hung(bare.loads))


#: HTML text of every page by its name.
PAGES: Final[dict[str, Callable[[], str]]] = {
    "result": lambda: render(_with_effects()),
    "estimate": lambda: render(_estimated(_with_effects())),
    "refused": lambda: render(_refused(_with_effects())),
    "not-mounted": lambda: render(_not_mounted(_with_effects())),
    "moving": lambda: render(moving_result()),
    "pair": forces,
    "gap": gaps,
    "repeatability": repetitions,
    "stop": _stop,
    "fleet-robot": lambda: render_robot(read_robot(SOURCES / "fleet-robot.json")),
    **{name: page for name, (page, *_) in SHOTS.items() if name != "live"},
}
