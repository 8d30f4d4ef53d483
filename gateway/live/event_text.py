"""Events of a run as lines of the page: severity and text."""

from __future__ import annotations

from gateway.acquire.events import Narrowed, PeriodDone, PoseDone, SampleRepeated, Started, VisitDone
from gateway.live.wire import Heard
from gateway.report import notation

#: Severity of a line: information, warning, reason of a stop.
PLAIN, WARN, FAIL = "plain", "warn", "fail"


def saying(event: object) -> tuple[str, str] | None:
    """Return severity and text of an event.

    None for events that the page shows elsewhere, such as the reason of a stop.
    """
    if isinstance(event, Started):
        return (
            PLAIN,
            f"{notation.load(event.load)}: {event.visits} to be measured"
            if event.visits
            else "during the transfer motion",
        )
    if isinstance(event, SampleRepeated):
        axes = ", ".join(notation.axis(axis) for axis in event.axes)
        return WARN, f"SYNC {event.sync_index} not answered by {axes}; sample repeated"
    if isinstance(event, VisitDone):
        side = "from below" if event.direction > 0 else "from above"
        return PLAIN, f"pose {event.pose} measured {side}"
    if isinstance(event, PoseDone):
        return PLAIN, f"pose {event.pose} measured from both directions"
    if isinstance(event, PeriodDone):
        lost = event.incomplete_epochs
        what = f"'{event.name}', period {event.period}"
        return (WARN, f"{what}: {lost} SYNCs not answered") if lost else (PLAIN, f"{what}: done")
    if isinstance(event, Narrowed):
        return PLAIN, f"{notation.load(event.load)}, {event.text}"
    if isinstance(event, Heard):
        return event.grave, event.text
    return None
