"""One step of a measurement with `--until`: decide the next pose or the end from the visits measured so far.

Pure functions: inputs are the visits and the present posture, the output is a decision with a checked plan. The run
executes it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.acquire.plan import (
    TYPICAL_SETTLE_S,
    Plan,
    VisitSettings,
    approach_limits,
    check_plan,
    plan_from,
    travel_limits,
)
from gateway.acquire.poses import DISTANCE_RAD, PoseRequest, can_be_measured, feasible_postures
from gateway.acquire.until.choice import Candidates, Narrowness, Sampling, best_first, judge
from gateway.acquire.until.goal import Goal, half_widths
from gateway.data.rest_pose import RestPose
from gateway.data.table import Table, concatenate
from gateway.errors import PlanRefused, WrongPlace
from gateway.estimate.expected_information import PoseNoise, Sought, Stock, information_of_priors, take_stock
from gateway.estimate.options import EstimateOptions
from gateway.identify.rejected import without_outliers
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import Robot
from gateway.model.visits import pair_visits
from gateway.motion.assumed import assumed_noise_nm, reference_load
from gateway.motion.trajectory import straight
from gateway.motion.workspace import BAND_SHARE, Workspace

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


@dataclass(frozen=True, slots=True, eq=False)
class LoadSearch:
    """Load to measure, its goal, and the constant settings of the search.

    Attributes
    ----------
    arm, label : str
    goal : Goal
    robot : Robot
    options : EstimateOptions
    workspace : Workspace
    settings : VisitSettings
        With the largest number of samples per approach direction.
    pool : Candidates
        Measurable postures of the whole joint range.
    guess : array of shape (4,)
        Initial guess [m, hx, hy, hz] of the load.
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
    options: EstimateOptions
    workspace: Workspace
    settings: VisitSettings
    pool: Candidates
    guess: Floats
    earlier: Table | None
    apart_rad: Floats
    number: int
    seed: int
    torque_scale: Floats = field(default_factory=lambda: np.ones(1))


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


def pool_of(workspace: Workspace, request: PoseRequest) -> Candidates:
    """Return candidate postures of the whole joint range.

    Raises
    ------
    PlanRefused
        Too few postures can be measured."""
    q_rad = feasible_postures(workspace.with_clearance(), request, np.random.default_rng(request.seed))[:POOL]
    return Candidates(q_rad, gravity_regressor(workspace.robot, q_rad, workspace.gravity_m_s2))


def guess_of(workspace: Workspace, pool: Candidates) -> Floats:
    """Return an initial guess (4,) of a load: the heaviest of the cell file, else half of what the arm can carry."""
    mass_kg, com_m = reference_load(workspace, pool.q_rad)
    return mass_kg * np.append(1.0, com_m)


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
    table = _together(search.earlier, None if measured is None else measured.with_torque_scaled(search.torque_scale))
    stock = _stock(search, table)
    taken = np.empty((0, search.robot.axes)) if table is None else _poses(table, search.label)
    sampling = Sampling(search.settings.period_s, search.settings.samples)
    goal = search.goal.half_widths(float(stock.information.moment[0]))
    verdict = judge(stock.information, half_widths(stock.load), goal, len(taken), search.pool, sampling)
    if verdict.done or stock.refused is not None:
        return NextStep(stock, verdict, None)
    choice = _choice(search, at_rad, len(taken))
    seconds = _seconds(search, at_rad, choice.q_rad)
    near = np.abs(choice.q_rad[:, None] - np.vstack([taken, search.apart_rad])[None]).max(axis=2, initial=0.0)
    seconds[(near < DISTANCE_RAD).any(axis=1)] = np.inf
    rows, samples = best_first(stock.information, verdict, choice, seconds, sampling)
    number = search.number if measured is None else max(search.number, int(measured.pose.max()) + 1)
    plan = _plan(search, at_rad, choice.q_rad[rows], (number, samples))
    return NextStep(stock, verdict, plan, max(verdict.ahead - 1, 0) * plan.duration_s)


def _together(earlier: Table | None, measured: Table | None) -> Table | None:
    parts = [part for part in (earlier, measured) if part is not None and len(part)]
    return concatenate(parts) if parts else None


def _poses(table: Table, label: str) -> Floats:
    """Return the postures (k, N) at which the load was measured, one per pose."""
    here = table.load == label
    _, first = np.unique(table.pose[here], return_index=True)
    return table.q_rad[here][first]


def _stock(search: LoadSearch, table: Table | None) -> Stock:
    """Return the estimate of the load; before the first sample, the prior knowledge."""
    if table is None:
        band_nm = BAND_SHARE * search.workspace.torque_nm
        noise = PoseNoise(assumed_noise_nm(search.workspace) ** 2, np.zeros(len(band_nm)))
        return Stock(None, None, information_of_priors(search.robot, search.options, search.guess, band_nm, noise))
    found = pair_visits(table, search.options.efficiency, search.options.coupling)
    visits, _ = without_outliers(found, search.robot, search.options.gravity_m_s2)
    sought = Sought(search.label, search.guess, _sample_std_nm(table))
    return take_stock(visits, search.robot, search.options, sought)


def _sample_std_nm(table: Table) -> Floats:
    """Return the median (N,) over the visits of the standard deviation of one sample; NaN where not known."""
    known = np.isfinite(table.tau_std_nm)
    return np.array(
        [
            float(np.median(table.tau_std_nm[known[:, axis], axis])) if known[:, axis].any() else np.nan
            for axis in range(table.axes)
        ]
    )


def _choice(search: LoadSearch, at_rad: Floats, count: int) -> Candidates:
    """Return the pool together with postures near the present one, of which the pool holds few."""
    random = np.random.default_rng([search.seed, count])
    size = random.uniform(_NEAREST_RAD, _FARTHEST_RAD, (NEAR_BY, 1))
    q_rad = at_rad + size * random.uniform(-1.0, 1.0, (NEAR_BY, len(at_rad)))
    request = PoseRequest(1, 0, search.settings.approach_offset_rad, search.seed)
    q_rad = q_rad[can_be_measured(search.workspace.with_clearance(), request, q_rad)]
    near_by = gravity_regressor(search.robot, q_rad, search.options.gravity_m_s2)
    return Candidates(np.vstack([search.pool.q_rad, q_rad]), np.concatenate([search.pool.regressor, near_by]))


def _seconds(search: LoadSearch, at_rad: Floats, q_rad: Floats) -> Floats:
    """Return the time (n,) [s] of the straight path to each pose, both approaches and settling."""
    settings, workspace = search.settings, search.workspace
    offset = np.full(len(at_rad), settings.approach_offset_rad)
    slow = approach_limits(workspace, settings.approach_speed_rad_s)
    across = straight(np.zeros(len(offset)), offset, travel_limits(workspace), settings.period_s).duration_s
    approach = straight(np.zeros(len(offset)), offset, slow, settings.period_s).duration_s
    travel_s = workspace.travel_time(at_rad[None], q_rad + settings.approach_offset_rad)
    return travel_s + across + 2.0 * (approach + min(TYPICAL_SETTLE_S, settings.settle_timeout_s))


def _plan(search: LoadSearch, at_rad: Floats, best_rad: Floats, named: tuple[int, int]) -> Plan:
    """Return the plan of the best reachable pose; `named` is its number and the samples per approach direction."""
    number, samples = named
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
    chosen: Iterable[Floats] = first[free][:1] if free.any() else best_rad[:_AROUND]
    refused: PlanRefused | None = None
    for q_rad in chosen:
        pose = RestPose(number, tuple(q_rad.tolist()), "fit")
        try:
            plan = plan_from(Plan(search.arm, (pose,), settings, None, (), 0.0), search.workspace, at_rad)
            check_plan(plan, search.workspace)
        except WrongPlace as error:
            refused = error
            continue
        return plan
    raise refused or PlanRefused(f"arm '{search.arm}': no path leads to any pose")
