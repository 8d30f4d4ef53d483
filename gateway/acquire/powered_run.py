"""Execute a plan under power: check it, power the arm, drive the run, store interrupted visits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from gateway.acquire.events import StateChanged, Stopped
from gateway.acquire.plan import Plan, check_plan, plan_from
from gateway.acquire.rest_run import Run
from gateway.acquire.station import VisitStation
from gateway.data.period import Period
from gateway.data.visit import Visit
from gateway.errors import GatewayError
from gateway.motion.arms import Arms
from gateway.motion.power import powered
from gateway.motion.state import StateTracker
from gateway.motion.stops import StopKind, StopRequest
from gateway.motion.stream import MoveOptions, Station, Stream


@dataclass(frozen=True, slots=True)
class RunRequest:
    """Plan to run, with the label of the load.

    Attributes
    ----------
    plan : Plan
    load : str
        Label of the mounted load.
    done : tuple of (pose, direction)
        Visits that need not be repeated.
    """

    plan: Plan
    load: str
    done: tuple[tuple[int, int], ...] = ()


def run_plan(station: VisitStation, request: RunRequest) -> None:
    """Run a plan from the present posture; after return or an error, the brakes are on and the visits are on disk.

    Raises
    ------
    PlanRefused
        The plan violates a limit; no drive was enabled.
    LimitExceeded, PoseNeverSettles
        The arm was stopped.
    DriveError
        Bus or drive failed; the arm was stopped.
    InputError
        The recording cannot be written, or not fast enough; the arm was stopped.
    KeyboardInterrupt
        A stop was requested; the arm was stopped.
    """
    check_plan(request.plan, station.workspace)
    plan = plan_from(request.plan, station.workspace, station.arm.where(), request.done)
    check_plan(plan, station.workspace)
    execute(station, plan, request.load, Run.execute)


def run_transfer(station: VisitStation, plan: Plan) -> None:
    """Run a plan that contains moves only; after return or an error, the brakes are on.

    Parameters
    ----------
    station : VisitStation
    plan : Plan
        Plan made by `plan_to` from the present posture.

    Raises
    ------
    PlanRefused, LimitExceeded, DriveError, KeyboardInterrupt
        As `run_plan`.
    """
    check_plan(plan, station.workspace)
    execute(station, plan, "", Run.execute)


def execute(station: VisitStation, plan: Plan, load: str, drive: Callable[[Run, Stream], None]) -> None:
    """Drive a run under power; afterwards, also after an error, the brakes are on and the visits are on disk.

    Parameters
    ----------
    station : VisitStation
    plan : Plan
        From the present posture of the arm, checked.
    load : str
    drive : callable
        Called with the run and the stream once the arm is under power.
    """
    run = Run(station, plan, load, tracked_state(station, plan.arm))
    under_power(station, run, Powered(plan.arm, plan.settings.period_s, station.options), lambda on: drive(run, on))


def tracked_state(station: VisitStation, arm: str) -> StateTracker:
    """Return the state tracker of a run; it notifies the listeners of the station."""
    return StateTracker(arm, lambda new: station.notify(StateChanged(new)))


class PoweredRun(Protocol):
    """Run that can be driven under power."""

    @property
    def broken(self) -> Visit | Period | None:
        """Visit or period that an error interrupted."""
        ...

    @property
    def state(self) -> StateTracker:
        """State of the arm during the run."""
        ...

    def announce(self, kept: Visit | Period, /) -> None:
        """Report a visit or period that is on disk."""
        ...

    def report(self, what: str, row: int, rows: int) -> None:
        """Report the progress of the run."""
        ...


@dataclass(frozen=True, slots=True)
class Powered:
    """Name of the arm, SYNC period [s], and how its stream may be driven."""

    arm: str
    period_s: float
    options: MoveOptions


def under_power(station: VisitStation, run: PoweredRun, what: Powered, drive: Callable[[Stream], None]) -> None:
    """Power the arm and drive a run; afterwards, also after an error, the brakes are on and the data are on disk.

    Parameters
    ----------
    station : VisitStation
    run : PoweredRun
    what : Powered
    drive : callable
        Called with the stream once the arm is under power.
    """

    def disk() -> StopRequest | None:
        for kept in station.store.written():
            run.announce(kept)
        trouble = station.store.trouble()
        return None if trouble is None else StopRequest(StopKind.ALONG_PATH, trouble)

    station.options.desk.watch(disk)
    try:
        with powered(Stream(_moved(station, run, what))) as stream:
            drive(stream)
    except BaseException as error:
        _keep_the_rest(station, run, what.arm, error)
        disk()
        station.notify(Stopped(str(error) or type(error).__name__))
        raise
    finally:
        station.options.desk.forget(disk)
    station.store.flush()
    disk()


def _moved(station: VisitStation, run: PoweredRun, what: Powered) -> Station:
    return Station(
        arms=Arms((station.arm,), station.pacing),
        workspaces=(station.workspace,),
        period_s=what.period_s,
        state=run.state,
        options=what.options,
        report=run.report,
    )


def _keep_the_rest(station: VisitStation, run: PoweredRun, arm: str, failure: BaseException) -> None:
    """After the stop, store an interrupted visit or period; an error of this becomes a note of the failure."""
    try:
        if run.broken is not None:
            station.store.add(arm, run.broken)
        station.store.flush()
    except GatewayError as error:
        if error is not failure:
            failure.add_note(str(error))
