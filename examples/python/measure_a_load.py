"""Measure the load of an arm from Python: check the drives, record the unloaded arm and the load, estimate the load.

    python examples/python/measure_a_load.py FOLDER

The drives are those of `examples/small`, simulated in lockstep in this process. On a robot `running` and the second and
third argument of `locked_cell` fall away, and `ask` and `mount` ask a person.
"""

import sys
from pathlib import Path

from gateway.api import ModelRequest, estimate
from gateway.jobs.cell_context import locked_cell
from gateway.jobs.check import check
from gateway.jobs.frame import Operator, stoppable
from gateway.jobs.measure import record
from sim.serve import running

CELL = Path(__file__).resolve().parents[1] / "small" / "cell.toml"
BUS = "virtual:measure-a-load"
#: Rest poses [rad]; without them those that the cell plans.
POSES = [
    (0.0, 0.2, 0.1, 0.0, -0.1, 0.7),
    (0.3, 0.6, -0.9, 0.7, 0.2, 1.4),
    (-0.3, 1.4, -1.0, 1.5, 0.9, 0.0),
    (0.2, 1.0, -1.1, -1.0, -1.2, -0.4),
    (-0.2, 0.5, -0.6, 0.1, 1.3, -0.6),
]


def main(folder: Path) -> None:
    """Check, measure, estimate, and print the load."""
    recording = folder / "run.h5"
    operator = Operator(ask=lambda question, _meanwhile: print(f"{question} yes"), say=print)
    with (
        running(CELL, BUS, payload=CELL.with_name("payload.toml"), pacing="lockstep") as drives,
        locked_cell(CELL, BUS, "lockstep") as cell,
        stoppable() as options,
    ):
        for finding in check(cell):
            if finding.severity in ("warn", "fail"):
                print(f"{finding.severity}: {finding.where}: {finding.what}")
        for load in ("none", "gripper"):
            drives.mount(load)
            summary = record(cell, load, recording, operator, options, poses=POSES, resume=True)
            print(f"{summary.visits} visits under load {load}: {summary.reason}")
    for load in estimate(recording, ModelRequest(cell=CELL)).loads:
        print(f"load {load.label}: {load.mass_kg:.2f} kg, standard deviation {load.mass_std_kg:.2f} kg")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
