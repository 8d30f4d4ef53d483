"""Time under power for a load at rest with `--until`, over the time for all poses of the cell.

Both examples over the virtual bus, in lockstep, by SYNC. The unloaded arm and the load are measured at all poses of the
cell and the holdout, and estimated with known torque constants. Then the same load is measured with `--until` at the
half widths of that result, the widest coordinate representing the centre of gravity.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from click.testing import CliRunner

from benchmarks.figure import figure
from gateway.cli import main
from gateway.result.numerals import half_width
from gateway.result.result import read_result
from sim.serve import running
from tests.support.rigs.pacing import in_lockstep

EXAMPLES = Path(__file__).parents[2] / "examples"
ARMS = ("large", "small")
LABEL = "load"
PERIOD_S = 0.01
#: Relative standard deviation [%] of torque constants that are as good as exact.
EXACT_PERCENT = 0.001
CONSTANT = re.compile(r'(torque_constant_nm_per_a = \{ value = [0-9.]+, source = "[^"]*")( *\})')


def figures(arms: Sequence[str] = ARMS) -> dict[str, dict]:
    """Time under power with the stopping rule over the time of today's poses, by example."""
    found: dict[str, dict] = {}
    for arm in arms:
        today_s, until_s, poses = times(arm)
        found[f"{arm} arm: time under power, no longer than needed over today's poses"] = figure(
            until_s / today_s, "<= 0.6"
        )
        found |= {
            f"{arm} arm: {name}": figure(value, unit=unit)
            for name, value, unit in (
                ("time of today's poses", today_s, "s"),
                ("time until as well known", until_s, "s"),
                ("poses until as well known", float(poses), ""),
            )
        }
    return found


def times(arm: str) -> tuple[float, float, int]:
    """Time of all poses of the cell [s], time until the load is as well known [s], and how many poses that took."""
    with _place(arm) as folder:
        cell, run, today = folder / "cell.toml", folder / "run.h5", folder / "today.h5"
        bus = f"virtual:until-{uuid.uuid4().hex}"
        with running(cell, bus, payload=folder / "payload.toml") as handle:
            moved = ("--bus", bus, "--yes", "-q")
            _gateway("record", cell, "--load", "none", "-o", run, *moved)
            handle.mount(LABEL)
            shutil.copy(run, today)
            today_s = _time_s(folder, "record", cell, "--load", LABEL, "-o", today, "--resume", *moved)[0]
            _gateway("estimate", today, "--cell", cell, "--json", folder / "today.json")
            (load,) = read_result(folder / "today.json").loads
            assert load.com_std_m is not None
            mass_kg, com_m = half_width(load.mass_std_kg), half_width(float(np.max(load.com_std_m)))
            goal = f"mass={mass_kg:.9g}kg,com={com_m:.9g}m"
            asked = ("record", cell, "--load", LABEL, "-o", run, "--resume", "--until", goal)
            until_s, summary = _time_s(folder, *asked, *moved)
    assert summary["until"]["reached"], summary["until"]["reason"]
    return today_s, until_s, summary["until"]["poses"]


@contextmanager
def _place(arm: str) -> Iterator[Path]:
    """A folder with the files of an example, its constants known, its own state folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in ("robot.urdf", "payload.toml"):
            shutil.copy(EXAMPLES / arm / file, folder / file)
        text = in_lockstep((EXAMPLES / arm / "cell.toml").read_text())
        text, count = CONSTANT.subn(rf"\1, std_percent = {EXACT_PERCENT} }}", text)
        assert count == 6, count
        (folder / "cell.toml").write_text(text)
        with mock.patch.dict(os.environ, {"XDG_STATE_HOME": str(folder / "state")}):
            yield folder


def _gateway(*arguments: object) -> None:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output


def _time_s(folder: Path, *arguments: object) -> tuple[float, dict[str, Any]]:
    """Time [s] of a command by the SYNCs that it took, and its summary."""
    _gateway(*arguments, "--json", folder / "summary.json")
    summary = json.loads((folder / "summary.json").read_text())
    return summary["statistics"]["cycles"] * PERIOD_S, summary
