"""Requests to stop at random instants of proofs, brake test, bring-up, motion and disabling; brakes that fail."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.chaos.requests import fall, fall_without_voltage, requests
from benchmarks.figure import figure

INSTANTS, SEED = 200, 33
PERIODS_S = (0.004, 0.01)
FALLS_RAD_S2 = (2.0, 5.0, 10.0)
#: Joints that carry the arm.
JOINTS = (2, 3)
LIMIT_RAD = 0.02


def figures(scope: Any) -> dict[str, dict]:
    """Ask, and let brakes fail."""
    number = scope.count(INSTANTS)
    answers = requests(number, SEED, scope.bar("requests to stop", number).step)
    scope.complain(answers.delayed)
    out = {
        f"stop requests at {number} instants: not answered within 1 SYNC and the ramp": figure(
            len(answers.delayed), "<= 0", ""
        ),
        "longest path of setpoints after a request, beyond the ramp": figure(max(answers.syncs), "<= 1", "SYNCs"),
    }
    bar = scope.bar("brakes that fall", len(PERIODS_S) * len(FALLS_RAD_S2) * len(JOINTS))
    with tempfile.TemporaryDirectory() as folder:
        for period_s in PERIODS_S:
            largest = 0.0
            for joint in JOINTS:
                for acceleration in FALLS_RAD_S2:
                    angle_rad, finding = fall(period_s, acceleration, joint, Path(folder))
                    scope.print(f"{1000 * period_s:g} ms, {acceleration:g} rad/s2: {finding}", markup=False)
                    largest = max(largest, angle_rad)
                    bar.step()
            name = f"largest angle of a brake that falls at 2 to 10 rad/s2, SYNC {1000 * period_s:g} ms"
            out[name] = figure(largest, f"<= {LIMIT_RAD}", "rad")
            largest = max(fall_without_voltage(period_s, acceleration) for acceleration in FALLS_RAD_S2)
            out[f"{name}, only without voltage"] = figure(largest, f"<= {LIMIT_RAD}", "rad")
    return out
