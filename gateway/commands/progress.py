"""Progress bar of a recording: turns events of the run into terminal output."""

from __future__ import annotations

from pathlib import Path

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
from gateway.acquire.plan import Plan
from gateway.acquire.session import RecordingSummary, RecordRequest, record
from gateway.acquire.until import LoadSearch, NextStep, record_until
from gateway.commands.console import Bar, Session
from gateway.data.recording.recorded import Recording
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions


class ProgressListener:
    """Observer of a run that updates a progress bar.

    Parameters
    ----------
    session : Session
    bar : Bar
        Length: planned duration of the motion [s].
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
            self._session.note(f"SYNC {event.sync_index} not answered by {axes}; sample repeated")
        elif isinstance(event, Narrowed):
            self._session.note(f"load {event.load}, {event.text}")
        elif isinstance(event, PeriodDone):
            self._report_period(event)
        elif isinstance(event, StateChanged):
            self._session.note(str(event.state), level=2)
        else:
            # the raised error repeats it at the end of the output
            self._session.note(f"stopped: {event.reason}", level=1)

    def _report_period(self, event: PeriodDone) -> None:
        """Report every period with a missing SYNC; only complete periods count."""
        speed = f" at {event.speed:.0%}" if event.speed != 1.0 else ""
        name, lost = f"'{event.name}' number {event.period}{speed}", event.incomplete_epochs
        if event.complete:
            self._done += 1
            self._session.note(f"period {self._done}/{self._visits}: {name}", level=1)
        elif lost:
            self._session.note(f"{name}: {lost} SYNCs not answered")
        else:
            self._session.note(f"{name}: cut short", level=1)


def recording_with_progress(
    session: Session, opened: OpenArm, plan: Plan, request: RecordRequest, options: MoveOptions
) -> RecordingSummary:
    """Measure a plan under one load and show the progress.

    Raises
    ------
    InputError, PlanRefused, DriveError, KeyboardInterrupt
        As `record`.
    """
    with session.progress(plan.duration_s / options.override, f"load {request.load}") as bar:
        return record(opened, plan, request, (ProgressListener(session, bar),), options)


def recording_until(
    session: Session,
    opened: OpenArm,
    search: LoadSearch,
    path: Path,
    earlier: Recording | None,
    options: MoveOptions,
) -> tuple[RecordingSummary, NextStep]:
    """Measure pose by pose until a load is known and show the progress; return as `record_until`.

    Raises
    ------
    InputError, PlanRefused, DriveError, KeyboardInterrupt
        As `record_until`.
    """
    with session.progress(1.0, f"load {search.label}") as bar:
        done = record_until(opened, search, path, earlier, (ProgressListener(session, bar),), options)
    session.show(done[0].reason)
    return done
