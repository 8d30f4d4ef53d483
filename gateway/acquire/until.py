"""Measurement with `--until`: pose by pose, each chosen from the visits measured so far, until the load is known.

`search_of` prepares the search from a cell file and earlier visits. `decide` is pure: from the visits and the present
posture to the next pose with its checked plan, or to the end. `chosen_poses` lets the run loop execute the decisions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.acquire.events import Listener, Narrowed
from gateway.acquire.plan import (
    SIDES,
    TYPICAL_SETTLE_S,
    Plan,
    VisitSettings,
    check_plan,
    plan_from,
    travel_limits,
)
from gateway.acquire.planning import visit_settings
from gateway.acquire.poses import DISTANCE_RAD, can_be_measured, feasible_postures
from gateway.acquire.run_loop import MotionSource
from gateway.acquire.session import RecordingSummary, record_motions
from gateway.acquire.until_goal import OPTION, Goal, Narrowness, best_first, ended, half_widths, judge, narrowed
from gateway.cell.config import ArmConfig, LoadedCell
from gateway.data.recording.recorded import ArmRecording, Recording
from gateway.data.table import Table, concatenate
from gateway.data.visit import RestPose, Visit
from gateway.errors import InputError, PlanRefused, WrongPlace
from gateway.estimate.expected_information import PoseNoise, Sought, Stock, information_of_priors, take_stock
from gateway.identify.knowledge import Knowledge
from gateway.identify.outliers import without_outliers
from gateway.identify.prior_loads import BARE_LABEL
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import pair_visits
from gateway.motion.assumed import assumed_noise_nm, reference_load
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.motion.trajectory import straight_duration_s
from gateway.motion.workspace import BAND_SHARE, Workspace
from gateway.pipeline.inputs import ModelRequest, inputs_from_recordings, read_rows, split_validation

Floats = NDArray[np.float64]

#: Number of candidate postures of the whole joint range.
POOL: Final = 240
#: Number of candidates near the present posture, drawn at each step; smallest and largest distance [rad].
NEAR_BY: Final = 240
_NEAREST_RAD, _FARTHEST_RAD = DISTANCE_RAD, 1.2
#: Best ones whose straight paths are checked together, and those that are tried over postures in between where none is
#: free.
_STRAIGHT: Final = 24
_AROUND: Final = 3

#: Conversion of visits to the samples that an estimation reads.
Rows = Callable[[Sequence[Visit]], Table]


@dataclass(frozen=True, slots=True, eq=False)
class LoadSearch:
    """Load to measure, its goal, and the constant settings of the search.

    Attributes
    ----------
    arm, label : str
    goal : Goal
    robot : Robot
    knowledge : Knowledge
    workspace : Workspace
    settings : VisitSettings
        With the largest number of samples per approach direction.
    pool_rad : array of shape (n, N)
        Measurable postures of the whole joint range.
    earlier : Table or None
        Earlier data: the unloaded arm, other loads, this load.
    apart_rad : array of shape (k, N)
        Validation postures, from which poses keep a distance.
    number : int
        First unused pose number.
    seed : int
    torque_scale : array of shape (N,)
        Ratio of true to measured torque; already applied to `earlier`.
    """

    arm: str
    label: str
    goal: Goal
    robot: Robot
    knowledge: Knowledge
    workspace: Workspace
    settings: VisitSettings
    pool_rad: Floats
    earlier: Table | None
    apart_rad: Floats
    number: int
    seed: int
    torque_scale: Floats


@dataclass(frozen=True, slots=True, eq=False)
class NextStep:
    """Decision of the search: the next pose, or the end.

    Attributes
    ----------
    stock : Stock
    verdict : Narrowness
    plan : Plan or None
        Plan of the next pose from the present posture; None = end of the measurement.
    expected_s : float
        Expected time of the further poses.
    """

    stock: Stock
    verdict: Narrowness
    plan: Plan | None
    expected_s: float = 0.0


def search_of(
    loaded: LoadedCell,
    workspace: Workspace,
    arm: ArmConfig,
    label: str,
    goal: Goal,
    path: Path,
    earlier: Recording | None,
    model: ModelRequest,
    apart_rad: Floats,
) -> LoadSearch:
    """Return the search for a load.

    Parameters
    ----------
    loaded : LoadedCell
    workspace : Workspace
        Workspace of the arm.
    arm : ArmConfig
    label : str
    goal : Goal
    path : Path
        The recording.
    earlier : Recording or None
        Its content so far.
    model : ModelRequest
        Cell and arm; a stored identification of the unloaded arm, and weighed loads of the recording.
    apart_rad : array of shape (k, N)
        Postures reserved for validation; samples measured there are left out.

    Raises
    ------
    InputError
        The unloaded arm is not identified, or the stored one cannot be used.
    PlanRefused
        Too few postures can be measured.
    """
    if label == BARE_LABEL:
        raise InputError(
            f"{OPTION}: load '{BARE_LABEL}' is the unloaded arm, for which no mass is estimated; measure it without"
            f" {OPTION}, then each load with {OPTION}"
        )
    stored = None if earlier is None else earlier.arm(arm.name)
    measured = [earlier] if earlier and stored and any(visit.complete for visit in stored.visits) else []
    about = inputs_from_recordings(model, measured)
    table = read_rows([recording.path for recording in measured], about) if measured else None
    if table is not None and len(apart_rad):
        table = split_validation(table)[0]
    knowledge = about.knowledge.of_robot(about.model)
    loads = set() if table is None else set(np.unique(table.load).tolist())
    known_arm = BARE_LABEL in loads or knowledge.bare is not None or knowledge.trust == 0.0
    complete = {label for label, load in knowledge.stated_loads.items() if load.com_m is not None}
    if not known_arm and not loads & complete:
        raise InputError(
            f"{OPTION}: {path} holds no visit of the unloaded arm, and a load cannot be estimated without one:"
            f" measure the unloaded arm first (record CELL --load {BARE_LABEL} -o {path}, then continue with"
            " --resume), or name a stored identification of the unloaded arm with --bare RESULT.json"
        )
    poses = loaded.cell.poses
    count, random = poses.count + poses.validation, np.random.default_rng(poses.seed)
    used = [] if stored is None else [*(pose.number for pose in stored.poses), *(visit.pose for visit in stored.visits)]
    return LoadSearch(
        arm=arm.name,
        label=label,
        goal=goal,
        robot=about.model,
        knowledge=knowledge,
        workspace=workspace,
        settings=visit_settings(loaded, arm),
        pool_rad=feasible_postures(workspace.with_clearance(), count, poses.approach_offset_rad, random)[:POOL],
        earlier=table,
        apart_rad=apart_rad,
        number=max(used, default=0) + 1,
        seed=poses.seed,
        torque_scale=np.ones(about.model.axes) if about.calibrated is None else about.calibrated.scale,
    )


def decide(search: LoadSearch, measured: Table | None, at_rad: Floats) -> NextStep:
    """Return the estimate from the visits, and the next pose to measure.

    Parameters
    ----------
    search : LoadSearch
    measured : Table or None
        Visits of this run.
    at_rad : array of shape (N,)
        Present posture.

    Raises
    ------
    PlanRefused
        The present posture is not allowed, or no path leads to a useful pose.
    InputError, DataUnusable
        As raised by the joint estimator.
    """
    workspace, settings, gravity_m_s2 = search.workspace, search.settings, search.knowledge.gravity_m_s2
    tables = [search.earlier, None if measured is None else measured.with_torque_scaled(search.torque_scale)]
    filled = [table for table in tables if table is not None and len(table)]
    table = concatenate(filled) if filled else None
    stock, taken_rad = _stock(search, table), np.empty((0, search.robot.axes))
    if table is not None:
        mine = table.load == search.label
        taken_rad = table.q_rad[mine][np.unique(table.pose[mine], return_index=True)[1]]
    pool = gravity_regressor(search.robot, search.pool_rad, gravity_m_s2)
    goal = search.goal.half_widths(float(stock.information.moment[0]))
    half = half_widths(stock.load)
    verdict = judge(stock.information, half, goal, len(taken_rad), pool, settings.samples)
    if verdict.done or stock.refused is not None:
        return NextStep(stock, verdict, None)

    # candidates: the pool, and postures near the present one, of which the pool holds few
    random = np.random.default_rng([search.seed, len(taken_rad)])
    size = random.uniform(_NEAREST_RAD, _FARTHEST_RAD, (NEAR_BY, 1))
    near_rad = at_rad + size * random.uniform(-1.0, 1.0, (NEAR_BY, len(at_rad)))
    near_rad = near_rad[can_be_measured(workspace.with_clearance(), settings.approach_offset_rad, near_rad)]
    q_rad = np.vstack([search.pool_rad, near_rad])
    regressor = np.concatenate([pool, gravity_regressor(search.robot, near_rad, gravity_m_s2)])

    # time of the straight path to each, both approaches and settling
    offset = np.full(len(at_rad), settings.approach_offset_rad)
    across = straight_duration_s(0.0 * offset, offset, travel_limits(workspace))
    approach = straight_duration_s(0.0 * offset, offset, travel_limits(workspace, settings.approach_speed_rad_s))
    seconds = workspace.travel_time(at_rad[None], q_rad + settings.approach_offset_rad)
    seconds += across + 2.0 * (approach + min(TYPICAL_SETTLE_S, settings.settle_timeout_s))
    distance = np.abs(q_rad[:, None] - np.vstack([taken_rad, search.apart_rad])[None]).max(axis=2, initial=0.0)
    seconds[(distance < DISTANCE_RAD).any(axis=1)] = np.inf

    rows, samples = best_first(stock.information, verdict, regressor, seconds, settings.period_s, settings.samples)
    number = search.number if measured is None else max(search.number, int(measured.pose.max()) + 1)
    plan = _plan(search, at_rad, q_rad[rows], number, samples)
    return NextStep(stock, verdict, plan, max(verdict.ahead - 1, 0) * plan.duration_s)


def _stock(search: LoadSearch, table: Table | None) -> Stock:
    """Return the estimate of the load; before the first sample, the prior knowledge.

    The first guess of the load is the heaviest of the cell file, else half of what the arm can carry.
    """
    mass_kg, com_m = reference_load(search.workspace, search.pool_rad)
    guess = mass_kg * np.append(1.0, com_m)
    if table is None:
        band_nm = BAND_SHARE * search.workspace.torque_nm
        noise = PoseNoise(assumed_noise_nm(search.workspace) ** 2, np.zeros(len(band_nm)))
        return Stock(None, None, information_of_priors(search.robot, search.knowledge, guess, band_nm, noise))
    paired = pair_visits(table, search.knowledge.efficiency, search.knowledge.coupling)
    visits, _ = without_outliers(paired, search.robot, search.knowledge.gravity_m_s2)
    known = np.isfinite(table.tau_std_nm)
    std_nm = [  # of one sample: the median over the visits
        float(np.median(table.tau_std_nm[known[:, axis], axis])) if known[:, axis].any() else np.nan
        for axis in range(table.axes)
    ]
    return take_stock(visits, search.robot, search.knowledge, Sought(search.label, guess, np.array(std_nm)))


def _plan(search: LoadSearch, at_rad: Floats, best_rad: Floats, number: int, samples: int) -> Plan:
    """Return the plan of the best reachable pose."""
    if not len(best_rad):
        raise PlanRefused(
            f"arm '{search.arm}': every measurable posture is within {DISTANCE_RAD} rad of a measured one; widen the"
            " limits in the cell file, or give a larger half width in --until"
        )
    settings = replace(search.settings, samples=samples)
    first = best_rad[:_STRAIGHT]
    free = search.workspace.with_clearance().path_clear(
        np.repeat(at_rad[None], len(first), axis=0), first + settings.approach_offset_rad
    )
    refused: PlanRefused | None = None
    for q_rad in first[free][:1] if free.any() else best_rad[:_AROUND]:
        pose = RestPose(number, tuple(q_rad.tolist()), "fit")
        try:
            plan = plan_from(Plan(search.arm, (pose,), settings, None, (), 0.0), search.workspace, at_rad)
            check_plan(plan, search.workspace)
        except WrongPlace as error:
            refused = error
            continue
        return plan
    raise refused or PlanRefused(f"arm '{search.arm}': no path leads to any pose")


def chosen_poses(search: LoadSearch, rows: Rows, at_rad: np.ndarray, decisions: list[NextStep]) -> MotionSource:
    """Yield the poses that the search decides on; the estimate is computed while the arm is at rest.

    Parameters
    ----------
    search : LoadSearch
    rows : Rows
    at_rad : array of shape (N,)
        Present posture.
    decisions : list of NextStep
        Every decision is added.
    """
    visits: list[Visit] = []
    decision = decide(search, None, at_rad)
    decisions.append(decision)
    while decision.plan is not None:
        further = len(SIDES) * max(decision.verdict.ahead - 1, 0)
        run = yield decision.plan, decision.expected_s, further
        visits += run.measured
        measured, at_rad = rows(visits), np.array(run.stream.q_rad[0])
        decision = run.stream.hold_while(lambda table=measured, at=at_rad: decide(search, table, at), "estimate")
        decisions.append(decision)
        verdict = decision.verdict
        run.notify(Narrowed(search.label, verdict.poses, narrowed(verdict, ends=decision.plan is None)))
    return ended(decision.stock, decision.verdict, search.label)


def record_until(
    opened: OpenArm,
    search: LoadSearch,
    path: Path,
    earlier: Recording | None,
    listeners: Sequence[Listener] = (),
    options: MoveOptions | None = None,
) -> tuple[RecordingSummary, NextStep]:
    """Measure a load pose by pose until its uncertainty is small enough or no pose helps; then apply the brakes.

    Parameters
    ----------
    opened : OpenArm
    search : LoadSearch
    path : Path
    earlier : Recording or None
        Existing content of the file, which is continued.
    listeners : sequence of Listener
    options : MoveOptions, optional

    Returns
    -------
    RecordingSummary, NextStep
        What was added, and the last decision.

    Raises
    ------
    InputError, PlanRefused, DriveError, KeyboardInterrupt
        As `record_motions`.
    """
    cell, name = opened.loaded.cell, opened.config.name

    def rows(visits: Sequence[Visit]) -> Table:
        """Convert visits to samples, as when read from the file."""
        arm = ArmRecording(name, (), tuple(visits), opened.constants, [], [], {})
        return Recording(path, "", "", "", "", cell, "", "", {}, (arm,)).table(name)

    decisions: list[NextStep] = []
    motions = chosen_poses(search, rows, opened.arm.where(), decisions)
    summary = record_motions(opened, motions, search.label, path, earlier, listeners=listeners, options=options)
    return summary, decisions[-1]
