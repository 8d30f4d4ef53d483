"""Measured runs of real robots: fitted on the first four fifths, judged on the last, which no choice has seen.

python -m benchmarks.measured [--out out/measured]; the runs are found through SERVO_GATEWAY_DATA.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Final

import numpy as np

from gateway.data.table import Table, read_csv
from gateway.diagnose import DiagnoseOptions, diagnose
from gateway.model.robot import robot_from_urdf
from gateway.report.words import short
from gateway.result.result import Result

RUNS: Final = ("kr300/run_A.csv", "tx40/run_1_first.csv", "ur10/run_1_first.csv")
JUDGED: Final = 0.2


def split(table: Table) -> tuple[Table, Table]:
    """Rows to fit, and the last fifth of the time."""
    end = float(table.time_s.max() - JUDGED * np.ptp(table.time_s))
    return table.take(table.time_s <= end), table.take(table.time_s > end)


def judged(path: Path) -> tuple[Result, float]:
    """Diagnosis of a run, and how long it took [s]."""
    urdf = path.parent / "robot.urdf"
    robot = robot_from_urdf(urdf.read_text(encoding="utf-8"), str(urdf))
    fitted, held = split(read_csv(path, None))
    start = time.perf_counter()
    return diagnose(fitted, robot, DiagnoseOptions(holdout=held)), time.perf_counter() - start


def main(argv: list[str]) -> int:
    """Print the residual of every axis without and with what was found."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measured", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/measured"))
    arguments = parser.parse_args(argv)
    data = os.environ.get("SERVO_GATEWAY_DATA")
    if not data:
        print("SERVO_GATEWAY_DATA names no folder with the measured runs", file=sys.stderr)
        return 2
    found: dict[str, dict] = {}
    for name in RUNS:
        result, seconds = judged(Path(data) / name)
        print(f"{name}: {', '.join(short(effect.name, effect.joints) for effect in result.effects)}, {seconds:.1f} s")
        for joint, pair in enumerate(zip(result.before.holdout_rms_nm, result.after.holdout_rms_nm, strict=True), 1):
            print(f"  J{joint}: {pair[0]:8.2f} to {pair[1]:8.2f} Nm")
            found[f"{name} J{joint}: held-out RMS after over before"] = {"value": pair[1] / pair[0], "unit": ""}
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "summary.json").write_text(json.dumps({"figures": found}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
