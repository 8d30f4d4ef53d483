"""One arm that is calibrated with a weighed load on one day, and the load that is measured with it on another day."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.calibrated.nature import (
    AXES,
    OCCASION_S,
    as_table,
    at_rest,
    draw,
    occasion_gain,
    poses,
    stated_urdf,
)
from benchmarks.cell_file import invoked, write_cell_file
from gateway.data.table import write_csv
from gateway.identify.drift import AGAIN


def next_load(seed: int, pose_count: int, gain_std: float) -> tuple[np.ndarray, dict | str, list[str]]:
    """Return the true next load (4,), the load that `estimate` answers or why there is none, and its warnings.

    `calibrate` reads a weighed load between two unloaded blocks; `estimate` reads the unloaded arm and the next load.
    Every block has a change of gain of its own.
    """
    cell = draw(seed, gain_std)
    weight = np.array([0.5 * cell.arm.rated_kg, *(0.04 * cell.arm.rated_kg**0.34 * cell.rng.standard_normal(3))])
    weighed, q_rad, place_nm = replace(cell, load=weight), poses(cell, pose_count), np.zeros((pose_count, AXES))
    blocks = [(cell, "none", "r0"), (weighed, "weight", "r0"), (cell, "none", "r1"), (cell, "none", "r2")]
    blocks.append((cell, "tool", "r2"))
    rows = [
        at_rest(arm, q_rad, load, run, number * OCCASION_S, occasion_gain(cell), place_nm, repeats=1)
        for number, (arm, load, run) in enumerate(blocks)
    ]
    again = [row | {"pose": row["pose"] + AGAIN} for row in rows[2]]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "arm.urdf").write_text(stated_urdf(cell), encoding="utf-8")
        write_cell_file(folder, cell.arm.rated_kg, cell.arm.geometry.limit_rad, 100.0 * cell.band_nm, gain_std)
        for file, block in (("weighed.csv", rows[0] + rows[1] + again), ("next.csv", rows[3] + rows[4])):
            write_csv(as_table(block), folder / file)
        known = "weight=" + ",".join(f"{value:.9g}" for value in weight)
        code, said = invoked("calibrate", folder / "cell.toml", "--known", known, "--from", folder / "weighed.csv")
        if code:
            return cell.load, f"calibrate: exit {code}: {said[-300:]}", []
        answer = folder / "answer.json"
        _, said = invoked("estimate", folder / "next.csv", "--cell", folder / "cell.toml", "--json", answer)
        if not answer.exists():
            return cell.load, f"estimate: {said[-300:]}", []
        result = json.loads(answer.read_text(encoding="utf-8"))
    warnings = [finding["what"] for finding in result["findings"] if finding["severity"] != "info"]
    return cell.load, result["loads"][0], warnings
