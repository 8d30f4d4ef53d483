"""Prepare the search for a load from a cell file and earlier visits: the unloaded arm, and candidate postures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.acquire.planning import visit_settings
from gateway.acquire.poses import PoseRequest
from gateway.acquire.until.goal import OPTION, Goal
from gateway.acquire.until.search import LoadSearch, guess_of, pool_of
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.data.recording.reader import read
from gateway.data.recording.recorded import ArmRecording, Recording
from gateway.data.table import Table
from gateway.errors import InputError
from gateway.estimate.options import EstimateOptions
from gateway.identify.prior_loads import BARE_LABEL
from gateway.motion.workspace import Workspace
from gateway.pipeline.inputs import ModelRequest, collect_inputs, estimate_options, read_rows, split_validation
from gateway.pipeline.known import KnownLoad

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class UntilRequest:
    """Load to measure, and its goal.

    Attributes
    ----------
    label : str
    goal : Goal
    path : Path
        The recording; an existing one is continued.
    cell : Path
        The cell file.
    bare : Path or None
        A result that holds a stored bare identification.
    known : mapping of label to (mass [kg], x, y, z [m] in the last link)
        Loads in the recording that were weighed.
    """

    label: str
    goal: Goal
    path: Path
    cell: Path
    bare: Path | None = None
    known: Mapping[str, KnownLoad] = field(default_factory=dict)


def search_of(
    loaded: LoadedCell, workspace: Workspace, arm: ArmConfig, request: UntilRequest, apart_rad: Floats
) -> tuple[LoadSearch, Recording | None]:
    """Return the search for a load, and the recording that it continues.

    Parameters
    ----------
    loaded : LoadedCell
    workspace : Workspace
        Workspace of the arm.
    arm : ArmConfig
    request : UntilRequest
    apart_rad : array of shape (k, N)
        Postures reserved for validation; samples measured there are left out.

    Raises
    ------
    InputError
        The unloaded arm is not identified, or a file cannot be used.
    PlanRefused
        Too few postures can be measured.
    """
    if request.label == BARE_LABEL:
        raise InputError(
            f"{OPTION}: load '{BARE_LABEL}' is the unloaded arm, for which no mass is estimated; measure it without"
            f" {OPTION}, then each load with {OPTION}"
        )
    earlier = read(request.path) if request.path.exists() else None
    stored = None if earlier is None else earlier.arm(arm.name)
    measured = stored is not None and any(visit.complete for visit in stored.visits)
    paths = [request.path] if measured else []
    about = collect_inputs(ModelRequest(cell=request.cell, arm=arm.name, bare=request.bare, known=request.known), paths)
    table = read_rows(paths, about) if measured else None
    if table is not None and len(apart_rad):
        table = split_validation(table)[0]
    options = estimate_options(about)
    _refuse_unknown_arm(request, table, options)
    poses = loaded.cell.poses
    pool = pool_of(workspace, PoseRequest(poses.count, poses.validation, poses.approach_offset_rad, poses.seed))
    search = LoadSearch(
        arm=arm.name,
        label=request.label,
        goal=request.goal,
        robot=about.model,
        options=options,
        workspace=workspace,
        settings=visit_settings(loaded, arm),
        pool=pool,
        guess=guess_of(workspace, pool),
        earlier=table,
        apart_rad=apart_rad,
        number=_free_number(stored),
        seed=poses.seed,
        torque_scale=np.ones(about.model.axes) if about.calibrated is None else about.calibrated.scale,
    )
    return search, earlier


def _refuse_unknown_arm(request: UntilRequest, table: Table | None, options: EstimateOptions) -> None:
    """Refuse a load on an arm whose own torque is not identified."""
    loads = set() if table is None else set(np.unique(table.load).tolist())
    if BARE_LABEL in loads or options.bare is not None or options.trust == 0.0 or loads.intersection(options.known):
        return
    raise InputError(
        f"{OPTION}: {request.path} holds no visit of the unloaded arm, and a load cannot be estimated without one:"
        f" measure the unloaded arm first (record CELL --load {BARE_LABEL} -o {request.path}, then continue with"
        " --resume), or name a stored identification of the unloaded arm with --bare RESULT.json"
    )


def _free_number(stored: ArmRecording | None) -> int:
    if stored is None:
        return 1
    return max([*(pose.number for pose in stored.poses), *(visit.pose for visit in stored.visits)], default=0) + 1
