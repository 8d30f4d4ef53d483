"""The only loop that sends setpoints: one setpoint per arm and SYNC, every answer checked, every stop request
handled.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np

from drives.realtime import leave_real_time
from gateway.data.visit import ArmSample
from gateway.motion.arms import Arms
from gateway.motion.observer import MotionProgress, Observed, Observers
from gateway.motion.setpoints import MotionSetpoints, PathClock, PerArm, SetpointSource
from gateway.motion.state import CellState, StateTracker
from gateway.motion.stops import StopDesk, StopKind, StopRequest, guarded
from gateway.motion.trajectory import Motion
from gateway.motion.watch import TAKE_OVER_S, Watch, own_torque
from gateway.motion.workspace import Workspace

#: Called at intervals with the description of the motion, the sample number and the number of samples.
Report = Callable[[str, int, int], None]

Result = TypeVar("Result")

#: Interval between two reports [s].
REPORT_S: Final = 0.25
#: Switch interval of the Python interpreter between the loop and other threads [s].
SWITCH_S: Final = 0.0005
#: In real time drives buffer setpoints, so that their arrival time within a period does not matter.
BUFFERED_SYNCS: Final = 2.0
#: Speed override of the first motion with a set of drives.
FIRST_SHARE: Final = 0.1
#: A stop along the path ends when no joint has moved by more than this [rad] for the first time [s], or after the
#: second.
REST_RAD: Final = 5e-5
REST_S, REST_LONGEST_S = 0.02, 0.4
#: Minimum number of SYNCs: at a reversal or with a delayed reading two successive readings may be equal.
REST_SYNCS: Final = 3
#: Tolerance for rounding a number of periods.
HAIR: Final = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class MoveOptions:
    """Options of a motion, and the sources of stop requests.

    Attributes
    ----------
    desk : StopDesk
    override : float
        Speed override in (0, 1].
    first_done : callable or None
        Set if these drives have not moved yet: the first motion then runs at `FIRST_SHARE` of its speed. Called after
        that motion, when the brakes are on.
    before_question : callable
        Called before a person is asked whether arms may move: plan and drives were accepted.
    ready : callable
        Called before the arms are powered; returns when the operator is ready.
    observers : Observers
        Observers of the motion.
    """

    desk: StopDesk = field(default_factory=StopDesk)
    override: float = 1.0
    first_done: Callable[[], None] | None = None
    before_question: Callable[[], None] = lambda: None
    ready: Callable[[], None] = lambda: None
    observers: Observers = field(default_factory=Observers)


class Stream:
    """Motion and standstill of enabled arms.

    Parameters
    ----------
    arms : Arms
        Connected and configured, not enabled.
    workspaces : tuple of Workspace
        One per arm.
    period_s : float
        SYNC period.
    options : MoveOptions, optional
    report : Report, optional
        An error that it raises requests a stop along the path.
    state_changed : callable, optional
        Called with every new state of the arms.

    Attributes
    ----------
    state : StateTracker
        Its `state` is the present state of the arms.
    q_rad : tuple of arrays of shape (N,)
        Last setpoints, one per arm.
    samples : tuple of ArmSample
        Last measurement.
    moving : bool
        Setpoints of a trajectory are being sent.
    urgent : bool
        A quick stop was requested.
    sync_index : int
        SYNC of the last answer.
    first_moved : bool
        True after the first motion with these drives.
    """

    def __init__(
        self,
        arms: Arms,
        workspaces: tuple[Workspace, ...],
        period_s: float,
        options: MoveOptions | None = None,
        report: Report = lambda _what, _row, _rows: None,
        state_changed: Callable[[CellState], None] = lambda _state: None,
    ) -> None:
        self.arms, self.workspaces, self.period_s = arms, workspaces, period_s
        self.options = options or MoveOptions()
        self.state = StateTracker(" and ".join(arm.name for arm in arms.members), state_changed)
        self.q_rad: PerArm = ()
        self.samples: tuple[ArmSample, ...] = ()
        self.moving = self.urgent = self.first_moved = False
        self.sync_index = 0
        self._desk = self.options.desk
        delay_syncs = BUFFERED_SYNCS if arms.real else 0.0
        self._watches = [
            Watch(arm.name, workspace, period_s, delay_syncs, own_torque(arm, workspace, period_s))
            for arm, workspace in zip(arms.members, workspaces, strict=True)
        ]
        self._acceleration = np.concatenate([workspace.acceleration_rad_s2 for workspace in workspaces])
        self._jerk = np.concatenate([workspace.jerk_rad_s3 for workspace in workspaces])
        self._progress = guarded(report, self._desk)
        self._first_done = self.options.first_done
        self._every = max(1, round(REPORT_S / period_s))
        self._gravity_nm: PerArm = ()

    def start(self) -> None:
        """Enable the arms; they hold their present positions.

        Raises
        ------
        DriveError
            A drive failed; no arm is under power.
        StoppedByPerson
            A stop was requested while enabling; no arm is under power.
        """
        try:
            self.samples = self.arms.enable(self._desk.asked)
        except BaseException as error:
            wish = self._desk.look()
            if wish is not None and not isinstance(error, type(wish.cause)):
                raise wish.cause from error
            raise
        self.sync_index = self.samples[0].sync_index
        self.q_rad = tuple(sample.q_rad for sample in self.samples)
        for watch, q_rad in zip(self._watches, self.q_rad, strict=True):
            watch.start(q_rad)
        self._model()

    def move(self, motions: Sequence[Motion], what: str) -> None:
        """Stream one prepared motion per arm, from the last setpoints to rest; raises as `drive`."""
        if len(motions[0]):
            self.drive(MotionSetpoints(self.q_rad, motions), what)

    def drive(self, source: SetpointSource, what: str) -> None:
        """Stream a trajectory to its end, or to the end of a stop along it.

        Raises
        ------
        LimitExceeded
            A monitored limit was exceeded.
        DriveError
            Bus or drive failed.
        BaseException
            The cause of a stop request; the arms are at rest, or (`urgent`) have to be stopped by their drives' ramps.
        """
        first_done, self._first_done = self._first_done, None
        share = self.options.override
        if first_done is not None:
            share = min(FIRST_SHARE, share)
        if self.arms.real:  # what was computed meanwhile must not pass for a stall of the motion
            self.hold(what, 0, 1)
        clock = PathClock(source.count, self.period_s, self._acceleration, self._jerk, share)
        self.moving = source.count > 0
        row = 0
        while not clock.done:
            if self._stop_request() is not None:
                clock.stop()
            at = clock.advance(*source.rates(clock.at))
            if clock.done and not clock.arrived:
                break
            if row % self._every == 0:
                self._report(what, int(at), source.count)
            row += 1
            self._send(source, at, clock.rate)
        if not clock.arrived:
            self._come_to_rest(source, clock.at)
        self.moving = False
        self._model()
        self.first_moved |= first_done is not None and clock.arrived
        wish = self._desk.look()
        if wish is not None:
            raise wish.cause

    def _stop_request(self) -> StopRequest | None:
        """Return the request of a stop along the path; raise the cause of a quick stop."""
        wish = self._desk.look()
        self.urgent = wish is not None and wish.kind is StopKind.QUICK_STOP
        if wish is not None and self.urgent:
            raise wish.cause
        return wish

    def _come_to_rest(self, source: SetpointSource, at: float) -> None:
        """Hold the setpoints until the joints have caught up, before anything is disabled."""
        span = max(REST_SYNCS, round(REST_S / self.period_s))
        seen: deque[np.ndarray] = deque(maxlen=span + 1)
        for _ in range(round(REST_LONGEST_S / self.period_s)):
            self._stop_request()
            self._send(source, at, 0.0)
            seen.append(np.concatenate([sample.q_rad for sample in self.samples]))
            if len(seen) > span and np.ptp(np.array(seen), axis=0).max() <= REST_RAD:
                return

    def _send(self, source: SetpointSource, at: float, rate: float) -> None:
        targets = source.targets(at, rate)
        ahead, offsets = source.ahead(at, rate), source.offsets()
        commands = [
            arm.command(q, None if ahead is None else ahead[index], None if offsets is None else offsets[index])
            for index, (arm, q) in enumerate(zip(self.arms.members, targets, strict=True))
        ]
        samples = self.samples = self.arms.exchange(commands)
        self.q_rad = targets
        modelled = source.modelled(at)
        if modelled is None:
            modelled = tuple(watch.moved_torque(q) for watch, q in zip(self._watches, targets, strict=True))
        self._look(samples, modelled)
        source.take(at, rate, samples)

    def hold(self, what: str, row: int, rows: int, *, heed: bool = True) -> tuple[ArmSample, ...]:
        """Exchange one SYNC at rest; raises as `drive`. Without `heed`, stop requests are handled later."""
        if row % self._every == 0:
            self._report(what, row, rows)
        wish = self._stop_request() if heed else None
        if wish is not None:
            raise wish.cause
        samples = self.samples = self.arms.hold()
        self._look(samples, self._gravity_nm)
        return samples

    def stand(self, seconds: float, what: str, listen: Callable[[tuple[ArmSample, ...]], None] | None = None) -> None:
        """Stay at rest for a time and pass every sample to a listener; raises as `drive`."""
        rows = math.ceil(seconds / self.period_s - HAIR)
        for row in range(rows):
            samples = self.hold(what, row, rows)
            if listen is not None:
                listen(samples)

    def take_over(self, listen: Callable[[tuple[ArmSample, ...]], None] | None = None) -> None:
        """Stay at rest until the drives carry the torque that the brakes carried; parameters as `stand`."""
        self.stand(TAKE_OVER_S, "open the brakes", listen)

    def excuse(self, arm: int, joints: np.ndarray) -> None:
        """Check only the joint range for joints (bool, (N,)) of one arm (index from 0) from now on."""
        self._watches[arm].excuse(joints)

    def hold_while(self, job: Callable[[], Result], what: str) -> Result:
        """Run a job that takes longer than a SYNC period while the arms are kept at rest under SYNC.

        In lockstep, where no time passes on the bus, the job runs in the calling thread. A stop does not wait for the
        job: it is raised while the job continues in its thread, and its result is dropped.
        """
        if not (self.arms.real and self.arms.enabled):
            return job()
        # the first SYNC of arms at rest counts as one of moving arms: nothing may delay it
        self.hold(what, 0, 1)
        switch_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_S)
        beside = ThreadPoolExecutor(1, thread_name_prefix="beside", initializer=leave_real_time)
        done = beside.submit(job)
        try:
            row = 0
            while not done.done():
                self.hold(what, row, row + 1)
                row += 1
            return done.result()
        finally:
            beside.shutdown(wait=False)
            if done.done():
                sys.setswitchinterval(switch_s)
            else:  # the SYNCs of the stop must not wait for the job either
                done.add_done_callback(lambda _done: sys.setswitchinterval(switch_s))

    def _report(self, what: str, row: int, rows: int) -> None:
        self._progress(what, row, rows)
        progress = MotionProgress(what, row, rows)
        self.options.observers.notify(lambda observer: observer.reported(progress))

    def _look(self, samples: tuple[ArmSample, ...], modelled_nm: PerArm) -> None:
        self.sync_index = samples[0].sync_index
        try:
            for watch, sample, target, modelled in zip(self._watches, samples, self.q_rad, modelled_nm, strict=True):
                watch.check(sample, target, modelled)
        finally:
            observed = Observed(samples, self.q_rad, modelled_nm)
            self.options.observers.notify(lambda observer: observer.sampled(observed))

    def _model(self) -> None:
        pairs = zip(self._watches, self.q_rad, strict=True)
        self._gravity_nm = tuple(watch.modelled_torque(q[None])[0] for watch, q in pairs)
