"""The run loop of every measurement: power the arm, take the next motions from a source, execute, measure and store.

A source yields plans, each from the posture in which the plan before ends. `rest_visits` yields the poses of a plan,
`driven_passes` excitations and `goto.py` a transfer. `until.py` yields pose after pose while a load is estimated. The
brakes are on before and after.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from drives.errors import IncompleteEpochs
from drives.exchange import Pacing
from gateway.acquire.events import (
    Event,
    Listener,
    PeriodDone,
    PoseDone,
    Progress,
    SampleRepeated,
    Started,
    StateChanged,
    Stopped,
    VisitDone,
)
from gateway.acquire.passes import REST_S, Pass, PeriodicSetpoints, slowed
from gateway.acquire.plan import (
    MoveTo,
    Plan,
    PoseVisit,
    check_plan,
    motion_limits,
    plan_from,
    step_durations,
)
from gateway.acquire.settle import SettleTest
from gateway.acquire.visit_store import VisitStore
from gateway.data.period import Period, PeriodLog
from gateway.data.visit import ArmSample, Visit, VisitLabel, visit_from_samples
from gateway.errors import GatewayError, PlanRefused, PoseNeverSettles
from gateway.motion.arm import Arm
from gateway.motion.arms import Arms
from gateway.motion.power import powered
from gateway.motion.reactions import ARM_RULES
from gateway.motion.state import Phase
from gateway.motion.stops import StopKind, StopRequest, guarded
from gateway.motion.stream import FIRST_SHARE, MoveOptions, Stream
from gateway.motion.temperature import MotorTemperatures
from gateway.motion.trajectory import straight
from gateway.motion.workspace import Workspace

#: Largest number of incomplete SYNCs while sampling, as a share of the requested samples.
REPEATED_SHARE = ARM_RULES["repeats"].limit
REPEATED_LEAST = 10
#: Largest drop of a joint when its brakes open [rad] for which the checked plan still holds.
SINK_RAD = ARM_RULES["sinks"].limit
#: A transfer that is longer counts as the first motion with these drives [rad].
FAR_RAD: Final = 0.1

#: Source of the next motions. Yields a checked plan from the present posture; the time [s] and the number of visits
#: expected after it. Advanced before the arm is powered, then with the run whenever a plan is executed and the arm is
#: at rest. Returns the reason of its end; one that yields nothing moves nothing.
MotionSource = Generator[tuple[Plan, float, int], "Run", str]


def rest_visits(plan: Plan, arm: Arm, workspace: Workspace, done: Sequence[tuple[int, int]] = ()) -> MotionSource:
    """Yield a plan of rest poses, ordered from the present posture.

    Parameters
    ----------
    plan : Plan
    arm : Arm
    workspace : Workspace
    done : sequence of (pose, direction)
        Visits that need not be repeated.

    Raises
    ------
    PlanRefused
        The plan violates a limit; no drive was enabled.
    """
    if not set(plan.visits).issubset(done):
        check_plan(plan, workspace)
        plan = plan_from(plan, workspace, arm.where(), done)
        check_plan(plan, workspace)
        yield plan, 0.0, 0
    return "all poses measured"


class Run:
    """One run of a measurement.

    Parameters
    ----------
    arm : Arm
        Connected and configured, not enabled.
    workspace : Workspace
    store : VisitStore
    listeners : sequence of Listener
        Called with every event, in the thread of the run.
    options : MoveOptions, optional
        Their speed override applies to every motion.
    pacing : "lockstep" or "real"
    temperatures : MotorTemperatures or None
        Read while the arm is sampled; None = no drive reports one.

    Attributes
    ----------
    stream : Stream
        Stream of the arm.
    measured : list of Visit
        Complete visits of the present plan.
    missed : tuple of (str, int)
        Excitation and number of the periods that lack a SYNC after a repetition.
    """

    stream: Stream

    def __init__(
        self,
        arm: Arm,
        workspace: Workspace,
        store: VisitStore,
        listeners: Sequence[Listener] = (),
        options: MoveOptions | None = None,
        pacing: Pacing = "lockstep",
        temperatures: MotorTemperatures | None = None,
    ) -> None:
        self.measured: list[Visit] = []
        self.missed: tuple[tuple[str, int], ...] = ()
        self._arm, self._workspace, self._store, self._listeners = arm, workspace, store, listeners
        self._options: MoveOptions = options or MoveOptions()
        self._pacing: Pacing = pacing
        self._temperatures = temperatures
        self._broken: Visit | Period | None = None
        self._elapsed_s = self._now_s = 0.0
        self._gone_rad = 0.0
        self._direction = np.zeros(workspace.robot.axes, dtype=np.int8)
        self._settle_s: dict[int, float] = {}
        self._settled_s = 0.0
        self._first_side: Visit | None = None

    def execute(self, source: MotionSource, load: str) -> str:
        """Execute the plans of a source; after return or an error, the brakes are on and what was measured is on disk.

        Parameters
        ----------
        source : MotionSource
        load : str
            Label of the mounted load.

        Returns
        -------
        str
            Reason of the end of the source.

        Raises
        ------
        PlanRefused
            The arm dropped while its brakes opened, or the source has no allowed motion; the arm was stopped.
        LimitExceeded, PoseNeverSettles
            The arm was stopped.
        DriveError
            Bus or drive failed; the arm was stopped.
        InputError
            The recording cannot be written, or not fast enough; the arm was stopped.
        KeyboardInterrupt
            A stop was requested; the arm was stopped.
        """
        try:
            self._plan, self._further_s, further = next(source)
        except StopIteration as ended:
            return ended.value
        self._load, self._period_s = load, self._plan.settings.period_s
        passes = [step for step in self._plan.steps if isinstance(step, Pass)]
        self._is_first = self._options.first_done is not None
        # excitations are planned at their reduced speed: their run slows its transfers, and the stream slows nothing
        self._is_driven = bool(passes)
        self._schedule()
        if self._is_first and self._ahead_s:
            self._ahead_s[0] /= FIRST_SHARE
        self.stream = stream = Stream(
            Arms((self._arm,), self._pacing),
            (self._workspace,),
            self._period_s,
            replace(self._options, override=1.0) if self._is_driven else self._options,
            self._report,
            lambda state: self.notify(StateChanged(state)),
        )
        desk = self._options.desk
        desk.watch(self._disk)
        try:
            with powered(stream):
                self._refuse_sunk()
                expected_s = sum(self._ahead_s) + self._further_s
                visits = len(self._plan.visits) + sum(len(step.periods) for step in passes) + further
                self.notify(Started(self._arm.name, load, visits, expected_s))
                stream.take_over()
                reason = self._execute_plans(source)
        except BaseException as error:
            self._keep_interrupted(error)
            self._disk()
            self.notify(Stopped(str(error) or type(error).__name__))
            raise
        finally:
            desk.forget(self._disk)
        self._store.flush()
        self._disk()
        return reason

    def notify(self, event: Event) -> None:
        """Send an event to all listeners and observers; an error of a listener requests a stop of the arm.

        All others are still notified.
        """
        for listener in self._listeners:
            guarded(listener, self._options.desk)(event)
        self._options.observers.notify(lambda observer: observer.reported(event))

    def _execute_plans(self, source: MotionSource) -> str:
        while True:
            for step in self._plan.steps:
                if isinstance(step, Pass):
                    self._drive(step)
                    continue
                self._move(step)
                if isinstance(step, PoseVisit):
                    self._settle(step.pose)
                    self._sample(step)
            try:
                self._plan, self._further_s, _ = source.send(self)
            except StopIteration as ended:
                self.notify(Progress(self._steps, self._steps, "done", self._elapsed_s + self._now_s, 0.0))
                return ended.value
            self.measured.clear()
            self._schedule()

    def _schedule(self) -> None:
        """Set the expected times of the plan."""
        override = self._options.override
        self._further_s /= override
        self._ahead_s = deque(step_durations(self._plan, self._workspace, override))
        self._steps = len(self._ahead_s)

    def _next(self, phase: Phase) -> None:
        """Begin the next motion, rest or measurement."""
        self._elapsed_s += self._now_s
        self._now_s = self._ahead_s.popleft()
        self.stream.state.enter(phase, self.stream.sync_index)

    def _report(self, what: str, row: int, rows: int) -> None:
        """Report the progress of the run; called by the motion loop at intervals."""
        done_s = self._now_s * max(row, 0) / rows
        left_s = self._now_s - done_s + sum(self._ahead_s) + self._further_s
        step = self._steps - len(self._ahead_s)
        self.notify(Progress(step, self._steps, what, self._elapsed_s + done_s, left_s))

    def _refuse_sunk(self) -> None:
        """Refuse an arm that dropped while its brakes opened: the checked plan no longer fits."""
        sunk = np.abs(self.stream.q_rad[0] - np.array(self._plan.start_rad))
        if not sunk.max() <= SINK_RAD:
            joint = int(np.argmax(np.nan_to_num(sunk, nan=np.inf))) + 1
            raise PlanRefused(
                f"arm '{self._arm.name}', joint {joint} moved by {sunk[joint - 1]:.3f} rad while its brake opened; "
                f"{ARM_RULES['sinks'].advice}"
            )

    def _move(self, step: MoveTo | PoseVisit) -> None:
        self._next(Phase.MOVING)
        if isinstance(step, PoseVisit):
            what = f"approach pose {step.pose}"
        elif step.is_inwards:
            what = "move back into the joint range"
        else:
            what = "move to the start" if self._is_driven else "move"
        target, (at,) = np.array(step.q_rad), self.stream.q_rad
        limits = motion_limits(step, at, self._workspace, self._plan.settings)
        limits = limits.at_rate(self._options.override if self._is_driven else 1.0)
        self._direction = np.sign(target - at).astype(np.int8)
        self._gone_rad += float(np.abs(target - at).max())
        self.stream.move([straight(at, target, limits, self._period_s)], what)

    def _settle(self, pose: int) -> None:
        self._next(Phase.SETTLING)
        timeout_s = self._plan.settings.settle_timeout_s
        test = SettleTest(self._period_s, self._workspace.torque_nm)
        restless: np.ndarray | None = None
        limit = int(np.ceil(timeout_s / self._period_s))
        for row in range(limit):
            (sample,) = self.stream.hold(f"settle pose {pose}", row, limit)
            if sample.complete:
                test.add(sample.q_rad, sample.joint_torque_nm)
                restless = test.restless()
                if restless is not None and not restless.any():
                    self._settled_s = (row + 1) * self._period_s
                    return
        joint = test.worst + 1
        raise PoseNeverSettles(
            f"pose {pose} does not settle within {timeout_s:g} s: joint {joint} still moves or its torque "
            f"drifts; {ARM_RULES['never_settles'].advice}",
            pose=pose,
            joint=joint,
        )

    def _sample(self, step: PoseVisit) -> None:
        self._next(Phase.SAMPLING)
        count = self._plan.settings.samples
        purpose = next(pose.purpose for pose in self._plan.poses if pose.number == step.pose)
        (at,) = self.stream.q_rad
        label = VisitLabel(self._load, step.pose, purpose, step.direction, self._direction, at)
        samples: list[ArmSample] = []
        repeated = 0
        temperatures = self._temperatures
        if temperatures is not None:
            temperatures.begin()
        try:
            while len(samples) < count:
                (sample,) = self.stream.hold(f"sample pose {step.pose}", len(samples), count)
                if temperatures is not None:
                    temperatures.poll()
                if sample.complete:
                    samples.append(sample)
                    continue
                repeated += 1
                self.notify(SampleRepeated(sample.sync_index, sample.silent))
                if repeated > max(REPEATED_LEAST, REPEATED_SHARE * count):
                    raise IncompleteEpochs(
                        f"pose {step.pose}: {repeated} SYNCs were not answered by all axes while {len(samples)}"
                        " samples were taken",
                        advice=ARM_RULES["repeats"].advice,
                    )
        except BaseException:
            self._broken = visit_from_samples(label, samples, False, repeated) if samples else None
            raise
        visit = visit_from_samples(label, samples, True, repeated, self._temperatures_c())
        first, self._first_side = self._first_side, visit
        if first is not None and first.pose == visit.pose and first.approach == -visit.approach:
            visit = with_half_sums(self._arm, first, visit)
        stored = self._store.add(self._arm.name, visit)
        self.measured.append(stored)
        self._settle_s[stored.number] = self._settled_s

    def _drive(self, driven: Pass) -> None:
        """Drive the periods of a pass, and once more those that lack a SYNC.

        One period is driven slowly before, if no longer motion has tested these drives.
        """
        if self._is_first and self._gone_rad <= FAR_RAD:
            self._is_first = False
            share = FIRST_SHARE if self.stream.first_moved else 1.0  # the stream slows down what comes first
            motion = slowed(driven.excitation, share * driven.speed, self._period_s)
            self._ahead_s.appendleft(motion.duration_s * share / FIRST_SHARE)
            self._steps += 1
            self._next(Phase.MOVING)
            self.stream.move([motion], f"try '{driven.excitation.name}' at {FIRST_SHARE:.0%}")
        incomplete = self._drive_periods(driven, driven.periods)
        if incomplete:
            self._ahead_s.extendleft([len(incomplete) * driven.motion.duration_s, REST_S])
            self._steps += 2
            incomplete = self._drive_periods(driven, incomplete)
        self.missed += tuple((driven.excitation.name, period) for period in incomplete)

    def _drive_periods(self, driven: Pass, periods: Sequence[int]) -> list[int]:
        """Drive periods without a stop; return those that lack a SYNC."""
        incomplete: list[int] = []
        store, temperatures = self._store, self._temperatures
        count, axes = driven.motion.q_rad.shape
        what = f"drive '{driven.excitation.name}'" + (f" at {driven.speed:.0%}" if driven.speed != 1.0 else "")
        log: PeriodLog | None = None

        def taken(row: int, place: int, sample: ArmSample, target_rad: np.ndarray) -> None:
            nonlocal log
            if row == 0 or log is None:
                log = PeriodLog(driven.label(self._load, periods[place]), count, axes)
                if temperatures is not None:
                    temperatures.begin()
            log.add(sample, target_rad)
            if temperatures is not None:
                temperatures.poll()
            if row < count - 1:
                return
            if log.incomplete_epochs:
                incomplete.append(periods[place])
            if len(log):
                store.add(self._arm.name, log.period(self._temperatures_c()))
            log = None

        self._next(Phase.SAMPLING)
        self.stream.stand(REST_S, "rest before it moves")
        self._next(Phase.SAMPLING)
        setpoints = PeriodicSetpoints(self.stream.q_rad[0], driven.motion, len(periods), driven.modelled_nm, taken)
        try:
            self.stream.drive(setpoints, what)
        except BaseException:
            self._broken = log.period() if log is not None and len(log) else None
            raise
        return incomplete

    def _temperatures_c(self) -> np.ndarray | None:
        """Motor temperatures (N,) [deg C] read since the sampling began."""
        return None if self._temperatures is None else self._temperatures.read_c

    def _disk(self) -> StopRequest | None:
        """Report what is on disk; return a stop request if the disk fails or is too slow."""
        for measured in self._store.written():
            self._announce(measured)
        trouble = self._store.trouble()
        return None if trouble is None else StopRequest(StopKind.ALONG_PATH, trouble)

    def _announce(self, visit: Visit | Period) -> None:
        """Report a period, or a complete visit and the pose if it is complete."""
        if isinstance(visit, Period):
            self.notify(
                PeriodDone(
                    number=visit.number,
                    name=visit.name,
                    period=visit.period,
                    load=visit.load,
                    speed=visit.speed,
                    complete=visit.complete,
                    incomplete_epochs=visit.incomplete_epochs,
                )
            )
            return
        if not visit.complete:
            return
        torque = visit.joint_torque_nm
        self.notify(
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
            self.notify(PoseDone(visit.pose, visit.load, gravity, band))

    def _keep_interrupted(self, failure: BaseException) -> None:
        """After the stop, store an interrupted visit or period; an error of this becomes a note of the failure."""
        try:
            if self._broken is not None:
                self._store.add(self._arm.name, self._broken)
            self._store.flush()
        except GatewayError as error:
            if error is not failure:
                failure.add_note(str(error))


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
