"""The whole job, guided: check, bare arm, each load, diagnosis, back to the robot, fresh poses, result and report.

Where the cell says where loads are hung, the arm goes there before a person is asked to hang one. The drives are in
their brakes whenever a person is asked for something. Everything measured is in one file, which is whole after each
visit.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from gateway.acquire.asking import postures_to_ask
from gateway.acquire.goto import LOADING, Destination, destination, plan_way
from gateway.acquire.plan import SIDES, Plan, check_plan, plan_poses
from gateway.acquire.session import RecordRequest, make_plan, open_arm
from gateway.acquire.thermal import Block, Thermal, blocks_of, bracket_of, warm_up
from gateway.acquire.until.goal import Goal
from gateway.acquire.until.prepare import UntilRequest, search_of
from gateway.acquire.until.run import UntilSummary
from gateway.acquire.until.search import LoadSearch, decide
from gateway.acquire.until.words import end_of
from gateway.analyse.complete import complete
from gateway.analyse.given import (
    WARM_CHANGE,
    Given,
    ModelRequest,
    diagnose_arguments,
    estimate_options,
    given,
    read_rows,
    split_validation,
)
from gateway.cell.config import ArmConfig
from gateway.commands.cell_context import CellContext
from gateway.commands.motion_options import SLOW_PERCENT
from gateway.data.recording.reader import read
from gateway.data.recording.recorded import ArmRecording, Recording
from gateway.data.rest_pose import RestPose
from gateway.data.table import Table
from gateway.diagnose import DiagnoseOptions
from gateway.diagnose.loop import close_loop
from gateway.errors import PlanRefused
from gateway.estimate import run as estimate_run
from gateway.identify.drift import drift_findings, drift_of, is_steady
from gateway.identify.loads import BARE_LABEL
from gateway.model.arm_model import arm_robot
from gateway.model.visits import pair_visits
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.motion.workspace import workspace_of
from gateway.preflight.drive_check import require_passed
from gateway.result.result import Finding, Result


class Dialogue(Protocol):
    """Whoever talks to the person."""

    def checked(self, items: Sequence[Finding]) -> None:
        """The pre-flight check is done."""
        ...

    def planned(self, plan: Plan) -> None:
        """Poses are chosen; ask whether the arm may move."""
        ...

    def bring(self, opened: OpenArm, target: Destination, plan: Plan, options: MoveOptions) -> None:
        """Say where the arm goes, ask, and go there."""
        ...

    def hang(self, label: str) -> None:
        """Ask for a load to be hung, or (`none`) for an empty flange; returns when that is so."""
        ...

    def measure(self, opened: OpenArm, plan: Plan, request: RecordRequest, options: MoveOptions) -> None:
        """Record and show how far it is."""
        ...

    def measure_until(
        self, opened: OpenArm, search: LoadSearch, earlier: Recording | None, path: Path, options: MoveOptions
    ) -> UntilSummary:
        """Record pose by pose until a load is known, and show how far it is."""
        ...

    def say(self, text: str) -> None:
        """A remark."""
        ...


@dataclass(frozen=True, slots=True)
class Job:
    """What is to be done.

    Attributes
    ----------
    context : CellContext
    arm : ArmConfig
    labels : tuple of str
        Loads, in the order in which they are hung.
    recording : Path
        Where everything measured goes; a file that is there is gone on with.
    options : MoveOptions
    operator : str or None
        Who measures.
    goal : Goal or None
        How well each load is to be known; None: all poses of the cell are measured.
    thermal : Thermal or None
        Loads forth and back after a warm-up; None: the bare arm, then each load.
    is_bracketed : bool
        The bare arm, the one load, and the bare arm again.
    """

    context: CellContext
    arm: ArmConfig
    labels: tuple[str, ...]
    recording: Path
    options: MoveOptions = field(default_factory=MoveOptions)
    operator: str | None = None
    goal: Goal | None = None
    thermal: Thermal | None = None
    is_bracketed: bool = False

    def blocks(self, poses: Sequence[RestPose]) -> tuple[Block, ...]:
        """What is measured, in this order."""
        if self.is_bracketed:
            return bracket_of(self.labels[0], poses)
        return blocks_of(self.labels, poses, self.thermal)

    @property
    def begins_bare(self) -> bool:
        """Whether nothing is mounted as it begins: a bare arm that is gone on with may have had a load in between."""
        return not self.recording.exists() or (self.thermal is None and not self.is_bracketed)


def commission(job: Job, dialogue: Dialogue) -> Result:
    """Run the whole job.

    Parameters
    ----------
    job : Job
    dialogue : Dialogue

    Returns
    -------
    Result
        Completed for the report.

    Raises
    ------
    FindingFailed
        The pre-flight check failed and nothing has moved, or a drive does not stop on loss of the master.
    PlanRefused, DriveError, DataUnusable, InputError, KeyboardInterrupt
        As the parts; the arm stands, what was measured is kept.
    """
    with _measuring(job, dialogue) as robot:
        about, table = robot.data()
        seen, _ = split_validation(table)
        if job.thermal is not None and is_steady(drift_of(pair_visits(seen, about.efficiency, about.coupling))):
            about = replace(about, change=WARM_CHANGE)
        dialogue.say(f"diagnosis of {len(np.unique(seen.pose))} poses under {len(np.unique(seen.load))} loads")
        result, _ = close_loop(
            seen,
            about.model,
            DiagnoseOptions(pose_choice=postures_to_ask(about), **diagnose_arguments(about)),
            robot.measure_poses,
            robot.validation_rad,
        )
        about, table = robot.data()
    if not result.effects:
        plain = estimate_run(split_validation(table)[0], about.model, estimate_options(about))
        result = replace(result, method=plain.method, parameters=plain.parameters, bare=plain.bare)
    drifts = drift_of(pair_visits(table, about.efficiency, about.coupling)) if job.thermal is not None else ()
    result = replace(result, findings=(*result.findings, *robot.ends, *drift_findings(drifts)))
    return complete(result, about, table, [job.recording], job.operator)


def measure(job: Job, dialogue: Dialogue) -> None:
    """Check the arm, ask, and record all loads of a job; parameters and errors as `commission`."""
    with _measuring(job, dialogue):
        pass


@contextmanager
def _measuring(job: Job, dialogue: Dialogue) -> Generator[_Robot]:
    """The arm, open, once all loads of a job are recorded."""
    _check(job, dialogue)
    if job.arm.loading_rad is not None:  # a posture that is refused is told before an hour of measuring, not after it
        destination(job.arm, workspace_of(job.arm, arm_robot(job.context.loaded, job.arm)), LOADING)
    plan = make_plan(job.context.loaded, arm=job.arm.name)
    dialogue.planned(plan)
    with open_arm(job.context.loaded, job.context.override(job.arm), job.arm.name) as opened:
        options = job.context.proven(opened, dialogue.say, job.options)
        robot = _Robot(replace(job, options=options), dialogue, opened, plan)
        robot.warm_up()
        for block in job.blocks(robot.fit_poses):
            robot.measure_load(block)
        yield robot


def _check(job: Job, dialogue: Dialogue) -> None:
    items = job.context.check(job.arm)
    dialogue.checked(items)
    require_passed(items, "check failed, nothing has moved")


class _Robot:
    """The arm and its recording, as the job sees them."""

    def __init__(self, job: Job, dialogue: Dialogue, opened: OpenArm, plan: Plan) -> None:
        self._job, self._dialogue, self._opened = job, dialogue, opened
        self._load = BARE_LABEL
        self._hangs = BARE_LABEL if job.begins_bare else None
        self.fit_poses = [pose for pose in plan.poses if pose.purpose == "fit"]
        self._validation = [pose for pose in plan.poses if pose.purpose == "validation"]
        self._settings = plan.settings
        numbers = [pose.number for pose in (*plan.poses, *self._known_poses())]
        self._next = max(numbers) + 1
        self.ends: list[Finding] = []
        self._last = job.blocks(self.fit_poses)[-1]

    @property
    def validation_rad(self) -> np.ndarray:
        """Poses (k, N) [rad] kept for the proof."""
        return np.array([pose.q_rad for pose in self._validation]).reshape(-1, len(self._job.arm.axis))

    def warm_up(self) -> None:
        """Move until friction stands still, where drift is to be met and nothing is measured yet."""
        thermal, job = self._job.thermal, self._job
        if thermal is None or thermal.warm_up_s == 0.0 or self._stored() is not None:
            return
        said = warm_up(self.fit_poses, job.recording, thermal.warm_up_s, lambda poses, to: self._record(poses, to))
        self._dialogue.say(said)

    def measure_load(self, block: Block) -> None:
        """Hang a load and measure its poses; where all are there, only the load that hangs at last is asked for."""
        self._load = label = block.load
        if label != BARE_LABEL and self._job.goal is not None:
            self._measure_until(label, self._job.goal)
            return
        missing = self._missing(block.poses)
        if label != self._hangs and (missing or block == self._last):
            self._go_loading()
            self._dialogue.hang(label)
            self._hangs = label
        if missing:
            self._record(block.poses)

    def _measure_until(self, label: str, goal: Goal) -> None:
        """Hang a load and measure it until it is known; one that is known is only asked for where it hangs at last."""
        opened, job = self._opened, self._job
        request = UntilRequest(label, goal, job.recording, job.context.path)
        search, earlier = search_of(opened.loaded, opened.workspace, opened.config, request, self.validation_rad)
        missing = decide(search, None, opened.arm.where()).plan is not None
        if missing or label == job.labels[-1]:
            self._go_loading()
            self._dialogue.hang(label)
            self._hangs = label
        if not missing:
            return
        done = self._dialogue.measure_until(opened, search, earlier, job.recording, self._job.options)
        self._job = replace(self._job, options=replace(self._job.options, first_done=None))
        self._next = max(self._next, 1 + max(pose.number for pose in self._known_poses()))
        self.ends.append(end_of(done.decision, label))

    def _known_poses(self) -> tuple[RestPose, ...]:
        stored = self._stored()
        return () if stored is None else stored.poses

    def _go_loading(self) -> None:
        """Go where loads are hung, slowly, if the cell says where; the load hangs where the arm stands else."""
        opened, job = self._opened, self._job
        if opened.config.loading_rad is None:
            return
        target = destination(opened.config, opened.workspace, LOADING)
        try:
            plan = plan_way(opened, target)
        except PlanRefused as refused:
            self._dialogue.say(f"the arm stays where it is, and the load is hung there: {refused}")
            return
        slow = replace(job.options, override=min(job.options.override, SLOW_PERCENT / 100.0))
        with job.context.last_seconds(slow, opened):
            self._dialogue.bring(opened, target, plan, slow)
        self._job = replace(job, options=replace(job.options, first_done=None))

    def measure_poses(self, q_rad: np.ndarray) -> Table:
        """Measure poses (k, N) [rad] under the load that hangs now: validation poses, or new ones to fit from."""
        if np.array_equal(q_rad, self.validation_rad):
            poses = self._validation
            self._dialogue.say(f"proof on {len(poses)} fresh poses that no fit has seen")
        else:
            numbers = range(self._next, self._next + len(q_rad))
            poses = [RestPose(number, tuple(q), "fit") for number, q in zip(numbers, q_rad.tolist(), strict=True)]
            self._next += len(poses)
            self._dialogue.say(f"back to the robot: {len(poses)} poses that tell the explanations apart")
        if self._missing(poses):
            self._record(poses)
        table = self.data()[1]
        chosen = np.isin(table.pose, [pose.number for pose in poses]) & (table.load == self._load)
        return table.take(chosen)

    def data(self) -> tuple[Given, Table]:
        """Everything measured so far."""
        job = self._job
        about = replace(
            given(ModelRequest(cell=job.context.path, arm=job.arm.name), [job.recording]), loaded=job.context.loaded
        )
        return about, read_rows([job.recording], about)

    def _stored(self) -> ArmRecording | None:
        path = self._job.recording
        return read(path).arm(self._job.arm.name) if path.exists() else None

    def _missing(self, poses: Sequence[RestPose]) -> bool:
        """Whether a visit of these poses under the present load is not in the file yet."""
        stored = self._stored()
        done = set() if stored is None else set(stored.done(self._load))
        return any((pose.number, side) not in done for pose in poses for side in SIDES)

    def _record(self, poses: Sequence[RestPose], path: Path | None = None) -> None:
        opened = self._opened
        plan, unreachable = plan_poses(opened.config.name, opened.workspace, poses, self._settings)
        if unreachable:
            raise PlanRefused(
                f"arm '{opened.config.name}': no path that keeps the limits leads to pose {unreachable[0].number}; "
                "narrow the joint limits, or say in the cell what is assumed around the arm"
            )
        check_plan(plan, opened.workspace)
        request = RecordRequest(self._load, path or self._job.recording, resume=True)
        self._dialogue.measure(opened, plan, request, self._job.options)
        self._job = replace(self._job, options=replace(self._job.options, first_done=None))
