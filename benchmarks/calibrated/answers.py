"""One table of a condition and what the estimator states of its load."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from benchmarks.calibrated.conditions import CONDITIONS
from benchmarks.calibrated.nature import (
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
from benchmarks.calibrated.next_load import next_load
from benchmarks.calibrated.part import workpiece
from gateway.errors import GatewayError
from gateway.estimate import run
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
