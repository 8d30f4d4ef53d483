"""`check --timing` on simulated drives in real time: figures against the truth, defects found, false alarms, duration.

python -m benchmarks.certify.drive_test [--seeds 20] [--out out/drive-test] [--pacing real] [--only NAME ..]

- Good drives: one arm per seed, of the makes in turn. Every figure is compared with the truth of the simulator.
- Defects: every fault that the test has to find (`sim.faults`) in one drive of an arm whose other drives are good.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.certify.drive_truth import read_truth
from benchmarks.figure import conclude, figure
from benchmarks.program import options
from sim.faults import KINDS
from sim.serve import running
from tests.support.rigs.pacing import by_the_clock, in_lockstep

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "small"
#: Makes of the drives whose profiles permit motion as they are shipped; the command refuses the others.
MAKES = ("generic-cia402", "maxon-epos4", "kollmorgen-akd-x00606", "kinco-fd123")
#: Faults to find: those of the test alone, and one that it finds as the pre-flight check does.
DEFECTS = (*(kind for kind, about in KINDS.items() if about.reaction == "drive test"), "heartbeat_ignored")
#: Drive that has the defect.
NODE = 2
TIMEOUT_S = 900.0


def tested(make: str, defect: str, seed: int, pacing: str) -> dict:
    """Run the test of six drives; what it reported, the truth, and its duration."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        cell, record = _cell(folder, make, pacing), folder / "timing.npz"
        wanted = (f"{NODE}:{defect}",) if defect else ()
        with running(cell, seed=seed, pacing=pacing, fault=wanted, timing=record) as drives:
            began_s = time.monotonic()
            done = _drive_test(cell, drives.bus, folder)
            lasted_s = time.monotonic() - began_s
        reports = {path.stem: json.loads(path.read_text()) for path in sorted((folder / "out").glob("J*.json"))}
        truth = (
            [each.figures() | {"filter_s": each.filter_s} for each in read_truth(record)] if pacing == "real" else []
        )
    return {
        "make": make,
        "defect": defect,
        "seed": seed,
        "exit": done.returncode,
        "said": done.stderr[-600:],
        "lasted_s": lasted_s,
        "load": os.getloadavg()[0],
        "findings": {axis: report["findings"] for axis, report in reports.items()},
        "figures": [report["figures"] for report in reports.values()],
        "truth": truth,
    }


def _cell(folder: Path, make: str, pacing: str) -> Path:
    """Write the cell of the example with drives of one make; return its path."""
    shutil.copy(EXAMPLE / "robot.urdf", folder)
    text = (EXAMPLE / "cell.toml").read_text(encoding="utf-8")
    text = re.sub(r'(?m)^profile = ".*"$', f'profile = "{make}"', text)
    path = folder / "cell.toml"
    path.write_text(in_lockstep(text) if pacing == "lockstep" else by_the_clock(text), encoding="utf-8")
    return path


def _drive_test(cell: Path, bus: str, folder: Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "gateway.cli", "check", cell, "--timing", "--bus", bus, "--yes"]
    words += ["-o", folder / "out"]
    return subprocess.run(
        [str(word) for word in words],
        env=os.environ | {"XDG_STATE_HOME": str(folder / "state")},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )


def compared(run: dict) -> list[tuple[str, bool]]:
    """Name of each figure of all drives whose truth is known, and whether its interval holds the truth."""
    found: list[tuple[str, bool]] = []
    for figures, truth in zip(run["figures"], run["truth"], strict=False):
        for each in figures:
            true = _true_interval(each["name"], truth, run["defect"])
            if each["interval"] is not None and true is not None:
                low, high = each["interval"]
                found.append((each["name"], low <= true[1] and true[0] <= high))
    return found


def _true_interval(name: str, truth: dict[str, float], defect: str) -> tuple[float, float] | None:
    """Return between which values the truth is; a simulated step of 1 ms limits what is known of the motion."""
    if name == "torque_age_s" and not defect:
        return truth["filter_s"], truth["filter_s"] + 0.001  # the reading is a mean over one simulated step
    if name == "controlword_to_reaction_s" and "sync_to_tpdo_s" in truth:
        delay_s = KINDS[defect].defaults["delay_s"] if defect == "delayed_controlword" else 0.0
        return delay_s, delay_s + truth["sync_to_tpdo_s"]
    if name not in truth:
        return None
    step = 0.001 if name.endswith("_s") and name != "sync_to_tpdo_s" else 0.0
    return truth[name] - step, truth[name] + step


def detected(run: dict) -> bool:
    """Return whether the drive with the defect has a finding, and no other drive has one."""
    named = [axis for axis, findings in run["findings"].items() if findings]
    return named == [f"J{NODE}"] or (not run["findings"] and f"node {NODE}" in run["said"])


def drive_test_figures(good: list[dict], defective: list[dict]) -> dict[str, dict]:
    """Coverage, defects found, false alarms and duration."""
    rows = [row for run in good for row in compared(run)]
    completed = [run for run in good if run["findings"]]
    alarms = sum(bool(texts) for run in completed for texts in run["findings"].values())
    entries = {
        f"timing: truth within the interval, {len(rows)} figures of {len(completed)} arms": figure(
            100.0 * float(np.mean([inside for _, inside in rows])) if rows else float("nan"), ">= 95", "%"
        ),
        f"timing: defects found, of {len(defective)}": figure(sum(map(detected, defective)), ">= 8"),
        f"timing: good drives with a finding, of {6 * len(completed)}": figure(alarms, "== 0"),
        "timing: longest test of six drives": figure(
            max((run["lasted_s"] for run in completed), default=float("nan")), "<= 300", "s"
        ),
    }
    for name in sorted({name for name, _ in rows}):
        inside = [inside for each, inside in rows if each == name]
        share = 100.0 * sum(inside) / len(inside)
        entries[f"timing: {name}, {len(inside)}"] = figure(share, unit="%")
    return entries


def measure_drives(seeds: int, out: Path, pacing: str, only: list[str] | None = None) -> dict[str, dict]:
    """Run good drives and every defect; write the runs to `out`; return the figures."""
    jobs = [(MAKES[seed % len(MAKES)], "", seed) for seed in range(seeds)]
    jobs += [("generic-cia402", name, number) for number, name in enumerate(DEFECTS)]
    out.mkdir(parents=True, exist_ok=True)
    runs: list[dict] = []
    for job in jobs:
        if only is None or (job[1] or "good") in only:
            runs.append(tested(*job, pacing))
            _print_run(runs[-1])
            (out / "drive-test.json").write_text(json.dumps(runs, indent=1) + "\n", encoding="utf-8")
    return drive_test_figures([run for run in runs if not run["defect"]], [run for run in runs if run["defect"]])


def _print_run(run: dict) -> None:
    found = {axis: texts for axis, texts in run["findings"].items() if texts}
    print(run["make"], run["defect"], f"exit {run['exit']}, {run['lasted_s']:.0f} s", found, flush=True)
    if run["exit"] not in (0, 7):
        print("   ", run["said"].strip()[-300:], flush=True)


def main() -> int:
    """Exit 1 when a goal is missed."""
    parser = options(__doc__, "out/drive-test")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--pacing", choices=("real", "lockstep"), default="real")
    parser.add_argument("--only", nargs="*", help="defects, or `good`")
    arguments = parser.parse_args()
    figures = measure_drives(arguments.seeds, arguments.out, arguments.pacing, arguments.only)
    return conclude(figures, arguments.out)


if __name__ == "__main__":
    raise SystemExit(main())
