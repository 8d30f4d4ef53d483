"""FIGAROH in the benchmark: its regressor, its base parameters and its weighted least squares, once for each load.

The load is the difference of the last link's parameters between the loaded and the unloaded run. FIGAROH groups these
parameters with those of other links. The difference is taken through its mapping from standard to base parameters, with
the covariance of its weighted least squares. Its columns for a payload need the true mass, which no cell states.
"""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from figaroh.identification.base_identification import (  # pyright: ignore[reportMissingImports]
        BaseIdentification,
    )
    from figaroh.tools.load_robot import load_robot  # pyright: ignore[reportMissingImports]

from benchmarks.loads.bodies import Identified, identified
from benchmarks.loads.runs import Run, quiet, runs_of
from benchmarks.naming.cells import Cell

Floats = NDArray[np.float64]

#: Parameters of a link in FIGAROH's names; without motion the inertia has no effect.
FIRST_MOMENTS = ("m", "mx", "my", "mz")
INERTIA = ("Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
FRICTION = ("fv", "fs")
AXES = {"coulomb_nm": "fs", "viscous_nm_s_rad": "fv", "rotor_inertia_kg_m2": "Ia"}
#: Share of a parameter that the base parameters determine, above which it is reported; the rest is grouped with others.
DETERMINED = 1.0 - 1e-6
CONFIG = """\
robot:
  name: cell
tasks:
  identification:
    enabled: true
    type: dynamic_identification
    joints:
      active_joints: [{joints}]
    problem:
      model_components: {{friction: {moving}, actuator_inertia: {moving}, joint_offset: {moving}}}
    signal_processing: {{sampling_frequency: 100.0, cutoff_frequency: 10.0}}
"""


class _Identification(BaseIdentification):  # type: ignore[misc]
    """One run; speeds and accelerations are in the table already and need no filter."""

    def __init__(self, robot: Any, config: Path, run: Run) -> None:
        super().__init__(robot, str(config))
        self.run = run
        joints = range(robot.model.nv)
        self.identif_config |= {"act_idxq": list(joints), "act_idxv": list(joints)}

    def load_trajectory_data(self, data_source: str | None = None) -> dict[str, Floats]:
        run = self.run
        return {
            "timestamps": run.time_s,
            "positions": run.q,
            "velocities": run.qd,
            "accelerations": run.qdd,
            "torques": run.tau,
        }

    def process_kinematics_data(self, filter_config: Any = None) -> None:
        self.processed_data = dict(self.raw_data)


@dataclass(frozen=True, slots=True)
class _Base:
    """Base parameters of a run: values (r,), covariance (r, r), mapping (r, n) from the standard parameters `names`."""

    values: Floats
    covariance: Floats
    mapping: Floats
    names: list[str]


def identify(cell: Cell, moving: bool) -> Identified:
    """Identify both runs and take the difference."""
    with tempfile.TemporaryDirectory() as folder, quiet():
        urdf, config = Path(folder) / "robot.urdf", Path(folder) / "config.yaml"
        urdf.write_text(cell.urdf, encoding="utf-8")
        robot = load_robot(str(urdf), package_dirs=folder)
        joints = list(robot.model.names)[1:]
        config.write_text(CONFIG.format(joints=", ".join(joints), moving=str(moving).lower()), encoding="utf-8")
        bare, loaded = (_base(_Identification(robot, config, run), moving) for run in runs_of(cell, moving).values())
    return _difference(bare, loaded, joints, moving)


def _base(task: _Identification, moving: bool) -> _Base:
    task.initialize()
    values = task.solve(decimate=moving, wls=True, plotting=False)
    weighted = task.dynamic_regressor_base * task._wls_row_weight[:, None]
    return _Base(values, np.linalg.inv(weighted.T @ weighted), task._M_matrix, task._params_r_for_recon)


def _difference(bare: _Base, loaded: _Base, joints: list[str], moving: bool) -> Identified:
    """Standard parameters of the unloaded arm and what the load changes: last link and friction, in one fit."""
    if bare.names != loaded.names:
        raise ValueError("the runs excite different parameters")
    own = [f"{name}_{joints[-1]}" for name in (FIRST_MOMENTS + INERTIA if moving else FIRST_MOMENTS)]
    changed = own + [f"{name}_{joint}" for name in (*FRICTION, "off") for joint in joints if moving]
    places = [bare.names.index(name) for name in changed]
    count = len(bare.names)
    upper = np.hstack([bare.mapping, np.zeros((len(bare.values), len(places)))])
    lower = np.hstack([loaded.mapping, loaded.mapping[:, places]])
    design = np.vstack([_whitened(bare, upper), _whitened(loaded, lower)])
    target = np.concatenate([_whitened(bare, bare.values), _whitened(loaded, loaded.values)])
    found = np.asarray(np.linalg.lstsq(design, target, rcond=1e-10)[0], dtype=np.float64)
    covariance = np.asarray(np.linalg.pinv(design.T @ design, rcond=1e-14), dtype=np.float64)
    part = slice(count, count + len(own))
    determined = np.diag(np.linalg.pinv(bare.mapping) @ bare.mapping) > DETERMINED
    alone = dict(zip(bare.names, np.where(determined, found[:count], np.nan), strict=True))
    axes = {key: tuple(float(alone[f"{name}_{joint}"]) for joint in joints) for key, name in AXES.items() if moving}
    return identified(found[part], covariance[part, part], axes)


def _whitened(base: _Base, values: Floats) -> Floats:
    return np.asarray(np.linalg.solve(np.linalg.cholesky(base.covariance), values), dtype=np.float64)
