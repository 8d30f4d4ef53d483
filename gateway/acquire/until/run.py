"""Run of a measurement with `--until` under power: pose by pose, until the search decides to end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gateway.acquire.events import Listener, Narrowed
from gateway.acquire.plan import SIDES
from gateway.acquire.run_loop import MotionSource, run_motions
from gateway.acquire.session import RecordingSummary, keeping
from gateway.acquire.station import VisitStation, VisitStore
from gateway.acquire.until.messages import ended, narrowed
from gateway.acquire.until.search import LoadSearch, NextStep, decide
from gateway.data.recording.recorded import ArmRecording, Recording
from gateway.data.table import Table
from gateway.data.visit import Visit
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions

#: Conversion of visits to the samples that an estimation reads.
Rows = Callable[[Sequence[Visit]], Table]


@dataclass(frozen=True, slots=True, eq=False)
class UntilSummary:
    """Summary of what a run has added, and the reason of its end.

    Attributes
    ----------
    recording : RecordingSummary
    decision : NextStep
        The last decision.
    reason : str
        Reason of the end, for the operator.
    """

    recording: RecordingSummary
    decision: NextStep
    reason: str


class _Collected:
    """Store that passes visits on and remembers them."""

    def __init__(self, store: VisitStore) -> None:
        self._store = store
        self.visits: list[Visit] = []
        self.written, self.trouble, self.flush = store.written, store.trouble, store.flush

    def add(self, arm: str, visit: Visit) -> Visit:
        """Pass a visit on."""
        stored = self._store.add(arm, visit)
        self.visits.append(stored)
        return stored


def record_until(
    opened: OpenArm,
    search: LoadSearch,
    path: Path,
    earlier: Recording | None,
    listeners: Sequence[Listener] = (),
    options: MoveOptions | None = None,
) -> UntilSummary:
    """Measure a load pose by pose until its uncertainty is small enough or no pose helps; then apply the brakes.

    Parameters
    ----------
    opened : OpenArm
    search : LoadSearch
    path : Path
    earlier : Recording or None
        Existing content of the file, which is continued.
    listeners : sequence of Listener
    options : MoveOptions, optional

    Raises
    ------
    InputError, PlanRefused, DriveError, KeyboardInterrupt
        As `record`.
    """
    with keeping(opened, path, earlier) as kept:
        decision = run_until(kept.station(listeners, options), search, rows_of(opened, path))
        kept.reason = ended(decision, search.label)
    return UntilSummary(kept.summary(search.label, 0), decision, kept.reason)


def rows_of(opened: OpenArm, path: Path) -> Rows:
    """Return the function that converts visits of an open arm to samples, as when read from the file."""
    cell, name = opened.loaded.cell, opened.config.name

    def rows(visits: Sequence[Visit]) -> Table:
        arm = ArmRecording(name, (), tuple(visits), opened.constants, [], [], {})
        return Recording(path, "", "", "", "", cell, "", "", {}, (arm,)).table(name)

    return rows


def run_until(station: VisitStation, search: LoadSearch, rows: Rows) -> NextStep:
    """Drive the poses that the search decides; the estimate is computed while the arm is at rest.

    Raises
    ------
    PlanRefused, LimitExceeded, DriveError, InputError, KeyboardInterrupt
        As `run_motions`.
    """
    decision = decide(search, None, station.arm.where())
    if decision.plan is None:
        return decision
    collected = _Collected(station.store)
    station = replace(station, store=collected)

    def motions() -> MotionSource:
        nonlocal decision
        while decision.plan is not None:
            stream = yield decision.plan, decision.expected_s
            at_rad = np.array(stream.q_rad[0])
            measured = rows([visit for visit in collected.visits if visit.complete])
            decision = stream.hold_while(lambda table=measured, at=at_rad: decide(search, table, at), "estimate")
            station.notify(Narrowed(search.label, decision.verdict.poses, narrowed(decision)))

    run_motions(station, motions(), search.label, len(SIDES) * max(decision.verdict.ahead, 1))
    return decision
