"""One run of one plan, step by step: move, approach, settle, sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Protocol

import numpy as np

from drives.errors import IncompleteEpochs
from gateway.acquire.events import (
    Event,
    Listener,
    PoseDone,
    Progress,
    SampleRepeated,
    Started,
    StateChanged,
    VisitDone,
)
from gateway.acquire.plan import (
    Approach,
    MoveInwards,
    MoveTo,
    Plan,
    Sample,
    Settle,
    approach_limits,
    step_durations,
    travel_limits,
)
from gateway.acquire.settle import SettleTest
from gateway.errors import PlanRefused, PoseNeverSettles
from gateway.motion.arm import Arm, ArmSample
from gateway.motion.contact import TAKE_OVER_S
from gateway.motion.reactions import ARM_RULES
from gateway.motion.state import Phase, StateKeeper
from gateway.motion.stream import Stream
from gateway.motion.trajectory import straight
from gateway.motion.watch import Watch
from gateway.motion.workspace import Workspace
from gateway.visit import Visit, VisitLabel, visit_from_samples

#: Between two messages about progress.
PROGRESS_S = 0.25
#: Incomplete SYNCs while sampling, as a share of the samples asked for, before the visit is given up.
REPEATED_SHARE = ARM_RULES["repeats"].limit
REPEATED_LEAST = 10
PHASES = {
    MoveTo: Phase.MOVING,
    MoveInwards: Phase.MOVING,
    Approach: Phase.MOVING,
    Settle: Phase.SETTLING,
    Sample: Phase.SAMPLING,
}
#: How far the arm may sink when its brakes open, before the checked plan no longer fits.
SINK_RAD = ARM_RULES["sinks"].limit


class VisitStore(Protocol):
    """Where visits go."""

    def add(self, arm: str, visit: Visit) -> Visit:
        """Keep a visit; returns it with its number."""
        ...


def _never() -> bool:
    return False


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """What a run works with.

    Attributes
    ----------
    arm : Arm
        Connected and configured, not enabled.
    workspace : Workspace
    store : VisitStore
    listeners : tuple of Listener
        Called with every event, in the thread of the run.
    stop_asked : callable
        Asked at every SYNC; true stops the arm.
    """

    arm: Arm
    workspace: Workspace
    store: VisitStore
    listeners: tuple[Listener, ...] = ()
    stop_asked: Callable[[], bool] = field(default=_never)

    def tell(self, event: Event) -> None:
        """Hand an event to all listeners."""
        for listener in self.listeners:
            listener(event)


class Run:
    """One run of one plan; `broken` is the visit that an error has cut short."""

    def __init__(self, station: Station, plan: Plan, load: str) -> None:
        self.plan = plan
        self.broken: Visit | None = None
        self.state = StateKeeper(plan.arm, lambda state: station.tell(StateChanged(state)))
        self._load = load
        self._arm = station.arm
        self._workspace: Workspace = station.workspace
        self._store = station.store
        self._tell = station.tell
        self._period_s = plan.settings.period_s
        self._ends = [0.0, *accumulate(step_durations(plan, self._workspace))]
        self._step = 0
        self._settle_s = 0.0
        self._direction = np.zeros(6, dtype=np.int8)
        self._first_side: Visit | None = None
        watch = Watch(plan.arm, self._workspace, self._period_s)
        every = max(1, round(PROGRESS_S / self._period_s))
        self._stream = Stream(self._arm, watch, station.stop_asked, self._progress, every)

    def start(self, sample: ArmSample) -> None:
        """Take over the enabled arm."""
        planned = np.array(self.plan.start_rad)
        sunk = np.abs(sample.q_rad - planned)
        if not sunk.max() <= SINK_RAD:
            joint = int(np.argmax(np.nan_to_num(sunk, nan=np.inf))) + 1
            raise PlanRefused(
                f"arm '{self.plan.arm}', joint {joint} moved by {sunk[joint - 1]:.3f} rad while its brake opened; "
                f"{ARM_RULES['sinks'].advice}"
            )
        self._stream.start(sample.q_rad)
        self.state.enter(Phase.HOLDING, sample.sync_index)

    @property
    def sync_index(self) -> int:
        """Last SYNC of this run."""
        return self._stream.sync_index

    def execute(self) -> None:
        """All steps."""
        self._tell(Started(self.plan.arm, self._load, len(self.plan.visits), self._ends[-1]))
        rows = int(np.ceil(TAKE_OVER_S / self._period_s))
        for _ in range(rows):
            self._stream.hold("open the brakes", 0, rows)
        for number, step in enumerate(self.plan.steps):
            self._step = number
            self.state.enter(PHASES[type(step)], self.sync_index)
            if isinstance(step, MoveTo):
                self._move(step.q_rad, "move")
            elif isinstance(step, MoveInwards):
                self._move(step.q_rad, "move back into the joint range", self._workspace.inward_speed_rad_s())
            elif isinstance(step, Approach):
                self._move(step.q_rad, f"approach pose {step.pose}", self.plan.settings.approach_speed_rad_s)
            elif isinstance(step, Settle):
                self._settle(step)
            else:
                self._sample(step)
        self._tell(Progress(len(self.plan.steps), len(self.plan.steps), "done", self._ends[-1], 0.0))

    def stop_softly(self) -> None:
        """Jerk-limited stop; by the drives' own ramp where that fails."""
        try:
            self._stream.stop_softly(travel_limits(self._workspace), self._period_s)
        except BaseException:
            self._arm.quick_stop()
            raise

    def _move(self, target_rad: Sequence[float], what: str, speed_rad_s: float | np.ndarray | None = None) -> None:
        limits = travel_limits(self._workspace)
        if speed_rad_s is not None:
            limits = approach_limits(self._workspace, speed_rad_s)
        target = np.array(target_rad)
        self._direction = np.sign(target - self._stream.q_rad).astype(np.int8)
        self._stream.move(straight(self._stream.q_rad, target, limits, self._period_s), what)

    def _settle(self, step: Settle) -> None:
        test = SettleTest(self._period_s, self._workspace.torque_nm)
        restless: np.ndarray | None = None
        limit = int(np.ceil(step.timeout_s / self._period_s))
        for row in range(limit):
            sample = self._stream.hold(f"settle pose {step.pose}", row, limit)
            if sample.complete:
                test.add(sample.q_rad, sample.joint_torque_nm)
                restless = test.restless()
                if restless is not None and not restless.any():
                    self._settle_s = (row + 1) * self._period_s
                    return
        joint = test.worst + 1
        raise PoseNeverSettles(
            f"pose {step.pose} does not settle within {step.timeout_s:g} s: joint {joint} still moves or its torque "
            f"drifts; {ARM_RULES['never_settles'].advice}",
            pose=step.pose,
            joint=joint,
        )

    def _sample(self, step: Sample) -> None:
        purpose = next(pose.purpose for pose in self.plan.poses if pose.number == step.pose)
        label = VisitLabel(self._load, step.pose, purpose, step.direction, self._direction, self._stream.q_rad)
        samples: list[ArmSample] = []
        repeated = 0
        try:
            while len(samples) < step.count:
                sample = self._stream.hold(f"sample pose {step.pose}", len(samples), step.count)
                if sample.complete:
                    samples.append(sample)
                    continue
                repeated += 1
                self._tell(SampleRepeated(sample.sync_index, sample.silent))
                if repeated > max(REPEATED_LEAST, REPEATED_SHARE * step.count):
                    raise IncompleteEpochs(
                        f"pose {step.pose}: {repeated} SYNCs were left unanswered while {len(samples)} were sampled",
                        advice=ARM_RULES["repeats"].advice,
                    )
        except BaseException:
            self.broken = visit_from_samples(label, samples, False, repeated) if samples else None
            raise
        self._keep(visit_from_samples(label, samples, True, repeated))

    def _keep(self, visit: Visit) -> None:
        first, self._first_side = self._first_side, visit
        if first is not None and first.pose == visit.pose and first.approach == -visit.approach:
            visit = with_half_sums(self._arm, first, visit)
        stored = self._store.add(self.plan.arm, visit)
        torque = visit.joint_torque_nm
        self._tell(
            VisitDone(
                number=stored.number,
                pose=visit.pose,
                direction=visit.approach,
                load=visit.load,
                torque_nm=tuple(torque.mean(axis=0).tolist()),
                torque_std_nm=tuple(torque.std(axis=0, ddof=min(1, len(visit) - 1)).tolist()),
                settle_s=self._settle_s,
                incomplete_epochs=visit.incomplete_epochs,
            )
        )
        if visit.gravity_nm is not None and visit.friction_band_nm is not None:
            gravity, band = tuple(visit.gravity_nm.tolist()), tuple(visit.friction_band_nm.tolist())
            self._tell(PoseDone(visit.pose, visit.load, gravity, band))

    def _progress(self, what: str, row: int, rows: int) -> None:
        begin, end = self._ends[self._step], self._ends[self._step + 1]
        elapsed = begin + (end - begin) * row / rows
        self._tell(Progress(self._step + 1, len(self.plan.steps), what, elapsed, self._ends[-1] - elapsed))


def with_half_sums(arm: Arm, first: Visit, second: Visit) -> Visit:
    """The second side with half the sum and half the difference of both, upward less downward.

    Each side is taken to the joint with the gear efficiency of its own direction (driving or driven back).
    """
    torque = [
        arm.axes.joint_torque_by_direction(visit.motor_torque_nm.mean(axis=0), visit.direction)
        for visit in (first, second)
    ]
    band = (torque[1] - torque[0]) / 2.0 * second.approach
    return replace(second, gravity_nm=(torque[0] + torque[1]) / 2.0, friction_band_nm=band)
