"""Scores of loads, friction and torque constants, with the cost of a method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from benchmarks.naming.answers import Answer
from benchmarks.naming.score import load_errors, median_text, number_text, share_text

AXIS_ROWS: Final = {
    "coulomb_nm": "Coulomb friction: median error",
    "viscous_nm_s_rad": "viscous friction: median error",
    "rotor_inertia_kg_m2": "rotor inertia: median error",
}
GAIN_ROW: Final = "torque constants: median error"


def scores(truth: Mapping[str, Mapping[str, Any]], answers: Mapping[str, Answer], memory_mib: float) -> dict[str, str]:
    """Return the text of each row of the table of one method."""
    found, answered = load_errors(truth, answers), {cell for cell, each in answers.items() if each.load is not None}
    out = {
        "cells without a load": f"{len(truth.keys() - answered)} of {len(truth)}",
        "mass: median error": found.mass_median,
        "mass: rms error": found.mass_rms,
        "centre of gravity: median error": found.centre_median,
        "95 % intervals that hold: mass": share_text(found.inside["mass"]),
        "95 % intervals that hold: centre": share_text(found.inside["centre"]),
    }
    if any("axes" in entry for entry in truth.values()):
        inertia = median_text([100.0 * value for value in found.inertia], "%")
        out["inertia: median error"] = inertia if inertia == "-" else f"{inertia} of {len(found.inertia)}"
        out["95 % intervals that hold: inertia"] = share_text(found.inside["inertia"])
        out |= {row: _axis_error(truth, answers, name, True) for name, row in AXIS_ROWS.items()}
        out[GAIN_ROW] = _axis_error(truth, answers, "gain", False)
    out["processor time per cell, median"] = median_text([each.time_s for each in answers.values()], "s")
    out["peak memory of the process"] = number_text(memory_mib, "MiB")
    return out


def _axis_error(
    truth: Mapping[str, Mapping[str, Any]], answers: Mapping[str, Answer], name: str, relative: bool
) -> str:
    """Median error of a quantity over all axes of all cells [%], of the value itself or of one."""
    errors: list[float] = []
    for cell, entry in truth.items():
        if cell in answers and name in answers[cell].axes:
            true = np.array(entry["axes"][name])
            error = np.abs(np.array(answers[cell].axes[name]) - true) / (np.abs(true) if relative else 1.0)
            errors += error[np.isfinite(error)].tolist()
    text = median_text([100.0 * value for value in errors], "%")
    return text if text == "-" else f"{text} of {len(errors)}"
