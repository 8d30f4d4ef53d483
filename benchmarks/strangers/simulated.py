"""Six classes of arms on simulated drives, in lockstep: whether `record` of a first run ends."""

from __future__ import annotations

import os
import sys
import tempfile
import uuid
from pathlib import Path

from click.testing import CliRunner

from benchmarks.figure import figure
from gateway.cli import main
from sim.serve import running
from tests.data.arm_classes import CLASSES, ArmClass, write_class


def record(kind: ArmClass, folder: Path) -> tuple[int, str]:
    """Exit code and output of `record` on an arm of that class, its recording `run.h5` in the folder."""
    bus = f"virtual:class-{uuid.uuid4().hex}"
    wire = f'interface = "virtual"\nchannel = "{bus[8:]}"\nsync_period_s = 0.01\npacing = "lockstep"'
    cell = write_class(kind, folder, wire)
    words = ["record", cell, "--bus", bus, "--yes", "--load", "none", "-o", folder / "run.h5"]
    with running(cell, bus):
        done = CliRunner().invoke(main, [str(word) for word in words])
    return done.exit_code, done.output


def figures() -> dict[str, dict]:
    """How many of the classes are recorded."""
    ended = 0
    for name, kind in CLASSES.items():
        with tempfile.TemporaryDirectory() as folder:
            os.environ["XDG_STATE_HOME"] = folder  # every arm is proven again
            code, output = record(kind, Path(folder))
        ended += code == 0
        print(f"{name}: exit {code}{'' if code == 0 else ': ' + output}", file=sys.stderr, flush=True)
    return {"classes of arms whose recording ends": figure(ended, f"== {len(CLASSES)}")}
