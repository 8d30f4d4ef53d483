"""A simulated cell, identified and followed through the gateway's own commands; the simulator keeps its truth.

The model of the gateway differs from that of the simulator: links drawn with build errors, datasheet rotor inertia
rounded. Friction is only as the rest poses show it, the load as it was identified.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from click.testing import Result

from gateway.cell.config import load_cell
from gateway.excite.plan_file import plan_as_plain
from gateway.excite.planning import MovingRequest, make_moving_plan
from gateway.feedforward.dynamics import ArmDynamics
from gateway.feedforward.law import FeedforwardLaw
from gateway.follow.comparison import result_of
from gateway.follow.path_run import follow
from gateway.follow.settings import Prepared, Setting, prepare
from gateway.jobs.cell_context import open_cell
from gateway.model.arm_model import arm_named
from gateway.result.follow import FollowResult
from gateway.result.result import read_result, to_json
from sim.serve import RunningSimulation, running
from tests.support.rigs.command_line import run as command
from tests.support.rigs.pacing import in_lockstep

EXAMPLES = Path(__file__).parents[3] / "examples"
LABEL = "load"


@dataclass(frozen=True)
class Place:
    """A folder with the files of one example cell."""

    folder: Path
    path: Path

    @property
    def cell(self) -> Path:
        return self.folder / "cell.toml"

    @property
    def result(self) -> Path:
        return self.folder / "result.json"

    def changed_cell(self, name: str, pattern: str, new: str) -> Path:
        """Write a cell file that differs from the simulated arm."""
        text, count = re.subn(pattern, new, self.cell.read_text())
        assert count, pattern
        (self.folder / f"{name}.toml").write_text(text)
        return self.folder / f"{name}.toml"

    def result_with(self, name: str, factor: float) -> Path:
        """The identified load with another mass."""
        result = read_result(self.result)
        loads = tuple(replace(load, mass_kg=factor * load.mass_kg) for load in result.loads)
        changed = replace(result, loads=loads, after=replace(result.after, loads=loads))
        (self.folder / f"{name}.json").write_text(to_json(changed))
        return self.folder / f"{name}.json"


def nothing_typed(place: Place, handle: RunningSimulation, seed: int) -> tuple[Path, Path]:
    """The cell without rotors and friction, and the result of its moving runs, bare and loaded; the load stays mounted.

    One series of all joints, for the load, friction and rotors: three periods of 10 s under each load.
    """
    cell = place.changed_cell("untyped", r"(?m)^(rotor_inertia_kg_m2|coulomb_nm|viscous_nm_s_rad) = .*\n", "")
    request = MovingRequest(("load", "friction", "rotor"), friction_by="series", seed=seed)
    plan, run, result = (place.folder / f"moving.{suffix}" for suffix in ("plan.json", "h5", "json"))
    plan.write_text(json.dumps(plan_as_plain(make_moving_plan(load_cell(cell), None, request))))
    for label in ("none", LABEL):
        handle.mount(label)
        words = ["--plan", plan, "--load", label, "-o", run, "--resume", "--bus", handle.bus, "--yes", "-q"]
        changed_cell = command("record", cell, *words)
        assert changed_cell.exit_code == 0, changed_cell.output
    changed_cell = command("estimate", run, "--cell", cell, "--json", result, "-q")
    assert changed_cell.exit_code == 0, changed_cell.output
    text = cell.read_text().replace("[[arm]]\n", f'[[arm]]\nidentified = "{result.name}"\n', 1)
    cell.write_text(text)
    return cell, result


def set_up(folder: Path, example: str) -> Place:
    """Copy an example cell into a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in (EXAMPLES / example).iterdir():
        if file.suffix in (".toml", ".urdf", ".csv"):
            shutil.copy(file, folder / file.name)
    cell = folder / "cell.toml"
    cell.write_text(in_lockstep(cell.read_text(encoding="utf-8")), encoding="utf-8")
    os.environ["XDG_STATE_HOME"] = str(folder / "state")
    path = next(folder / name for name in ("path.toml", "path.csv") if (folder / name).exists())
    return Place(folder, path)


@contextmanager
def drives(place: Place, build_errors: int, **options: object) -> Iterator[RunningSimulation]:
    """Simulated drives of the cell with links that differ from the drawing; `options` of `ServeOptions`."""
    hidden = place.folder / "hidden.toml"
    hidden.write_text(f"build_errors = {build_errors}\n")
    bus = f"virtual:follow-{uuid.uuid4().hex}"
    with running(place.cell, bus, payload=place.folder / "payload.toml", undeclared=hidden, **options) as handle:
        yield handle


def identify(place: Place, handle: RunningSimulation) -> None:
    """Record bare and loaded, estimate; the load stays on the flange."""
    for label in ("none", LABEL):
        handle.mount(label)
        run = place.folder / f"{label}.h5"
        changed_cell = command("record", place.cell, "--load", label, "-o", run, "--bus", handle.bus, "--yes", "-q")
        assert changed_cell.exit_code == 0, changed_cell.output
    runs = [place.folder / "none.h5", place.folder / f"{LABEL}.h5"]
    changed_cell = command("estimate", *runs, "--cell", place.cell, "--json", place.result, "-q")
    assert changed_cell.exit_code == 0, changed_cell.output


def follow_command(place: Place, handle: RunningSimulation, load: Path, out: Path, *options: object) -> Result:
    """`servo-gateway follow` with JSON and report, of the place's own cell."""
    files = ["--path", place.path, load, "--json", out.with_suffix(".json")]
    return command("follow", place.cell, *files, "-o", out, "--bus", handle.bus, "--yes", "-q", *options)


class VelocityAlone(FeedforwardLaw):
    """The velocity offset of a law, without its torque offset."""

    def offsets(self, *state: list[float]) -> tuple[list[float], list[float]]:
        return super().offsets(*state)[0], [0.0] * 6


def velocity_alone(prepared: Prepared) -> Setting:
    """A fourth setting: what the velocity offset does by itself."""
    model, load = prepared.model, prepared.settings[-1].load
    assert load is not None
    parameters = model.links.copy()
    parameters[50:] += load.parameters
    law = VelocityAlone(ArmDynamics(model.robot, parameters, model.gravity_m_s2), model.axes, model.coupling)
    return Setting("velocity alone", law, None)


def followed(handle: RunningSimulation, cell: Path, path: Path, load: Path, *names: str) -> FollowResult:
    """The result of a job under the named settings only."""
    context = open_cell(cell, handle.bus, lambda _spec: None)
    prepared = prepare(context.loaded, arm_named(context.loaded), path, load)
    settings = (*prepared.settings, velocity_alone(prepared))
    chosen = tuple(setting for setting in settings if setting.name in names)
    with context.opened(prepared.arm, offsets=("velocity", "torque")) as opened:
        tracks = follow(opened.arm, prepared.workspace, prepared.path, chosen, lambda what, done: None)
    return result_of(replace(prepared, settings=chosen), tracks)


def peaks(result: FollowResult) -> dict[str, np.ndarray]:
    """Peak following error (6,) of each setting."""
    return {setting.name: np.array(setting.peak_rad) for setting in result.settings}
