"""Drive a moving plan under power: transfer to the start, all periods without a stop, then the next excitation."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from gateway.acquire.events import PeriodDone, Progress, Started
from gateway.acquire.passes import Pass, PeriodicSetpoints, check_pass, free_torque_nm, slowed
from gateway.acquire.plan import (
    MoveInwards,
    MoveTo,
    Plan,
    VisitSettings,
    inward_limits,
    plan_to,
    step_durations,
    travel_limits,
)
from gateway.acquire.rest_run import refuse_sunk
from gateway.acquire.station import VisitStation
from gateway.cell.config import ArmConfig
from gateway.data.period import Period, PeriodLog
from gateway.data.sample import ArmSample
from gateway.data.visit import Visit
from gateway.motion.state import Phase, StateTracker
from gateway.motion.stream import FIRST_SHARE, Stream
from gateway.motion.trajectory import MotionLimits, straight

#: Rest before each pass [s]: following errors settle, so that the first period begins like the others.
REST_S: Final = 0.3
#: A transfer that is longer counts as the first motion with these drives [rad].
FAR_RAD: Final = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class DrivenLeg:
    """Transfer motion to the start of a pass, and the pass.

    Attributes
    ----------
    transfer : Plan
        Plan made by `plan_to`.
    driven : Pass
    modelled_nm : array of shape (n, N) or None
        Modelled joint torque [Nm] of one period without contact.
    """

    transfer: Plan
    driven: Pass
    modelled_nm: np.ndarray | None


def legs_from(
    station: VisitStation, config: ArmConfig, start_rad: np.ndarray, passes: Sequence[Pass], settings: VisitSettings
) -> tuple[DrivenLeg, ...]:
    """Plan transfers and passes from the present posture without moving; call `check_moving_plan` first.

    Raises
    ------
    PlanRefused
        The samples of a pass do not determine its motion, or no path within the limits leads to its start.
    """
    legs, at = [], start_rad
    for one in passes:
        check_pass(config.name, one, station.workspace.robot.axes)
        transfer = plan_to(config.name, station.workspace, at, one.excitation.start_rad, settings)
        legs.append(DrivenLeg(transfer, one, free_torque_nm(station.workspace, config, one.motion, station.arm.known)))
        at = one.excitation.start_rad
    return tuple(legs)


class MovingRun:
    """Run of a moving plan under power; `broken` is the period that an error interrupted.

    Parameters
    ----------
    station : VisitStation
        Its speed override is applied here to transfers and passes; the stream does not scale them again.
    legs : tuple of DrivenLeg
        From the present posture of the arm.
    load : str
    state : StateTracker

    Attributes
    ----------
    missed : tuple of (str, int)
        Excitation and number of the periods that lack a SYNC after a repetition.
    """

    def __init__(self, station: VisitStation, legs: Sequence[DrivenLeg], load: str, state: StateTracker) -> None:
        self.broken: Period | None = None
        self.missed: tuple[tuple[str, int], ...] = ()
        self.state = state
        self._legs, self._load = tuple(legs), load
        self._station, self._store, self._notify = station, station.store, station.notify
        self._speed = station.options.override
        self._period_s = legs[0].transfer.settings.period_s
        self._first = station.options.first_done is not None
        self._gone_rad = 0.0
        self._incomplete: list[int] = []
        self._elapsed_s = self._now_s = 0.0
        self._ahead_s = deque(self._durations())
        self._steps = len(self._ahead_s)

    def _durations(self) -> list[float]:
        """Return the planned time of every motion and rest."""
        out: list[float] = []
        for leg in self._legs:
            out += [second / self._speed for second in step_durations(leg.transfer, self._station.workspace)]
            out += [REST_S, leg.driven.duration_s]
        out[0] /= FIRST_SHARE if self._first else 1.0
        return out

    def execute(self, stream: Stream) -> None:
        """Drive all legs."""
        refuse_sunk(self._legs[0].transfer, stream)
        self._stream = stream
        periods = sum(len(leg.driven.periods) for leg in self._legs)
        self._notify(Started(self._legs[0].transfer.arm, self._load, periods, sum(self._ahead_s)))
        stream.take_over()
        for leg in self._legs:
            self.state.enter(Phase.MOVING, stream.sync_index)
            self._go(leg.transfer)
            self._try(leg.driven)
            self.state.enter(Phase.SAMPLING, stream.sync_index)
            self._drive(leg, leg.driven.periods)
            if self._incomplete:
                again = tuple(self._incomplete)
                self._ahead_s.extendleft([len(again) * leg.driven.motion.duration_s, REST_S])
                self._steps += 2
                self._drive(leg, again)
            self.missed += tuple((leg.driven.excitation.name, period) for period in self._incomplete)
        self._notify(Progress(self._steps, self._steps, "done", self._elapsed_s + self._now_s, 0.0))

    def report(self, what: str, row: int, rows: int) -> None:
        """Report the progress of the run; called by the motion loop at intervals."""
        done_s = self._now_s * max(row, 0) / rows
        left_s = self._now_s - done_s + sum(self._ahead_s)
        self._notify(Progress(self._steps - len(self._ahead_s), self._steps, what, self._elapsed_s + done_s, left_s))

    def _next(self) -> None:
        """Announce the next motion or rest."""
        self._elapsed_s += self._now_s
        self._now_s = self._ahead_s.popleft()

    def _go(self, transfer: Plan) -> None:
        workspace = self._station.workspace
        for step in transfer.steps:
            if not isinstance(step, MoveTo | MoveInwards):
                raise TypeError("a transfer may contain moves only")
            self._next()
            inwards = isinstance(step, MoveInwards)
            limits = _slowed(inward_limits(workspace) if inwards else travel_limits(workspace), self._speed)
            what = "move back into the joint range" if inwards else "move to the start"
            target, (at,) = np.array(step.q_rad), self._stream.q_rad
            self._gone_rad += float(np.abs(target - at).max())
            self._stream.move([straight(at, target, limits, self._period_s)], what)

    def _try(self, driven: Pass) -> None:
        """Drive one period slowly if no longer motion has tested these drives before."""
        if not self._first or self._gone_rad > FAR_RAD:
            return
        self._first = False
        share = FIRST_SHARE if self._stream.first_moved else 1.0  # the stream slows down what comes first
        motion = slowed(driven.excitation, share * driven.speed, self._period_s)
        self._ahead_s.appendleft(motion.duration_s * share / FIRST_SHARE)
        self._steps += 1
        self._next()
        self._stream.move([motion], f"try '{driven.excitation.name}' at {FIRST_SHARE:.0%}")

    def _drive(self, leg: DrivenLeg, periods: tuple[int, ...]) -> None:
        """Drive a number of periods without a stop; note those that lack a SYNC."""
        self._incomplete = []
        driven, store, temperatures = leg.driven, self._store, self._station.temperatures
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
                self._incomplete.append(periods[place])
            if len(log):
                store.add(leg.transfer.arm, log.period(self._station.temperatures_c()))
            log = None

        self._next()
        self._stream.stand(REST_S, "rest before it moves")
        self._next()
        setpoints = PeriodicSetpoints(self._stream.q_rad[0], driven.motion, len(periods), leg.modelled_nm, taken)
        try:
            self._stream.drive(setpoints, what)
        except BaseException:
            self.broken = log.period() if log is not None and len(log) else None
            raise

    def announce(self, period: Visit | Period, /) -> None:
        """Report a period that is on disk."""
        if not isinstance(period, Period):
            return
        self._notify(
            PeriodDone(
                number=period.number,
                name=period.name,
                period=period.period,
                load=period.load,
                speed=period.speed,
                complete=period.complete,
                incomplete_epochs=period.incomplete_epochs,
            )
        )


def _slowed(limits: MotionLimits, speed: float) -> MotionLimits:
    """Return the limits for the same path at a share of its speed."""
    return MotionLimits(
        speed * limits.speed_rad_s, speed**2 * limits.acceleration_rad_s2, speed**3 * limits.jerk_rad_s3
    )
