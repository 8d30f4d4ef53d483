"""The only loop: runs a checked plan SYNC by SYNC, and leaves the arm standing with its brakes on, whatever happens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drives.errors import DriveError
from gateway.acquire.events import Stopped
from gateway.acquire.plan import Plan, check_plan, plan_from
from gateway.acquire.run import Run, Station
from gateway.errors import GatewayError, LimitExceeded
from gateway.motion.state import Phase


@dataclass(frozen=True, slots=True)
class RunRequest:
    """What to run.

    Attributes
    ----------
    plan : Plan
    load : str
        Label of what hangs on the flange.
    done : tuple of (pose, direction)
        Visits that need not be repeated.
    """

    plan: Plan
    load: str
    done: tuple[tuple[int, int], ...] = ()


def run_plan(station: Station, request: RunRequest) -> None:
    """Run a plan from where the arm stands; on return, and after any error, the brakes are on.

    Raises
    ------
    PlanRefused
        The plan breaks a limit; nothing was enabled.
    LimitExceeded, PoseNeverSettles
        The arm was stopped.
    DriveError
        Bus or drive failed; the arm was stopped.
    KeyboardInterrupt
        A stop was asked for; the arm was stopped.
    """
    check_plan(request.plan, station.workspace)
    plan = plan_from(request.plan, station.workspace, station.arm.where(), request.done)
    check_plan(plan, station.workspace)
    run = Run(station, plan, request.load)
    failure: BaseException | None = None
    try:
        run.start(station.arm.enable())
        run.execute()
    except BaseException as error:
        failure = error
        raise
    finally:
        run.state.enter(Phase.STOPPING, run.sync_index)
        since = run.state.state
        _make_safe(station, run, failure)
        if failure is None:
            run.state.enter(Phase.IN_BRAKES, run.sync_index)
        else:
            failure.add_note(f"It happened at {since.since:%H:%M:%S} UTC, SYNC {since.sync_index} of this run.")
            run.state.enter(Phase.STOPPED, run.sync_index, str(failure) or type(failure).__name__)
            _keep_the_rest(station, run, failure)


def _make_safe(station: Station, run: Run, failure: BaseException | None) -> None:
    """Stop, then brakes on, whatever the stop does; an error on the way is added to the one that is under way."""
    stop = station.arm.quick_stop if isinstance(failure, DriveError | LimitExceeded) else run.stop_softly
    try:
        _attempt(stop, failure)
    finally:
        _attempt(station.arm.disable, failure)


def _attempt(action: Callable[[], None], failure: BaseException | None) -> None:
    try:
        action()
    except Exception as error:
        if failure is None:
            raise
        failure.add_note(f"while stopping: {error}")


def _keep_the_rest(station: Station, run: Run, failure: BaseException) -> None:
    """The arm stands: store what a broken visit has, tell why the run ended."""
    if run.broken is not None:
        try:
            station.store.add(run.plan.arm, run.broken)
        except GatewayError as error:
            failure.add_note(str(error))
    station.tell(Stopped(str(failure) or type(failure).__name__))
