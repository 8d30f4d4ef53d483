"""Run of a plan at rest under power, step by step: move, approach, settle, sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np

from drives.errors import IncompleteEpochs
from gateway.acquire.events import (
    PoseDone,
    Progress,
    SampleRepeated,
    Started,
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
from gateway.acquire.station import VisitStation
from gateway.data.period import Period
from gateway.data.sample import ArmSample
from gateway.data.visit import Visit, VisitLabel, visit_from_samples
from gateway.errors import PlanRefused, PoseNeverSettles
from gateway.motion.arm import Arm
from gateway.motion.reactions import ARM_RULES
from gateway.motion.state import Phase, StateTracker
from gateway.motion.stream import FIRST_SHARE, Stream
from gateway.motion.trajectory import straight

#: Largest number of incomplete SYNCs while sampling, as a share of the requested samples.
REPEATED_SHARE = ARM_RULES["repeats"].limit
REPEATED_LEAST = 10
PHASES = {
    MoveTo: Phase.MOVING,
    MoveInwards: Phase.MOVING,
    Approach: Phase.MOVING,
    Settle: Phase.SETTLING,
    Sample: Phase.SAMPLING,
}
#: Largest drop of a joint when its brakes open [rad] for which the checked plan still holds.
SINK_RAD = ARM_RULES["sinks"].limit


class Run:
    """Run of a plan at rest under power; `broken` is the visit that an error interrupted.

    Parameters
    ----------
    station : VisitStation
    plan : Plan
        From the present posture of the arm.
    load : str
    state : StateTracker
    """

    def __init__(self, station: VisitStation, plan: Plan, load: str, state: StateTracker) -> None:
        self.plan = plan
        self.broken: Visit | None = None
        self.state = state
        self._load = load
        self._arm = station.arm
        self._workspace = station.workspace
        self._store, self._station = station.store, station
        self._notify = station.notify
        self._period_s = plan.settings.period_s
        self._first = FIRST_SHARE if station.options.first_done is not None else 1.0
        self._ends = self._timed(plan, 0.0)
        self._further_s = 0.0
        self._slower = 1.0 / station.options.override
        self._step = -1
        self._settle_s: dict[int, float] = {}
        self._direction = np.zeros(self._workspace.robot.axes, dtype=np.int8)
        self._first_side: Visit | None = None
        self._settled_s = 0.0

    def check_start(self, stream: Stream) -> None:
        """Refuse an arm that dropped while its brakes opened: the checked plan no longer fits.

        Raises
        ------
        PlanRefused
        """
        refuse_sunk(self.plan, stream)

    def execute(self, stream: Stream) -> None:
        """Execute all steps of the plan."""
        self.begin(stream, len(self.plan.visits), 0.0)
        self.steps()
        self.end()

    def begin(self, stream: Stream, visits: int, further_s: float) -> None:
        """Report the start of a run with its number of visits and the time [s] expected in addition to the plan."""
        self.check_start(stream)
        self._stream, self._further_s = stream, further_s
        self._notify(Started(self.plan.arm, self._load, visits, self._slower * (self._ends[-1] + further_s)))
        stream.take_over()

    def go_on(self, plan: Plan, further_s: float) -> None:
        """Execute another plan from the present posture; report the time [s] expected in addition to it."""
        self._ends = self._timed(plan, self._ends[-1])
        self.plan, self._step, self._further_s = plan, -1, further_s
        self.steps()

    def end(self) -> None:
        """Report the end of the run."""
        self._notify(Progress(len(self.plan.steps), len(self.plan.steps), "done", self._slower * self._ends[-1], 0.0))

    def _timed(self, plan: Plan, begin_s: float) -> list[float]:
        """Return the end times of the steps; the very first step is slow if these drives have not moved yet."""
        durations = step_durations(plan, self._workspace)
        durations[:1] = [duration / self._first for duration in durations[:1]]
        self._first = 1.0
        return list(accumulate(durations, initial=begin_s))

    def steps(self) -> None:
        """Execute the steps of the plan."""
        stream = self._stream
        for number, step in enumerate(self.plan.steps):
            self._step = number
            self.state.enter(PHASES[type(step)], stream.sync_index)
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

    def _move(self, target_rad: Sequence[float], what: str, speed_rad_s: float | np.ndarray | None = None) -> None:
        limits = travel_limits(self._workspace)
        if speed_rad_s is not None:
            limits = approach_limits(self._workspace, speed_rad_s)
        target, (at,) = np.array(target_rad), self._stream.q_rad
        self._direction = np.sign(target - at).astype(np.int8)
        self._stream.move([straight(at, target, limits, self._period_s)], what)

    def _settle(self, step: Settle) -> None:
        test = SettleTest(self._period_s, self._workspace.torque_nm)
        restless: np.ndarray | None = None
        limit = int(np.ceil(step.timeout_s / self._period_s))
        for row in range(limit):
            (sample,) = self._stream.hold(f"settle pose {step.pose}", row, limit)
            if sample.complete:
                test.add(sample.q_rad, sample.joint_torque_nm)
                restless = test.restless()
                if restless is not None and not restless.any():
                    self._settled_s = (row + 1) * self._period_s
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
        (at,) = self._stream.q_rad
        label = VisitLabel(self._load, step.pose, purpose, step.direction, self._direction, at)
        samples: list[ArmSample] = []
        repeated = 0
        temperatures = self._station.temperatures
        if temperatures is not None:
            temperatures.begin()
        try:
            while len(samples) < step.count:
                (sample,) = self._stream.hold(f"sample pose {step.pose}", len(samples), step.count)
                if temperatures is not None:
                    temperatures.poll()
                if sample.complete:
                    samples.append(sample)
                    continue
                repeated += 1
                self._notify(SampleRepeated(sample.sync_index, sample.silent))
                if repeated > max(REPEATED_LEAST, REPEATED_SHARE * step.count):
                    raise IncompleteEpochs(
                        f"pose {step.pose}: {repeated} SYNCs were not answered by all axes while {len(samples)}"
                        " samples were taken",
                        advice=ARM_RULES["repeats"].advice,
                    )
        except BaseException:
            self.broken = visit_from_samples(label, samples, False, repeated) if samples else None
            raise
        self._keep(visit_from_samples(label, samples, True, repeated, self._station.temperatures_c()))

    def _keep(self, visit: Visit) -> None:
        first, self._first_side = self._first_side, visit
        if first is not None and first.pose == visit.pose and first.approach == -visit.approach:
            visit = with_half_sums(self._arm, first, visit)
        self._settle_s[self._store.add(self.plan.arm, visit).number] = self._settled_s

    def announce(self, visit: Visit | Period, /) -> None:
        """Report a complete visit that is on disk, and the pose if it is complete."""
        if not isinstance(visit, Visit) or not visit.complete:
            return
        torque = visit.joint_torque_nm
        self._notify(
            VisitDone(
                number=visit.number,
                pose=visit.pose,
                direction=visit.approach,
                load=visit.load,
                torque_nm=tuple(torque.mean(axis=0).tolist()),
                torque_std_nm=tuple(torque.std(axis=0, ddof=min(1, len(visit) - 1)).tolist()),
                settle_s=self._settle_s.pop(visit.number, 0.0),
                incomplete_epochs=visit.incomplete_epochs,
            )
        )
        if visit.gravity_nm is not None and visit.friction_band_nm is not None:
            gravity, band = tuple(visit.gravity_nm.tolist()), tuple(visit.friction_band_nm.tolist())
            self._notify(PoseDone(visit.pose, visit.load, gravity, band))

    def report(self, what: str, row: int, rows: int) -> None:
        """Report the progress of the run; called by the motion loop at intervals."""
        begin, end = (self._ends[self._step], self._ends[self._step + 1]) if self._step >= 0 else self._ends[:1] * 2
        elapsed = begin + (end - begin) * max(row, 0) / rows
        left = self._slower * (self._ends[-1] - elapsed + self._further_s)
        self._notify(Progress(self._step + 1, len(self.plan.steps), what, self._slower * elapsed, left))


def refuse_sunk(plan: Plan, stream: Stream) -> None:
    """Refuse an arm that dropped while its brakes opened; see `Run.check_start`."""
    sunk = np.abs(stream.q_rad[0] - np.array(plan.start_rad))
    if not sunk.max() <= SINK_RAD:
        joint = int(np.argmax(np.nan_to_num(sunk, nan=np.inf))) + 1
        raise PlanRefused(
            f"arm '{plan.arm}', joint {joint} moved by {sunk[joint - 1]:.3f} rad while its brake opened; "
            f"{ARM_RULES['sinks'].advice}"
        )


def with_half_sums(arm: Arm, first: Visit, second: Visit) -> Visit:
    """Return the second visit of a pose with half-sum and half-difference (upward minus downward approach).

    Each torque is converted to the joint with the gear efficiency of its own direction (driving or back-driven).
    """
    torque = [
        arm.axes.joint_torque_by_direction(visit.motor_torque_nm.mean(axis=0), visit.direction)
        for visit in (first, second)
    ]
    band = (torque[1] - torque[0]) / 2.0 * second.approach
    return replace(second, gravity_nm=(torque[0] + torque[1]) / 2.0, friction_band_nm=band)
