"""A recording with a progress bar: events of the run turned into what the terminal shows."""

from __future__ import annotations

from gateway.acquire.events import (
    Event,
    Narrowed,
    PeriodDone,
    PoseDone,
    Progress,
    SampleRepeated,
    Started,
    StateChanged,
    VisitDone,
)
from gateway.acquire.moving import MovingSummary, record_moving
from gateway.acquire.plan import Plan
from gateway.acquire.session import RecordingSummary, RecordRequest, record
from gateway.commands.console import Bar, Session
from gateway.excite.excitation import MovingPlan
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions


class ProgressListener:
    """Listens to a run and moves a bar.

    Parameters
    ----------
    session : Session
    bar : Bar
        Its length is the planned time of the arm, s.
    """

    def __init__(self, session: Session, bar: Bar) -> None:
        self._session, self._bar = session, bar
        self._visits = self._done = 0

    def __call__(self, event: Event) -> None:
        """Show one event."""
        if isinstance(event, Started):
            self._visits = event.visits
        elif isinstance(event, Progress):
            self._bar.set(event.elapsed_s, event.elapsed_s + event.remaining_s, event.what)
        elif isinstance(event, VisitDone):
            self._done += 1
            side = "from below" if event.direction > 0 else "from above"
            self._session.note(f"visit {self._done}/{self._visits}: pose {event.pose} {side}", level=1)
        elif isinstance(event, PoseDone):
            band = " ".join(f"{value:.2g}" for value in event.friction_band_nm)
            self._session.note(f"pose {event.pose}, load {event.load}: friction band {band} Nm", level=1)
        elif isinstance(event, SampleRepeated):
            axes = ", ".join(f"J{axis}" for axis in event.axes)
            self._session.note(f"SYNC {event.sync_index} was not answered by {axes}; sampled again")
        elif isinstance(event, Narrowed):
            self._session.note(f"load {event.load}, {event.text}")
        elif isinstance(event, PeriodDone):
            self._tell_period(event)
        elif isinstance(event, StateChanged):
            self._session.note(str(event.state), level=2)
        else:
            # what is raised says it too, last, where it is still on the screen
            self._session.note(f"stopped: {event.reason}", level=1)

    def _tell_period(self, event: PeriodDone) -> None:
        """A period that lacks a SYNC is always told of; only whole ones are counted."""
        speed = f" at {event.speed:.0%}" if event.speed != 1.0 else ""
        name, lost = f"'{event.name}' number {event.period}{speed}", event.incomplete_epochs
        if event.complete:
            self._done += 1
            self._session.note(f"period {self._done}/{self._visits}: {name}", level=1)
        elif lost:
            self._session.note(f"{name}: {lost} SYNCs were not answered")
        else:
            self._session.note(f"{name}: cut short", level=1)


def recording_with_progress(
    session: Session, opened: OpenArm, plan: Plan, request: RecordRequest, options: MoveOptions
) -> RecordingSummary:
    """Measure a plan under one load and show how far it is.

    Raises
    ------
    InputError, PlanRefused, DriveError, KeyboardInterrupt
        As `record`.
    """
    with session.progress(plan.duration_s / options.override, f"load {request.load}") as bar:
        return record(opened, plan, request, (ProgressListener(session, bar),), options)


def moving_with_progress(
    session: Session, opened: OpenArm, plan: MovingPlan, request: RecordRequest, how: tuple[MoveOptions, float]
) -> MovingSummary:
    """Drive a moving plan under one load and show how far it is; `how` is the options and the time it takes [s].

    Raises
    ------
    InputError, PlanRefused, DriveError, KeyboardInterrupt
        As `record_moving`.
    """
    options, duration_s = how
    with session.progress(duration_s, f"load {request.load}") as bar:
        return record_moving(opened, plan, request, (ProgressListener(session, bar),), options)
