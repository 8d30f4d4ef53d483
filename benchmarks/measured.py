"""Measured runs of real robots: chosen on the first run's rows, judged on rows that chose nothing.

python -m benchmarks.measured [--out out/measured]; the runs are found through SERVO_GATEWAY_DATA. Of each robot a run
`*_first.csv` or `run_A.csv` chooses. Any other run in its folder judges; where there is none, the last fifth of the
time. The interval of a ratio is that of a bootstrap over stretches of time.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.figure import conclude, figure
from benchmarks.program import options
from gateway.data.rows import concatenate
from gateway.data.table import Table, read_csv
from gateway.diagnose import diagnose
from gateway.model.robot import robot_from_urdf
from gateway.report.notation import short
from gateway.result.result import Result

RUNS: Final = ("kr300/run_A.csv", "tx40/run_1_first.csv", "ur10/run_1_first.csv")
JUDGED: Final = 0.2


def split(table: Table) -> tuple[Table, Table]:
    """Rows to fit, and the last fifth of the time."""
    end = float(table.time_s.max() - JUDGED * np.ptp(table.time_s))
    return table.take(table.time_s <= end), table.take(table.time_s > end)


def rows_of(path: Path) -> tuple[Table, Table, str]:
    """Rows that choose, rows that judge, and what those are."""
    table = read_csv(path, None)
    others = sorted(other for other in path.parent.glob("run_*.csv") if other != path)
    if not others:
        return *split(table), "last fifth of the run"
    return table, concatenate([read_csv(other, None) for other in others]), ", ".join(other.name for other in others)


def judged(path: Path) -> tuple[Result, str, float]:
    """Diagnosis of a run, what judged it, and how long it took [s]."""
    urdf = path.parent / "robot.urdf"
    robot = robot_from_urdf(urdf.read_text(encoding="utf-8"), str(urdf))
    fitted, held, kind = rows_of(path)
    start = time.perf_counter()
    return diagnose(fitted, robot, holdout=held), kind, time.perf_counter() - start


def main() -> int:
    """Print the residual of every axis without and with what was found."""
    arguments = options(__doc__, "out/measured").parse_args()
    data = os.environ.get("SERVO_GATEWAY_DATA")
    if not data:
        print("SERVO_GATEWAY_DATA names no folder with the measured runs", file=sys.stderr)
        return 2
    found: dict[str, dict[str, object]] = {}
    for name in RUNS:
        result, kind, seconds = judged(Path(data) / name)
        named = ", ".join(short(effect.name, effect.joints) for effect in result.effects) or "nothing named"
        print(f"{name}, judged by {kind}: {named}, {seconds:.1f} s")
        rms = zip(result.before.holdout_rms_nm, result.after.holdout_rms_nm, strict=True)
        for joint, (pair, ratio) in enumerate(zip(rms, result.quality["holdout_ratio"], strict=True), 1):
            value, low, high = ratio
            print(f"  J{joint}: {pair[0]:8.2f} to {pair[1]:8.2f} Nm, ratio {value:.2f} ({low:.2f} to {high:.2f})")
            key = f"{name} J{joint}: held-out RMS after over before"
            found[key] = figure(value, interval=(low, high))
    return conclude(found, arguments.out)


if __name__ == "__main__":
    raise SystemExit(main())
