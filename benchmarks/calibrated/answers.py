"""Tables of a condition, and what the estimator states of their loads: `answer_of`.

`workpiece` is a part as the difference of two loads, `next_load` a load after a calibration with another one.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from benchmarks.calibrated.conditions import CONDITIONS
from benchmarks.calibrated.nature import (
    AXES,
    OCCASION_S,
    Floats,
    as_table,
    at_rest,
    draw,
    excitation,
    in_motion,
    missing_torque,
    occasion_gain,
    place_torques,
    poses,
    stated_urdf,
)
from benchmarks.cell_file import invoked, write_cell_file
from gateway.data.table import write_csv
from gateway.errors import GatewayError
from gateway.estimate import run
from gateway.identify.drift import AGAIN
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import robot_from_urdf


def answer_of(task: tuple[int, str]) -> dict:
    """Deviation of the estimate of one table, in stated standard deviations, and these.

    Returns
    -------
    dict
        `refused`: why there is no estimate, else ""; `z`: (4,) of mass and centre, `std`: (4,), `warnings`: keys. Of a
        part also `error_kg`, and `apart_kg` of the difference of two results.
    """
    seed, name = task
    condition = CONDITIONS[name]
    if condition.kind == "next load":
        return {"seed": seed, "condition": name} | _deviation(*next_load(seed, condition.poses, condition.gain_std))
    if condition.kind.startswith("part"):
        true, load, apart_kg = workpiece(seed, condition.kind, condition.poses, condition.gain_std)
        errors = {"error_kg": load["mass_kg"] - true[0], "apart_kg": apart_kg}
        return {"seed": seed, "condition": name} | errors | _deviation(true, load, [])
    cell = draw(seed, condition.gain_std)
    q_rad, motion = poses(cell, condition.poses), excitation(cell)
    place_nm = place_torques(cell, condition.poses, condition.repeats) + missing_torque(cell, condition.missing, q_rad)
    rows: list[dict] = []
    occasions = [("none", k) for k in range(condition.unloaded)] + [("tool", k) for k in range(condition.loaded)]
    for number, (load, k) in enumerate(sorted(occasions, key=lambda entry: entry[1])):
        recording = f"r{k}" if condition.paired else f"{load}{k}"
        gain, start_s = occasion_gain(cell), number * OCCASION_S
        if condition.kind != "motion":
            rows += at_rest(cell, q_rad, load, recording, start_s, gain, place_nm, condition.repeats)
        if condition.kind != "rest":
            rows += in_motion(cell, motion, load, recording, start_s + 0.5 * OCCASION_S, gain)
    options = Knowledge(link_std=0.05, gain_std=(condition.gain_std,) * 6)
    answer: dict = {"seed": seed, "condition": name}
    try:
        result = run(as_table(rows), robot_from_urdf(stated_urdf(cell), "drawn.urdf"), options, condition.method)
    except GatewayError as error:
        return answer | _deviation(cell.load, str(error), [])
    warnings = [finding.what for finding in result.findings if finding.severity != "info"]
    return answer | _deviation(cell.load, asdict(result.loads[0]), warnings)


def _deviation(true: Floats, load: dict | str, warnings: list[str]) -> dict:
    """Deviation of a load from the true one (4,), in stated standard deviations, and these; a text says why not."""
    if isinstance(load, str) or load["mass_kg"] is None or load["com_m"] is None or None in load["com_m"]:
        why = load if isinstance(load, str) else load.get("refused") or "not determined"
        return {"refused": why, "z": None, "std": None, "warnings": warnings}
    values, stds = (np.array([load[f"mass{key}_kg"], *load[f"com{key}_m"]], dtype=float) for key in ("", "_std"))
    deviation, std = (values - true) / stds, stds / np.abs(true)
    return {"refused": "", "z": deviation.tolist(), "std": std.tolist(), "warnings": warnings}


def workpiece(seed: int, kind: str, pose_count: int, gain_std: float) -> tuple[Floats, dict, float]:
    """Return the true workpiece (4,), its load by one fit, and the error [kg] of the difference of two results.

    The one fit has the unloaded arm and both loads; each of the two results is of a recording with one load, an
    unloaded run and poses of its own. Every block has a change of gain of its own.
    """
    cell = draw(seed, gain_std)
    spread_m = 0.09 * 0.45 * cell.arm.rated_kg**0.34
    mass_kg = cell.arm.rated_kg * cell.rng.uniform([0.1, 0.1], [0.4, 0.5])
    both = np.column_stack([mass_kg, spread_m * cell.rng.standard_normal((2, 3))])
    gripper, part = both
    places, blocks = [(poses(cell, pose_count), excitation(cell)) for _ in range(2)], []
    order = [("none", None), ("gripper", gripper), ("both", both), ("none", None), ("both", both)]
    for number, (label, load) in enumerate(order):
        loaded = cell if load is None else replace(cell, load=load)
        q_rad, motion = places[number // 3]
        when, gain = (label, f"r{number // 3}", number * OCCASION_S), occasion_gain(cell)
        if kind == "part in motion":
            blocks.append(in_motion(loaded, motion, *when, gain))
        else:
            blocks.append(at_rest(loaded, q_rad, *when, gain, np.zeros((pose_count, AXES)), repeats=1))
    knowledge = Knowledge(link_std=0.05, gain_std=(gain_std,) * AXES)
    robot = robot_from_urdf(stated_urdf(cell), "drawn.urdf")
    stated = replace(knowledge, parts={"part": ("both", "gripper")})
    loads = run(as_table([*blocks[0], *blocks[1], *blocks[2]]), robot, stated).loads
    alone = [run(as_table([*blocks[a], *blocks[b]]), robot, knowledge).loads[0].mass_kg for a, b in ((0, 1), (3, 4))]
    return part, asdict(next(load for load in loads if load.label == "part")), alone[1] - alone[0] - part[0]


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
