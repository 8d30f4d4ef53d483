"""Run of a measurement with `--until` under power: pose by pose, until the search decides to end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gateway.acquire.events import Listener, Narrowed
from gateway.acquire.plan import SIDES
from gateway.acquire.run_loop import MotionSource
from gateway.acquire.session import RecordingSummary, record_motions
from gateway.acquire.until.messages import ended, narrowed
from gateway.acquire.until.search import LoadSearch, NextStep, decide
from gateway.data.recording.recorded import ArmRecording, Recording
from gateway.data.table import Table
from gateway.data.visit import Visit
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions

#: Conversion of visits to the samples that an estimation reads.
Rows = Callable[[Sequence[Visit]], Table]


def record_until(
    opened: OpenArm,
    search: LoadSearch,
    path: Path,
    earlier: Recording | None,
    listeners: Sequence[Listener] = (),
    options: MoveOptions | None = None,
) -> tuple[RecordingSummary, NextStep]:
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

    Returns
    -------
    RecordingSummary, NextStep
        What was added, and the last decision.

    Raises
    ------
    InputError, PlanRefused, DriveError, KeyboardInterrupt
        As `record_motions`.
    """
    decisions: list[NextStep] = []
    motions = chosen_poses(search, rows_of(opened, path), opened.arm.where(), decisions)
    summary = record_motions(opened, motions, search.label, path, earlier, listeners=listeners, options=options)
    return summary, decisions[-1]


def rows_of(opened: OpenArm, path: Path) -> Rows:
    """Return the function that converts visits of an open arm to samples, as when read from the file."""
    cell, name = opened.loaded.cell, opened.config.name

    def rows(visits: Sequence[Visit]) -> Table:
        arm = ArmRecording(name, (), tuple(visits), opened.constants, [], [], {})
        return Recording(path, "", "", "", "", cell, "", "", {}, (arm,)).table(name)

    return rows


def chosen_poses(search: LoadSearch, rows: Rows, at_rad: np.ndarray, decisions: list[NextStep]) -> MotionSource:
    """Yield the poses that the search decides on; the estimate is computed while the arm is at rest.

    Parameters
    ----------
    search : LoadSearch
    rows : Rows
    at_rad : array of shape (N,)
        Present posture.
    decisions : list of NextStep
        Every decision is added.
    """
    visits: list[Visit] = []
    decision = decide(search, None, at_rad)
    decisions.append(decision)
    while decision.plan is not None:
        further = len(SIDES) * max(decision.verdict.ahead - 1, 0)
        run = yield decision.plan, decision.expected_s, further
        visits += run.measured
        measured, at_rad = rows(visits), np.array(run.stream.q_rad[0])
        decision = run.stream.hold_while(lambda table=measured, at=at_rad: decide(search, table, at), "estimate")
        decisions.append(decision)
        run.notify(Narrowed(search.label, decision.verdict.poses, narrowed(decision)))
    return ended(decision, search.label)
