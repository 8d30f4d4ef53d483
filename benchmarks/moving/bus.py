"""Cells over the bus: simulated drives that a moving plan is recorded with, bare and loaded, and what comes of it."""

from __future__ import annotations

import os
import re
import shutil
import time
import uuid
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from click.testing import CliRunner, Result
from numpy.typing import NDArray

from benchmarks.moving.scores import AXIS_NAMES, LOAD_NAMES, Truth, score
from benchmarks.nature.moving_arm import box_inertia
from gateway.acquire.session import record_moving
from gateway.cell.config import load_cell
from gateway.cli import main
from gateway.excite.excitation import MovingPlan
from gateway.excite.planning import MovingRequest, make_moving_plan
from gateway.jobs.cell_context import open_cell
from gateway.model.arm_model import arm_named
from gateway.result.result import read_result
from sim.plant import Payload
from sim.serve import RunningSimulation, running
from tests.support.rigs.pacing import in_lockstep

Floats = NDArray[np.float64]

EXAMPLES = Path(__file__).parents[2] / "examples"
#: Cells in turn, with the heaviest load [kg], the largest offset of its centre [m], and its longest edge [m].
CELLS = (("small", 8.0, 0.12, 0.3), ("large", 120.0, 0.25, 0.8))
LABEL = "load"
STREAM = 78
PERIOD_S, PERIODS = 10.0, 3
#: Standard deviation of the torque constants, which the cell files state.
GAIN_STD = 0.05
_CONSTANT = re.compile(r"^(torque_constant_nm_per_a = \{.*?) \}", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Place:
    """A folder with the files of one cell, and the body that the simulator mounts on its flange."""

    folder: Path
    tool: Payload

    @property
    def cell(self) -> Path:
        """The cell file."""
        return self.folder / "cell.toml"

    def run(self, label: str) -> Path:
        """Recording under a load."""
        return self.folder / f"{label}.h5"


def set_up(folder: Path, seed: int) -> Place:
    """An example cell in a folder of its own; load, build errors and torque constants are drawn from the seed."""
    name, payload_kg, out_m, edge_m = CELLS[seed % len(CELLS)]
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for file in (EXAMPLES / name).iterdir():
        if file.suffix in (".toml", ".urdf"):
            shutil.copy(file, folder / file.name)
    cell = folder / "cell.toml"
    stated = _CONSTANT.sub(rf"\1, std_percent = {100.0 * GAIN_STD:g} }}", cell.read_text(encoding="utf-8"))
    cell.write_text(in_lockstep(stated), encoding="utf-8")
    rng = np.random.default_rng([seed, STREAM])
    mass, com = float(payload_kg * rng.uniform(0.3, 1.0)), out_m * rng.uniform([-0.5, -0.5, 0.1], [0.5, 0.5, 1.0])
    tool = Payload(LABEL, mass, com, box_inertia(mass, edge_m, rng))
    rows = [f'[[load]]\nlabel = "{LABEL}"\nmass_kg = {mass!r}', f"com_m = {com.tolist()}"]
    rows.append(f"inertia_kg_m2 = {tool.inertia_kg_m2.tolist()}\n")
    (folder / "payload.toml").write_text("\n".join(rows), encoding="utf-8")
    hidden = [f"build_errors = {seed}\n"]
    for joint, off in enumerate((GAIN_STD * np.clip(rng.standard_normal(6), -2.5, 2.5)).tolist(), start=1):
        effect = f"joints = [{joint}]\nparameters = {{ scale = {1.0 / (1.0 + off)!r} }}"
        hidden.append(f'[[effect]]\nname = "torque_constant_scale"\n{effect}\n')
    (folder / "hidden.toml").write_text("\n".join(hidden), encoding="utf-8")
    return Place(folder, tool)


def record_both(place: Place, handle: RunningSimulation, plan: MovingPlan) -> None:
    """Drive a plan bare and loaded."""
    context = open_cell(place.cell, handle.bus, lambda _spec: None)
    arm = arm_named(context.loaded)
    for label in ("none", LABEL):
        handle.mount(label)
        with context.opened(arm) as opened:
            record_moving(opened, plan, label, place.run(label))


def estimated(place: Place) -> Result:
    """`estimate` of both recordings, by the command line."""
    runs = [str(place.run(label)) for label in ("none", LABEL)]
    words = ["estimate", *runs, "--cell", str(place.cell), "--json", str(place.folder / "result.json"), "-q"]
    return CliRunner().invoke(main, words)


def run_bus_cell(job: tuple[int, str]) -> dict:
    """Score of one cell: seed, and the folder that its files go to, in FOLDER/SEED."""
    seed, out = job
    begin = time.monotonic()
    place = set_up(Path(out) / str(seed), seed)
    os.environ["XDG_STATE_HOME"] = str(place.folder / "state")
    plan = make_moving_plan(load_cell(place.cell), None, MovingRequest(period_s=PERIOD_S, periods=PERIODS, seed=seed))
    bus = f"virtual:moving-{uuid.uuid4().hex}"
    files = {"payload": place.folder / "payload.toml", "undeclared": place.folder / "hidden.toml"}
    with running(place.cell, bus, noise_seed=seed, **files) as handle:
        record_both(place, handle, plan)
        truth = _truth(place, handle)
    reported = estimated(place)
    result = read_result(place.folder / "result.json") if reported.exit_code in (0, 7) else None
    return {
        "seed": seed,
        "tier": "bus",
        "cell": CELLS[seed % len(CELLS)][0],
        "refused": "" if result is not None else reported.output,
        "time_s": time.monotonic() - begin,
        **score(truth, result),
    }


def _truth(place: Place, handle: RunningSimulation) -> Truth:
    """What the simulated arm obeys; its Coulomb friction scatters from start to start about the true one."""
    assert handle.simulation is not None
    plant = handle.simulation.arms[0].world.plant
    unknown = np.full(plant.axes, np.nan)
    axes = {
        "coulomb_nm": plant.coulomb_nm,
        "viscous_nm_s_rad": plant.viscous_nm_s_rad,
        "rotor_inertia_kg_m2": plant.rotor_inertia_kg_m2,
        "load_friction": plant.load_friction,
        "delay_s": unknown,
    }
    oracle = {"load": np.full(len(LOAD_NAMES), np.nan)} | dict.fromkeys(AXIS_NAMES, unknown)
    return Truth(place.tool, axes, oracle)
