"""From a cell file and earlier visits to the search for a load: unloaded arm, and candidate postures."""

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
from gateway.identify.loads import BARE_LABEL
from gateway.motion.workspace import Workspace
from gateway.pipeline.inputs import ModelRequest, collect_inputs, estimate_options, read_rows, split_validation
from gateway.pipeline.known import KnownLoad

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class UntilRequest:
    """A load that shall be known.

    Attributes
    ----------
    label : str
    goal : Goal
    path : Path
        The recording; one that is there is gone on with.
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
    """The search for a load, and the recording that it goes on with.

    Parameters
    ----------
    loaded : LoadedCell
    workspace : Workspace
        Of the arm.
    arm : ArmConfig
    request : UntilRequest
    apart_rad : array of shape (k, N)
        Postures that are kept for judging; where there are any, the rows measured there are left out.

    Raises
    ------
    InputError
        Nothing is known of the unloaded arm, or a file that cannot be used.
    PlanRefused
        There are too few postures that can be measured.
    """
    if request.label == BARE_LABEL:
        raise InputError(
            f"{OPTION}: load '{BARE_LABEL}' is the bare arm, of which no mass is told; measure it without {OPTION}, "
            f"then each load with it"
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
    """Refuse a load on an arm whose own torque is not known."""
    loads = set() if table is None else set(np.unique(table.load).tolist())
    if BARE_LABEL in loads or options.bare is not None or options.trust == 0.0 or loads.intersection(options.known):
        return
    raise InputError(
        f"{OPTION}: {request.path} holds no visit of the bare arm, and no load is told from an arm that is not known: "
        f"measure it bare first (record CELL --load {BARE_LABEL} -o {request.path}, then go on by --resume), or name a "
        "stored bare identification by --bare RESULT.json"
    )


def _free_number(stored: ArmRecording | None) -> int:
    if stored is None:
        return 1
    return max([*(pose.number for pose in stored.poses), *(visit.pose for visit in stored.visits)], default=0) + 1
