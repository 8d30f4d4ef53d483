"""Blind cells over the bus: drives with what a seed hides, the gateway's `commission`, scored against the truth."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from gateway.result.result import UNKNOWN_THREE, Result, read_result
from sim.blind import LEAST_STRENGTH

EXAMPLES = Path(__file__).parents[2] / "examples"
#: Cells in turn, with the class of their payload [kg] and the largest offset of its centre of gravity [m].
CELLS = (("small", 8.0, 0.12), ("large", 120.0, 0.25))
TIMEOUT_S = 1200.0
REFUSED = 7


def run_bus_cell(job: tuple[int, str]) -> dict:
    """Commission one cell whose undeclared effects come from a seed.

    Parameters
    ----------
    job : (seed, folder)
        The files of the cell go to FOLDER/SEED.
    """
    seed, out = job
    folder = Path(out) / str(seed)
    folder.mkdir(parents=True, exist_ok=True)
    name, payload_kg, reach_m = CELLS[seed % len(CELLS)]
    rng = np.random.default_rng([seed, 11])
    mass, com = payload_kg * rng.uniform(0.3, 1.0), reach_m * rng.uniform([-0.5, -0.5, 0.1], [0.5, 0.5, 1.0])
    payload = f'[[load]]\nlabel = "load"\nmass_kg = {mass:.3f}\ncom_m = [{", ".join(f"{v:.4f}" for v in com)}]\n'
    (folder / "payload.toml").write_text(payload, encoding="utf-8")
    for old in ("result.json", "report.html", "run.h5"):
        (folder / old).unlink(missing_ok=True)
    words = [sys.executable, "-m", "sim.demo", "--cell", str(EXAMPLES / name / "cell.toml")]
    words += ["--payload", str(folder / "payload.toml"), "--seed", str(seed), "-o", str(folder)]
    begin = time.monotonic()
    with (folder / "log.txt").open("w", encoding="utf-8") as log:
        done = subprocess.run(words, stdout=log, stderr=log, timeout=TIMEOUT_S, check=False)
    path = folder / "result.json"
    ended = done.returncode in (0, REFUSED) and path.exists() and (folder / "report.html").exists()
    result = read_result(path) if ended else None
    finished = result is not None and "truth" in result.extra
    return _score(seed, name, result if finished else None, time.monotonic() - begin)


def _score(seed: int, name: str, result: Result | None, time_s: float) -> dict:
    """What is kept of one cell, as of the cells without a bus; None = the job did not end."""
    truth = {"effects": [], "loads": []} if result is None else result.extra["truth"]
    effects = [effect for effect in truth["effects"] if effect.get("strength", np.inf) >= LEAST_STRENGTH]
    return {
        "seed": seed,
        "cell": name,
        "finished": result is not None,
        "kind": ("clean", "one", "two")[len(effects)],
        "truth": [[effect["name"], list(effect["joints"])] for effect in effects],
        "strengths": [effect.get("strength", 1e9) for effect in effects],
        "found": [] if result is None else [[effect.name, list(effect.joints)] for effect in result.effects],
        "verdict": "none: the job did not end" if result is None else result.verdict,
        "inside": [] if result is None else _inside(result, truth),
        "time_s": time_s,
    }


def _inside(result: Result, truth: dict) -> list[bool]:
    """Whether the 95 % intervals of mass, x, y, z hold the truth; none where the load itself moved."""
    if any(effect["name"] == "payload_shift" for effect in truth["effects"]):
        return []
    known = {load["label"]: load for load in truth["loads"]}
    out = []
    for load in result.loads:
        true = known[load.label]
        value = np.array([load.mass_kg, *(load.com_m or UNKNOWN_THREE)])
        std = np.array([load.mass_std_kg, *(load.com_std_m or UNKNOWN_THREE)])
        off = np.abs(value - np.array([true["mass_kg"], *true["com_m"]]))
        # what is not known is not inside
        out += (off < 1.96 * std).tolist() if np.isfinite(value).all() else [False] * 4
    return out
