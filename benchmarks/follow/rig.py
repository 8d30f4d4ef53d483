"""A simulated cell, identified and followed through the gateway's own commands; the simulator keeps its truth.

What the gateway is told differs from what the simulator obeys: links drawn with build errors, datasheet rotor inertia
rounded, friction only as the rest poses show it, the load as it was identified.
"""

from __future__ import annotations

import os
import re
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner, Result
from numpy.typing import NDArray

from benchmarks.rigs.pacing import in_lockstep
from gateway.cli import main
from gateway.commands.cell_context import open_cell
from gateway.feedforward.dynamics import ArmDynamics
from gateway.feedforward.law import FeedforwardLaw
from gateway.follow.comparison import result_of
from gateway.follow.job import FollowRequest, Prepared, drive, prepare
from gateway.follow.settings import Setting
from gateway.model.arm_model import arm_named
from gateway.motion.opening import open_arm
from gateway.result.follow import FollowResult
from gateway.result.result import AxisMotion, read_result, to_json
from sim.cellfile import read_cell, read_payloads
from sim.nominal import plant_of
from sim.serve import RunningSimulation, running

Floats = NDArray[np.float64]

EXAMPLES = Path(__file__).parents[2] / "examples"
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

    def told(self, name: str, pattern: str, new: str) -> Path:
        """A cell file that tells the gateway something else than the simulator obeys."""
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


@dataclass(frozen=True)
class Truth:
    """What the simulator obeys, as far as motion tells it: per axis, and of the load about its centre of gravity."""

    rotor_kg_m2: Floats
    coulomb_nm: Floats
    viscous_nm_s_rad: Floats
    inertia_kg_m2: Floats


def truth(place: Place) -> Truth:
    """From the files that the simulator reads."""
    plant = plant_of(read_cell(place.cell).arms[0])
    load = read_payloads(place.folder / "payload.toml")[LABEL]
    return Truth(plant.rotor_inertia_kg_m2, plant.coulomb_nm, plant.viscous_nm_s_rad, np.asarray(load.inertia_kg_m2))


def nothing_typed(place: Place, seed: int) -> tuple[Path, Path]:
    """The cell without rotors and friction, and the result with them as motion tells them: true values with errors.

    Standard deviations of 2 % of a rotor, 1.5 % of Coulomb and 2.5 % of viscous friction, 5 % of the largest principal
    inertia of the load; errors are drawn from them.
    """
    random, true, told = np.random.default_rng(seed), truth(place), read_result(place.result)

    def drawn(values: Floats, share: float) -> tuple[Floats, Floats]:
        std = np.asarray(share * np.abs(values))
        return values + std * random.normal(size=values.shape), std

    sizes = [
        drawn(values, share)
        for values, share in ((true.rotor_kg_m2, 0.02), (true.coulomb_nm, 0.015), (true.viscous_nm_s_rad, 0.025))
    ]
    motion = tuple(
        AxisMotion(
            joint,
            rotor_inertia_kg_m2=rotor,
            rotor_inertia_std_kg_m2=rotor_std,
            coulomb_nm=coulomb,
            coulomb_std_nm=coulomb_std,
            viscous_nm_s_rad=viscous,
            viscous_std_nm_s_rad=viscous_std,
        )
        for joint, (rotor, rotor_std, coulomb, coulomb_std, viscous, viscous_std) in enumerate(
            np.column_stack([part for size in sizes for part in size]).tolist(), start=1
        )
    )
    own = true.inertia_kg_m2[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    std = np.full(6, 0.05 * np.linalg.eigvalsh(true.inertia_kg_m2)[-1])
    inertia, spread = (tuple(values.tolist()) for values in (own + std * random.normal(size=6), std))
    loads = tuple(replace(load, inertia_kg_m2=inertia, inertia_std_kg_m2=spread) for load in told.loads)
    result = place.folder / "moving.json"
    changed = replace(told, motion=motion, loads=loads, after=replace(told.after, loads=loads))
    result.write_text(to_json(changed))
    cell = place.told("untyped", r"(?m)^(rotor_inertia_kg_m2|coulomb_nm|viscous_nm_s_rad) = .*\n", "")
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
def drives(place: Place, build_errors: int, **options: Path) -> Iterator[RunningSimulation]:
    """Simulated drives of the cell with links that differ from the drawing; `options` of `ServeOptions`."""
    hidden = place.folder / "hidden.toml"
    hidden.write_text(f"build_errors = {build_errors}\n")
    bus = f"virtual:follow-{uuid.uuid4().hex}"
    with running(place.cell, bus, payload=place.folder / "payload.toml", undeclared=hidden, **options) as handle:
        yield handle


def command(*arguments: object) -> Result:
    """Run the command line in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def identify(place: Place, handle: RunningSimulation) -> None:
    """Record bare and loaded, estimate; the load stays on the flange."""
    for label in ("none", LABEL):
        handle.hang(label)
        run = place.folder / f"{label}.h5"
        told = command("record", place.cell, "--load", label, "-o", run, "--bus", handle.bus, "--yes", "-q")
        assert told.exit_code == 0, told.output
    runs = [place.folder / "none.h5", place.folder / f"{LABEL}.h5"]
    told = command("estimate", *runs, "--cell", place.cell, "--json", place.result, "--force", "-q")
    assert told.exit_code == 0, told.output


def follow_command(place: Place, handle: RunningSimulation, load: Path, out: Path, *options: object) -> Result:
    """`servo-gateway follow` with JSON and report, of the place's own cell."""
    files = ["--path", place.path, "--load", load, "--json", out.with_suffix(".json")]
    return command(
        "follow", place.cell, *files, "--report", out, "--bus", handle.bus, "--yes", "--force", "-q", *options
    )


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


def followed(handle: RunningSimulation, cell: Path, request: FollowRequest, *names: str) -> FollowResult:
    """The result of a job under the named settings only."""
    context = open_cell(cell, handle.bus)
    prepared = _prepared(context, request, names)
    override = replace(context.override(prepared.arm), feedforward=True)
    with open_arm(context.loaded, override, prepared.arm.name) as opened:
        return result_of(drive(opened, prepared, lambda what, done: None))


def _prepared(context: Any, request: FollowRequest, names: tuple[str, ...]) -> Prepared:
    prepared = prepare(context.loaded, arm_named(context.loaded), request)
    settings = (*prepared.settings, velocity_alone(prepared))
    chosen = tuple(setting for setting in settings if setting.name in names)
    return replace(prepared, settings=chosen)
