"""Guided commissioning: check, unloaded arm, each load, diagnosis, further poses, validation poses, result, report.

If the cell defines a loading posture, the arm moves there before the operator mounts a load. Every drive is read before
that prompt. All data is stored in one file, which is consistent after each visit.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from gateway.acquire.goto import LOADING, destination, plan_transfer
from gateway.acquire.plan import SIDES, Plan, check_plan, plan_poses
from gateway.acquire.planning import make_plan, postures_to_ask
from gateway.acquire.session import record
from gateway.acquire.thermal import Block, blocks_of, bracket_of, warm_up
from gateway.acquire.until import decide, record_until, search_of
from gateway.acquire.until_goal import Goal, end_of
from gateway.cell.config import ArmConfig
from gateway.data.recording.recorded import Recording
from gateway.data.table import Table
from gateway.data.visit import RestPose
from gateway.diagnose import close_loop
from gateway.errors import PlanRefused
from gateway.estimate import run as estimate_run
from gateway.identify.drift import drift_findings, drift_of
from gateway.identify.prior_loads import BARE_LABEL
from gateway.jobs import SLOW_PERCENT
from gateway.jobs.cell_context import CellContext
from gateway.jobs.frame import Operator, ask_to_move, begin_motion, flange_question
from gateway.jobs.measure import announce, continued, transfer
from gateway.model.arm_model import arm_robot
from gateway.model.visits import pair_visits
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import workspace_of
from gateway.pipeline.finalize import finalize
from gateway.pipeline.inputs import (
    AnalysisInputs,
    ModelRequest,
    collect_inputs,
    read_rows,
    split_validation,
)
from gateway.preflight.drive_check import require_passed
from gateway.result.data_roles import HELD_ROLE, roles_of
from gateway.result.result import Finding, Result

#: Recording of the warm-up, beside that of the job.
WARM_UP: Final = "warm-up.h5"


def keep_earlier(path: Path, say: Callable[[str], None]) -> None:
    """Rename a file of an earlier job, if there is one, and say so."""
    if not path.exists():
        return
    names = (path.with_suffix(f".{number}{path.suffix}") for number in range(1, 10_000))
    kept = next(name for name in names if not name.exists())
    path.rename(kept)
    say(f"{path} renamed to {kept}")


@dataclass(frozen=True, slots=True)
class Job:
    """A commissioning job.

    Attributes
    ----------
    context : CellContext
    arm : ArmConfig
    labels : tuple of str
        Loads, in mounting order.
    recording : Path
        Recording; an existing file is continued.
    options : MoveOptions
    operator : str or None
        Name of the operator.
    goal : Goal or None
        Required uncertainty of each load; None: measure all poses of the cell.
    warm_up_s : float or None
        Loads in forward and reverse order after a warm-up of at most this time; None: the unloaded arm, then each.
    is_bracketed : bool
        Unloaded arm, the one load, and the unloaded arm again.
    repetition : int
        Number of this measurement in a series. From the second on, the poses are other ones, and the last load is
        mounted at the start.
    outdated : tuple of Path
        Files of an earlier job that this one would replace: renamed once a person has agreed that the arm moves.
    refuse : callable
        Raises if the plan is of no use; called before the drives are opened.
    """

    context: CellContext
    arm: ArmConfig
    labels: tuple[str, ...]
    recording: Path
    options: MoveOptions = field(default_factory=MoveOptions)
    operator: str | None = None
    goal: Goal | None = None
    warm_up_s: float | None = None
    is_bracketed: bool = False
    repetition: int = 1
    outdated: tuple[Path, ...] = ()
    refuse: Callable[[Plan], None] = lambda _plan: None

    def blocks(self, poses: Sequence[RestPose]) -> tuple[Block, ...]:
        """Return the labels in the order of measurement."""
        if self.is_bracketed:
            return bracket_of(self.labels[0], poses)
        return blocks_of(self.labels, poses, self.warm_up_s is not None)

    @property
    def begins_bare(self) -> bool:
        """Return whether the question before motion covers the empty flange.

        A continued job may have had a load mounted: it asks for an empty flange by a prompt if the unloaded arm is not
        complete.
        """
        return self.repetition == 1 and (self.recording in self.outdated or not self.recording.exists())

    @property
    def pose_seed(self) -> int:
        """Seed of the choice of poses."""
        return self.context.loaded.cell.poses.seed + self.repetition - 1


def commission(job: Job, operator: Operator) -> Result:
    """Check, measure the unloaded arm and each load, diagnose, measure further and validation poses.

    Parameters
    ----------
    job : Job
    operator : Operator

    Returns
    -------
    Result
        Completed for the report.

    Raises
    ------
    FindingFailed
        The pre-flight check failed and nothing has moved, or a drive does not stop on loss of the master.
    PlanRefused, DriveError, DataUnusable, InputError, KeyboardInterrupt
        As the steps; the arm is at rest and measured data is kept.
    """
    with _measuring(job, operator) as robot:
        about, table = robot.data()
        seen, _ = split_validation(table)
        operator.say(f"diagnosis of {len(np.unique(seen.pose))} poses under {len(np.unique(seen.load))} loads")
        result, _ = close_loop(
            seen,
            about.model,
            about.knowledge,
            robot.measure_poses,
            robot.validation_rad,
            pose_choice=postures_to_ask(about),
        )
        about, table = robot.data()
    if not result.effects:
        plain = estimate_run(split_validation(table)[0], about.model, about.knowledge)
        result = replace(result, method=plain.method, parameters=plain.parameters, bare=plain.bare)
    gears = about.knowledge.efficiency, about.knowledge.coupling
    drifts = () if job.warm_up_s is None else drift_of(pair_visits(table, *gears))
    result = replace(result, findings=(*result.findings, *robot.ends, *drift_findings(drifts)))
    roles = roles_of(*split_validation(table), result.provenance.get(HELD_ROLE), about.bare_roles)
    return finalize(replace(result, data_roles=roles), about, table, [job.recording], job.operator)


def measure(job: Job, operator: Operator) -> None:
    """Check the arm, ask for permission, and record all loads of a job; parameters and errors as `commission`."""
    with _measuring(job, operator):
        pass


@contextmanager
def _measuring(job: Job, operator: Operator) -> Generator[_Robot]:
    """Yield the open arm after all loads of a job are recorded."""
    if job.recording not in job.outdated:
        continued(job.context, job.recording, resume=True)
    items = job.context.check(job.arm)
    operator.checked(items)
    require_passed(items, "check failed, the arm is not moved")
    # refuse an unreachable posture before the measurement (up to an hour), not after it
    if job.arm.loading_rad is not None:
        destination(job.arm, workspace_of(job.arm, arm_robot(job.context.loaded, job.arm)), LOADING)
    plan = make_plan(job.context.loaded, seed=job.pose_seed, arm=job.arm.name)
    job.refuse(plan)
    operator.planned(job.arm.name, plan)
    also = flange_question(BARE_LABEL if job.begins_bare else None)
    with job.context.opened(job.arm) as opened:
        options = begin_motion(job.context, (opened,), job.options, operator, also=also)
        for path in job.outdated:
            keep_earlier(path, operator.say)
        robot = _Robot(replace(job, options=options), operator, opened, plan)
        robot.warm_up()
        for block in job.blocks(robot.fit_poses):
            robot.measure_load(block)
        yield robot


class _Robot:
    """An open arm with its recording during a job."""

    def __init__(self, job: Job, operator: Operator, opened: OpenArm, plan: Plan) -> None:
        self._job, self._operator, self._opened = job, operator, opened
        self._load = BARE_LABEL
        self._mounted = BARE_LABEL if job.begins_bare else None
        self.fit_poses = [pose for pose in plan.poses if pose.purpose == "fit"]
        self._validation = [pose for pose in plan.poses if pose.purpose == "validation"]
        self._settings = plan.settings
        numbers = [pose.number for pose in (*plan.poses, *self._known_poses())]
        self._next = max(numbers) + 1
        self.ends: list[Finding] = []
        self._last = job.blocks(self.fit_poses)[-1]

    @property
    def validation_rad(self) -> np.ndarray:
        """Return the validation poses (k, N) [rad]."""
        return np.array([pose.q_rad for pose in self._validation]).reshape(-1, len(self._job.arm.axis))

    def warm_up(self) -> None:
        """Warm up until friction is steady, if requested and nothing is measured yet."""
        job = self._job
        path = job.recording.with_name(WARM_UP)

        def measure_round(poses: Sequence[RestPose]) -> None:
            self._record(poses, path, self._earlier(path))

        if job.warm_up_s and not self._known_poses():
            self._operator.say(warm_up(self.fit_poses, path, job.warm_up_s, measure_round))

    def measure_load(self, block: Block) -> None:
        """Have a load mounted and measure its poses; if all are measured, only the last load is requested."""
        self._load = label = block.load
        if label != BARE_LABEL and self._job.goal is not None:
            self._measure_until(label, self._job.goal)
            return
        earlier = self._earlier()
        missing = self._missing(earlier, block.poses)
        if label != self._mounted and (missing or block == self._last):
            self._go_loading()
            self._operator.mount(label, self._opened)
            self._mounted = label
        if missing:
            self._record(block.poses, self._job.recording, earlier)

    def _measure_until(self, label: str, goal: Goal) -> None:
        """Have a load mounted and measure until it is known; a known one is only requested if it is the last."""
        opened, job = self._opened, self._job
        model, apart_rad = ModelRequest(cell=job.context.path, arm=job.arm.name), self.validation_rad
        path, earlier = job.recording, self._earlier()
        search = search_of(opened.loaded, opened.workspace, opened.config, label, goal, path, earlier, model, apart_rad)
        missing = decide(search, None, opened.arm.where()).plan is not None
        if missing or label == job.labels[-1]:
            self._go_loading()
            self._operator.mount(label, self._opened)
            self._mounted = label
        if not missing:
            return
        with self._operator.progress(1.0, f"load {label}") as listener:
            summary, decision = record_until(opened, search, job.recording, earlier, (listener,), self._job.options)
        self._operator.say(summary.reason)
        self._job = replace(self._job, options=replace(self._job.options, first_done=None))
        self._next = max(self._next, 1 + max(pose.number for pose in self._known_poses()))
        self.ends.append(end_of(decision.stock, decision.verdict, label))

    def _known_poses(self) -> tuple[RestPose, ...]:
        earlier = self._earlier()
        stored = None if earlier is None else earlier.arm(self._job.arm.name)
        return () if stored is None else stored.poses

    def _go_loading(self) -> None:
        """Move slowly to the loading posture, if the cell defines one.

        Otherwise loads are mounted at the current posture.
        """
        opened, job = self._opened, self._job
        if opened.config.loading_rad is None:
            return
        target = destination(opened.config, opened.workspace, LOADING)
        try:
            plan = plan_transfer(opened, target)
        except PlanRefused as refused:
            self._operator.say(f"the arm stays at its current posture, mount the load there: {refused}")
            return
        slow = replace(job.options, override=min(job.options.override, SLOW_PERCENT / 100.0))
        announce(opened, target, plan, self._operator, slow)
        ask_to_move(job.context, (opened,), self._operator, f"will move to {target}.")
        transfer(job.context, opened, target, plan, self._operator, slow)
        self._job = replace(job, options=replace(job.options, first_done=None))

    def measure_poses(self, q_rad: np.ndarray) -> Table:
        """Measure poses (k, N) [rad] under the mounted load: validation poses, or further poses for the fit."""
        if np.array_equal(q_rad, self.validation_rad):
            poses = self._validation
            self._operator.say(f"validation on {len(poses)} poses that were not used in the fit")
        else:
            numbers = range(self._next, self._next + len(q_rad))
            poses = [RestPose(number, tuple(q), "fit") for number, q in zip(numbers, q_rad.tolist(), strict=True)]
            self._next += len(poses)
            self._operator.say(f"measuring {len(poses)} further poses that separate the candidate causes")
        earlier = self._earlier()
        if self._missing(earlier, poses):
            self._record(poses, self._job.recording, earlier)
        table = self.data()[1]
        chosen = np.isin(table.pose, [pose.number for pose in poses]) & (table.load == self._load)
        return table.take(chosen)

    def data(self) -> tuple[AnalysisInputs, Table]:
        """Return all data measured so far."""
        job = self._job
        about = replace(
            collect_inputs(ModelRequest(cell=job.context.path, arm=job.arm.name), [job.recording]),
            loaded=job.context.loaded,
        )
        return about, read_rows([job.recording], about)

    def _earlier(self, path: Path | None = None) -> Recording | None:
        return continued(self._job.context, path or self._job.recording, resume=True)

    def _missing(self, earlier: Recording | None, poses: Sequence[RestPose]) -> bool:
        """Return whether a visit of these poses under the mounted load is missing in the recording."""
        stored = None if earlier is None else earlier.arm(self._job.arm.name)
        done = set() if stored is None else set(stored.done(self._load))
        return any((pose.number, side) not in done for pose in poses for side in SIDES)

    def _record(self, poses: Sequence[RestPose], path: Path, earlier: Recording | None) -> None:
        opened = self._opened
        plan, unreachable = plan_poses(opened.config.name, opened.workspace, poses, self._settings)
        if unreachable:
            raise PlanRefused(
                f"arm '{opened.config.name}': no path within the limits leads to pose {unreachable[0].number}; "
                "narrow the joint limits, or correct the surroundings of the arm in the cell file"
            )
        check_plan(plan, opened.workspace)
        options = self._job.options
        with self._operator.progress(plan.duration_s / options.override, f"load {self._load}") as listener:
            record(opened, plan, self._load, path, earlier, (listener,), options)
        self._job = replace(self._job, options=replace(options, first_done=None))
