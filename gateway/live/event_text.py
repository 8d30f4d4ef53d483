"""Events of a run as lines of the page: how grave, and what."""

from __future__ import annotations

from gateway.acquire.events import (
    Narrowed,
    PeriodDone,
    PoseDone,
    SampleRepeated,
    Started,
    VisitDone,
)
from gateway.live.wire import Heard
from gateway.report import notation

#: A line that is told in passing, one that calls for a look, and one that says why the arms stand.
PLAIN, WARN, FAIL = "plain", "warn", "fail"


def saying(event: object) -> tuple[str, str] | None:
    """How grave an event is, and its words; None for what the page shows otherwise: why arms were stopped is one."""
    if isinstance(event, Started):
        return PLAIN, f"{notation.load(event.load)}: {event.visits} to be measured" if event.visits else "on its way"
    if isinstance(event, SampleRepeated):
        axes = ", ".join(notation.axis(axis) for axis in event.axes)
        return WARN, f"SYNC {event.sync_index} was not answered by {axes}; sampled again"
    if isinstance(event, VisitDone):
        side = "from below" if event.direction > 0 else "from above"
        return PLAIN, f"pose {event.pose} measured {side}"
    if isinstance(event, PoseDone):
        return PLAIN, f"pose {event.pose} measured from both sides"
    return _of_motion(event)


def _of_motion(event: object) -> tuple[str, str] | None:
    if isinstance(event, PeriodDone):
        lost = event.incomplete_epochs
        what = f"'{event.name}', period {event.period}"
        return (WARN, f"{what}: {lost} SYNCs were not answered") if lost else (PLAIN, f"{what}: done")
    if isinstance(event, Narrowed):
        return PLAIN, f"{notation.load(event.load)}, {event.text}"
    if isinstance(event, Heard):
        return event.grave, event.text
    return None
