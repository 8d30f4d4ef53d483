"""The load found with 1 % of all answers lost, against the same without loss."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.chaos.rig import EXAMPLE, Rig
from benchmarks.figure import figure
from gateway.acquire.planning import make_plan
from gateway.acquire.session import record
from gateway.data.recording.reader import read
from gateway.estimate.joint import estimate_joint
from gateway.model.visits import pair_visits
from gateway.pipeline.inputs import ModelRequest, collect_inputs, read_rows
from sim.faults import fault_of

LOST = 0.01
POSES = 6


def figures(scope: Any) -> dict[str, dict]:
    """Record bare and loaded, without and with loss, and estimate both."""
    bar = scope.bar("load with 1 % of frames lost", 2)
    found = []
    for share in (0.0, LOST):
        with tempfile.TemporaryDirectory(prefix="load-") as folder:
            path, missing = recorded(Path(folder), share)
            found.append((*estimated(path), missing))
        bar.step()
    (clean, clean_std, _), (lossy, _, gaps) = found
    apart = np.abs(lossy - clean) / clean_std
    return {
        "load with 1 % lost, apart from without": figure(float(apart.max()), "<= 1", "std"),
        "gaps reported at 1 % lost": figure(gaps, ">= 1", "SYNC"),
    }


def few_poses(text: str) -> str:
    """Edit of a cell's text."""
    text = re.sub(r"(?m)^count = \d+", f"count = {POSES}", text)
    return re.sub(r"(?m)^validation = \d+", "validation = 0", text)


def recorded(folder: Path, share: float) -> tuple[Path, int]:
    """Recording of the bare and of the loaded arm; number of incomplete SYNCs that the statistics report."""
    path = folder / "run.h5"
    missing = 0
    with Rig(folder, few_poses, payload=EXAMPLE / "payload.toml") as rig:
        for label in ("none", "load"):
            rig.renew()
            rig.simulation.mount(label)
            with rig.open() as opened:
                plan = make_plan(opened.loaded, POSES)
                if share:
                    rig.wire.arm_in(fault_of("tpdo_random_loss", syncs=0, share=share, seed=3), 50)
                summary = record(opened, plan, label, path, read(path) if path.exists() else None)
                missing += int(summary.statistics["incomplete"])
    return path, missing


def estimated(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Mass [kg] and centre of gravity [m] of the load with their standard deviations."""
    about = collect_inputs(ModelRequest(), [path])
    visits = pair_visits(read_rows([path], about), about.knowledge.efficiency)
    load = next(each for each in estimate_joint(visits, about.robot, about.knowledge).loads if each.label == "load")
    value = np.concatenate([[load.mass_kg], load.com_m])
    return value, np.concatenate([[load.mass_std_kg], load.com_std_m])
