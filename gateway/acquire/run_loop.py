"""The run loop of every measurement: power the arm, take the next motions from a source, execute, measure and store.

A source yields plans, each from the posture in which the plan before ends. `motions_of` yields one plan: rest poses,
excitations or a transfer. `until/run.py` yields pose after pose while a load is estimated. The brakes are on before and
after.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from drives.errors import IncompleteEpochs
from gateway.acquire.events import (
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
    Approach,
    MoveInwards,
    MoveTo,
    Plan,
    Sample,
    Settle,
    check_plan,
    motion_limits,
    plan_from,
    step_durations,
)
from gateway.acquire.settle import SettleTest
from gateway.acquire.station import VisitStation
from gateway.data.period import Period, PeriodLog
from gateway.data.sample import ArmSample
from gateway.data.visit import Visit, VisitLabel, visit_from_samples
from gateway.errors import GatewayError, PlanRefused, PoseNeverSettles
from gateway.motion.arm import Arm
from gateway.motion.arms import Arms
from gateway.motion.power import powered
from gateway.motion.reactions import ARM_RULES
from gateway.motion.state import Phase, StateTracker
from gateway.motion.stops import StopKind, StopRequest
from gateway.motion.stream import FIRST_SHARE, Station, Stream
from gateway.motion.trajectory import MotionLimits, straight

#: Largest number of incomplete SYNCs while sampling, as a share of the requested samples.
REPEATED_SHARE = ARM_RULES["repeats"].limit
REPEATED_LEAST = 10
#: Largest drop of a joint when its brakes open [rad] for which the checked plan still holds.
SINK_RAD = ARM_RULES["sinks"].limit
#: A transfer that is longer counts as the first motion with these drives [rad].
FAR_RAD: Final = 0.1

#: Source of the next motions. Yields a checked plan from the present posture and the time [s] expected in addition to
#: it. Advanced before the arm is powered, then with the stream whenever a plan is executed and the arm is at rest.
MotionSource = Generator[tuple[Plan, float], Stream, None]


def motions_of(plan: Plan) -> MotionSource:
    """Yield one plan."""
    yield plan, 0.0


def run_plan(station: VisitStation, plan: Plan, load: str, done: Sequence[tuple[int, int]] = ()) -> None:
    """Run a plan at rest from the present posture; parameters and errors as `run_motions`.

    Parameters
    ----------
    station : VisitStation
    plan : Plan
        Its poses are ordered from the present posture.
    load : str
    done : sequence of (pose, direction)
        Visits that need not be repeated.

    Raises
    ------
    PlanRefused
        The plan violates a limit; no drive was enabled.
    """
    check_plan(plan, station.workspace)
    plan = plan_from(plan, station.workspace, station.arm.where(), done)
    check_plan(plan, station.workspace)
    run_motions(station, motions_of(plan), load, len(plan.visits))


def run_motions(
    station: VisitStation, source: MotionSource, load: str, measurements: int
) -> tuple[tuple[str, int], ...]:
    """Execute the plans of a source; after return or an error, the brakes are on and what was measured is on disk.

    Parameters
    ----------
    station : VisitStation
        The speed override of its options applies to every motion.
    source : MotionSource
    load : str
        Label of the mounted load.
    measurements : int
        Expected number of visits and periods.

    Returns
    -------
    tuple of (str, int)
        Excitation and number of the periods that lack a SYNC after a repetition.

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
    run = _Run(station, source, load)
    run.execute(measurements)
    return run.missed


class _Run:
    """State of one run; `missed` as `run_motions` returns it."""

    def __init__(self, station: VisitStation, source: MotionSource, load: str) -> None:
        self.missed: tuple[tuple[str, int], ...] = ()
        self._station, self._source, self._load = station, source, load
        self._plan, self._further_s = next(source)
        self._arm, self._period_s = self._plan.arm, self._plan.settings.period_s
        self._state = StateTracker(self._arm, lambda new: station.notify(StateChanged(new)))
        self._is_first = station.options.first_done is not None
        # excitations are planned at their reduced speed: their run slows its transfers, and the stream slows nothing
        self._is_driven = any(isinstance(step, Pass) for step in self._plan.steps)
        self._broken: Visit | Period | None = None
        self._elapsed_s = self._now_s = 0.0
        self._schedule()
        if self._is_first and self._ahead_s:
            self._ahead_s[0] /= FIRST_SHARE
        self._gone_rad = 0.0
        self._direction = np.zeros(station.workspace.robot.axes, dtype=np.int8)
        self._settle_s: dict[int, float] = {}
        self._settled_s = 0.0
        self._first_side: Visit | None = None

    def execute(self, measurements: int) -> None:
        """Power the arm and execute every plan; store what an error has interrupted."""
        station = self._station
        options = replace(station.options, override=1.0) if self._is_driven else station.options
        moved = Station(
            arms=Arms((station.arm,), station.pacing),
            workspaces=(station.workspace,),
            period_s=self._period_s,
            state=self._state,
            options=options,
            report=self._report,
        )
        station.options.desk.watch(self._disk)
        try:
            with powered(Stream(moved)) as stream:
                self._stream = stream
                self._refuse_sunk()
                expected_s = sum(self._ahead_s) + self._further_s
                station.notify(Started(self._arm, self._load, measurements, expected_s))
                stream.take_over()
                self._execute_plans()
        except BaseException as error:
            self._keep_interrupted(error)
            self._disk()
            station.notify(Stopped(str(error) or type(error).__name__))
            raise
        finally:
            station.options.desk.forget(self._disk)
        station.store.flush()
        self._disk()

    def _execute_plans(self) -> None:
        while True:
            for step in self._plan.steps:
                if isinstance(step, Settle):
                    self._settle(step)
                elif isinstance(step, Sample):
                    self._sample(step)
                elif isinstance(step, Pass):
                    self._drive(step)
                else:
                    self._move(step)
            try:
                self._plan, self._further_s = self._source.send(self._stream)
            except StopIteration:
                break
            self._schedule()
        elapsed_s = self._elapsed_s + self._now_s
        self._station.notify(Progress(self._steps, self._steps, "done", elapsed_s, 0.0))

    def _schedule(self) -> None:
        """Set the expected times of the plan."""
        override = self._station.options.override
        self._further_s /= override
        self._ahead_s = deque(step_durations(self._plan, self._station.workspace, override))
        self._steps = len(self._ahead_s)

    def _next(self, phase: Phase) -> None:
        """Begin the next motion, rest or measurement."""
        self._elapsed_s += self._now_s
        self._now_s = self._ahead_s.popleft()
        self._state.enter(phase, self._stream.sync_index)

    def _report(self, what: str, row: int, rows: int) -> None:
        """Report the progress of the run; called by the motion loop at intervals."""
        done_s = self._now_s * max(row, 0) / rows
        left_s = self._now_s - done_s + sum(self._ahead_s) + self._further_s
        step = self._steps - len(self._ahead_s)
        self._station.notify(Progress(step, self._steps, what, self._elapsed_s + done_s, left_s))

    def _refuse_sunk(self) -> None:
        """Refuse an arm that dropped while its brakes opened: the checked plan no longer fits."""
        sunk = np.abs(self._stream.q_rad[0] - np.array(self._plan.start_rad))
        if not sunk.max() <= SINK_RAD:
            joint = int(np.argmax(np.nan_to_num(sunk, nan=np.inf))) + 1
            raise PlanRefused(
                f"arm '{self._arm}', joint {joint} moved by {sunk[joint - 1]:.3f} rad while its brake opened; "
                f"{ARM_RULES['sinks'].advice}"
            )

    def _move(self, step: MoveTo | MoveInwards | Approach) -> None:
        self._next(Phase.MOVING)
        if isinstance(step, MoveInwards):
            what = "move back into the joint range"
        elif isinstance(step, Approach):
            what = f"approach pose {step.pose}"
        else:
            what = "move to the start" if self._is_driven else "move"
        limits = motion_limits(step, self._station.workspace, self._plan.settings)
        if self._is_driven:
            speed = self._station.options.override
            limits = MotionLimits(
                speed * limits.speed_rad_s, speed**2 * limits.acceleration_rad_s2, speed**3 * limits.jerk_rad_s3
            )
        target, (at,) = np.array(step.q_rad), self._stream.q_rad
        self._direction = np.sign(target - at).astype(np.int8)
        self._gone_rad += float(np.abs(target - at).max())
        self._stream.move([straight(at, target, limits, self._period_s)], what)

    def _settle(self, step: Settle) -> None:
        self._next(Phase.SETTLING)
        test = SettleTest(self._period_s, self._station.workspace.torque_nm)
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
        self._next(Phase.SAMPLING)
        purpose = next(pose.purpose for pose in self._plan.poses if pose.number == step.pose)
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
                self._station.notify(SampleRepeated(sample.sync_index, sample.silent))
                if repeated > max(REPEATED_LEAST, REPEATED_SHARE * step.count):
                    raise IncompleteEpochs(
                        f"pose {step.pose}: {repeated} SYNCs were not answered by all axes while {len(samples)}"
                        " samples were taken",
                        advice=ARM_RULES["repeats"].advice,
                    )
        except BaseException:
            self._broken = visit_from_samples(label, samples, False, repeated) if samples else None
            raise
        visit = visit_from_samples(label, samples, True, repeated, self._station.temperatures_c())
        first, self._first_side = self._first_side, visit
        if first is not None and first.pose == visit.pose and first.approach == -visit.approach:
            visit = with_half_sums(self._station.arm, first, visit)
        self._settle_s[self._station.store.add(self._arm, visit).number] = self._settled_s

    def _drive(self, driven: Pass) -> None:
        """Drive the periods of a pass, and once more those that lack a SYNC.

        One period is driven slowly before, if no longer motion has tested these drives.
        """
        if self._is_first and self._gone_rad <= FAR_RAD:
            self._is_first = False
            share = FIRST_SHARE if self._stream.first_moved else 1.0  # the stream slows down what comes first
            motion = slowed(driven.excitation, share * driven.speed, self._period_s)
            self._ahead_s.appendleft(motion.duration_s * share / FIRST_SHARE)
            self._steps += 1
            self._next(Phase.MOVING)
            self._stream.move([motion], f"try '{driven.excitation.name}' at {FIRST_SHARE:.0%}")
        incomplete = self._drive_periods(driven, driven.periods)
        if incomplete:
            self._ahead_s.extendleft([len(incomplete) * driven.motion.duration_s, REST_S])
            self._steps += 2
            incomplete = self._drive_periods(driven, incomplete)
        self.missed += tuple((driven.excitation.name, period) for period in incomplete)

    def _drive_periods(self, driven: Pass, periods: Sequence[int]) -> list[int]:
        """Drive periods without a stop; return those that lack a SYNC."""
        incomplete: list[int] = []
        store, temperatures = self._station.store, self._station.temperatures
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
                store.add(self._arm, log.period(self._station.temperatures_c()))
            log = None

        self._next(Phase.SAMPLING)
        self._stream.stand(REST_S, "rest before it moves")
        self._next(Phase.SAMPLING)
        setpoints = PeriodicSetpoints(self._stream.q_rad[0], driven.motion, len(periods), driven.modelled_nm, taken)
        try:
            self._stream.drive(setpoints, what)
        except BaseException:
            self._broken = log.period() if log is not None and len(log) else None
            raise
        return incomplete

    def _disk(self) -> StopRequest | None:
        """Report what is on disk; return a stop request if the disk fails or is too slow."""
        for measured in self._station.store.written():
            self._announce(measured)
        trouble = self._station.store.trouble()
        return None if trouble is None else StopRequest(StopKind.ALONG_PATH, trouble)

    def _announce(self, visit: Visit | Period) -> None:
        """Report a period, or a complete visit and the pose if it is complete."""
        if isinstance(visit, Period):
            self._station.notify(
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
        self._station.notify(
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
            self._station.notify(PoseDone(visit.pose, visit.load, gravity, band))

    def _keep_interrupted(self, failure: BaseException) -> None:
        """After the stop, store an interrupted visit or period; an error of this becomes a note of the failure."""
        try:
            if self._broken is not None:
                self._station.store.add(self._arm, self._broken)
            self._station.store.flush()
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
