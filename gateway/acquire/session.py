"""Operations for the command line: open an arm, plan, record under one load. The brakes are on between two
recordings.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from drives.exchange import Pacing
from gateway.acquire.blackbox import BlackBoxWatch, black_box
from gateway.acquire.events import Event, Listener, PeriodDone, PoseDone, VisitDone
from gateway.acquire.plan import Plan
from gateway.acquire.planning import make_plan, plan_of_poses
from gateway.acquire.run_loop import run_plan
from gateway.acquire.station import VisitStation
from gateway.cell.config import LoadedCell
from gateway.data.blackbox.part import BoxHeader
from gateway.data.period import Measured, Period
from gateway.data.recording.queue import VisitQueue
from gateway.data.recording.reader import read
from gateway.data.recording.recorded import Recording
from gateway.data.recording.writer import UNFINISHED, ArmHeader, RecordingHeader
from gateway.data.rest_pose import RestPose
from gateway.data.visit import Visit
from gateway.errors import GatewayError, InputError
from gateway.model.arm_model import arm_named, arm_robot
from gateway.motion.opening import BusOverride, OpenArm, open_arm
from gateway.motion.stream import MoveOptions
from gateway.motion.temperature import motor_temperatures
from gateway.motion.workspace import workspace_of
from gateway.result.origin import software

__all__ = [
    "BusOverride",
    "OpenArm",
    "RecordRequest",
    "RecordingSummary",
    "make_plan",
    "open_arm",
    "plan_of_recording",
    "record",
]


#: Polling interval while only the disk is awaited [s].
PAUSE_S = 0.001


@dataclass(frozen=True, slots=True)
class RecordRequest:
    """Measurement under one load.

    Attributes
    ----------
    load : str
        Label of the mounted load, `none` for the unloaded arm.
    path : Path
        The recording.
    resume : bool
        Continue an existing file: measure only what is missing under this load.
    again : bool
        Measure the poses of the plan again, even if the file already holds them under this load.
    """

    load: str
    path: Path
    resume: bool = False
    again: bool = False


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """Summary of what a run has added to a recording.

    Attributes
    ----------
    path : Path
    load : str
    visits : int
        New visits, one per approach direction of a pose.
    skipped : int
        Visits that the recording already held.
    incomplete_epochs : int
        SYNCs that were repeated while sampling.
    friction_band_nm : tuple of floats, one per axis
        Median half-difference over the poses; NaN if no pose was measured in both directions.
    statistics : dict
        Of the bus.
    """

    path: Path
    load: str
    visits: int
    skipped: int
    incomplete_epochs: int
    friction_band_nm: tuple[float, ...]
    statistics: dict[str, Any]


def plan_of_recording(loaded: LoadedCell, recording: Recording, arm: str | None = None) -> Plan:
    """Plan over the poses that a recording requests, to continue it.

    Raises
    ------
    PlanRefused
        The poses are no longer feasible.
    InputError
        The recording requests no poses of this arm.
    """
    config = arm_named(loaded, arm)
    stored = recording.arm(config.name)
    if stored is None or not stored.poses:
        raise InputError(f"{recording.path}: requests no poses of arm '{config.name}'")
    workspace = workspace_of(config, arm_robot(loaded, config))
    return plan_of_poses(loaded, config, workspace, stored.poses)


def record(
    opened: OpenArm,
    plan: Plan,
    request: RecordRequest,
    listeners: Sequence[Listener] = (),
    options: MoveOptions | None = None,
) -> RecordingSummary:
    """Measure a plan under one load; the brakes are on before and after. Without missing visits the arm does not move.

    If the operator requests a stop through the desk of `options`, the arm stops and the measured visits are kept.

    Raises
    ------
    InputError
        The file exists and `resume` is not set, or it belongs to another cell or other poses.
    PlanRefused, DriveError, KeyboardInterrupt
        As `run_plan`.
    """
    earlier = read(request.path) if request.resume and request.path.exists() else None
    stored = None if earlier is None else earlier.arm(plan.arm)
    wanted = {(pose.number, side) for pose in plan.poses for side in (-1, 1)}
    done = () if stored is None or request.again else tuple(wanted.intersection(stored.done(request.load)))
    with keeping(opened, request.path, earlier, plan.poses) as kept:
        if len(done) < len(wanted):
            run_plan(kept.station(listeners, options), plan, request.load, done)
    return kept.summary(request.load, len(done))


class Kept:
    """Recording that is being written, and what the run adds to it.

    Attributes
    ----------
    reason : str
        Reason of the end of a run without error.
    statistics : dict
        Bus statistics, once the run has ended without error.
    tally : Tally
    """

    def __init__(self, opened: OpenArm, queue: VisitQueue, watch: BlackBoxWatch) -> None:
        self.reason = "all poses measured"
        self._opened, self._queue, self._watch = opened, queue, watch
        self.tally = Tally(len(opened.config.axis))
        self.statistics: dict[str, Any] = {}

    def station(self, listeners: Sequence[Listener], options: MoveOptions | None) -> VisitStation:
        """Return the station of a run: the arm and the store for its visits."""
        opened, pacing = self._opened, self._opened.group.timing.pacing
        store = QueuedStore(self._queue, opened.config.name, pacing)
        listening = (self.tally, *listeners)
        options = options or MoveOptions()
        options.observers.add(self._watch)
        temperatures = motor_temperatures(opened)
        return VisitStation(opened.arm, opened.workspace, store, listening, options, pacing, temperatures)

    def summary(self, load: str, skipped: int) -> RecordingSummary:
        """Return the summary of what the run has added."""
        return RecordingSummary(
            path=self._queue.path,
            load=load,
            visits=self.tally.visits,
            skipped=skipped,
            incomplete_epochs=self.tally.incomplete_epochs,
            friction_band_nm=self.tally.band_nm(),
            statistics=self.statistics,
        )


@contextmanager
def keeping(
    opened: OpenArm,
    path: Path,
    earlier: Recording | None,
    poses: Sequence[RestPose] = (),
    excitations: dict[int, dict[str, Any]] | None = None,
) -> Generator[Kept]:
    """Open a recording for writing; on exit, also after an error, the measured data and the reason are on disk.

    Parameters
    ----------
    opened : OpenArm
    path : Path
    earlier : Recording or None
        Recording that is continued; its poses stay in the header.
    poses : sequence of RestPose
        Expected poses.
    excitations : dict, optional
        Expected excitations, keyed by fingerprint.

    Raises
    ------
    InputError
        The recording uses the number of a pose for another posture; or as `VisitQueue`.
    """
    config, statistics = opened.config, opened.group.statistics
    header = ArmHeader(
        name=config.name,
        poses=_all_poses(config.name, poses, earlier),
        constants=opened.constants,
        identities=[plain(asdict(identity)) for identity in opened.identities],
        ledger=[plain(asdict(entry)) for entry in opened.group.noted],
        excitations=excitations or {},
    )
    about = RecordingHeader(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        cell=opened.loaded.text,
        profiles={axis.profile: profile.text for axis, profile in zip(config.axis, opened.profiles, strict=True)},
        robot=opened.robot_text,
        software=software(),
        calibration=opened.loaded.calibration,
    )
    queue = VisitQueue(path, about, header, earlier)
    box = BoxHeader(path, ((config.name, len(config.axis)),), about.cell, about.created, about.software)
    try:
        with black_box(opened, box) as watch:
            kept = Kept(opened, queue, watch)
            yield kept
            kept.statistics = plain(asdict(statistics))
            queue.finish(config.name, "success", kept.reason, kept.statistics)
    except BaseException as error:
        if queue.visits:
            status = "abort" if isinstance(error, KeyboardInterrupt) else "fail"
            reason = str(error) or "stopped by the operator"
            try:
                queue.finish(config.name, status, reason, plain(asdict(statistics)))
            except GatewayError as failed:
                error.add_note(str(failed))
        raise
    finally:
        queue.close()


def _all_poses(arm: str, new: Sequence[RestPose], earlier: Recording | None) -> tuple[RestPose, ...]:
    """Return the poses of the file and the new ones, each number once.

    Raises
    ------
    InputError
        The file uses a number for another posture.
    """
    stored = None if earlier is None else earlier.arm(arm)
    poses = {pose.number: pose for pose in (() if stored is None else stored.poses)}
    for pose in new:
        known = poses.setdefault(pose.number, pose)
        if np.abs(np.array(known.q_rad) - np.array(pose.q_rad)).max() > 1e-6:
            raise InputError(
                f"{earlier.path if earlier else ''}: pose {pose.number} is another posture in this file; continue"
                " with the poses of the file, or give new poses new numbers"
            )
    return tuple(poses[number] for number in sorted(poses))


class QueuedStore:
    """Store that writes to a recording through a queue; in lockstep it waits for the disk."""

    def __init__(self, queue: VisitQueue, arm: str, pacing: Pacing) -> None:
        self._queue, self._arm, self._patient = queue, arm, pacing == "lockstep"
        self._seen: list[Visit | Period] = []

    def add(self, arm: str, visit: Measured) -> Measured:
        """Add a visit or period."""
        stored = self._queue.add(arm, visit)
        while self._patient and self._queue.waiting and self._queue.failed is None:
            time.sleep(PAUSE_S)
            self._seen += self._queue.written()
        return stored

    def written(self) -> Sequence[Visit | Period]:
        """Return the visits and periods that are on disk."""
        seen, self._seen = self._seen, []
        return (*seen, *self._queue.written())

    def trouble(self) -> GatewayError | None:
        """Return the reason if the disk cannot be written or is too slow."""
        if self._queue.failed is None and self._queue.full:
            return InputError(
                f"{self._queue.path}: {self._queue.waiting} visits wait for the disk, which is too slow; no visit is"
                " lost; free the disk or record to another disk, then continue with --resume"
            )
        return self._queue.failed

    def flush(self) -> None:
        """Block until everything is on disk."""
        if self._queue.visits:
            self._queue.finish(self._arm, "abort", UNFINISHED, {})


class Tally:
    """Number of stored visits and complete periods, their incomplete SYNCs, and the friction bands of the poses."""

    def __init__(self, axes: int) -> None:
        self.visits = self.periods = self.incomplete_epochs = 0
        self._axes = axes
        self._bands: list[tuple[float, ...]] = []

    def __call__(self, event: Event) -> None:
        """Count what an event reports."""
        if isinstance(event, VisitDone | PeriodDone):
            self.incomplete_epochs += event.incomplete_epochs
            self.visits += isinstance(event, VisitDone)
            self.periods += isinstance(event, PeriodDone) and event.complete
        elif isinstance(event, PoseDone):
            self._bands.append(event.friction_band_nm)

    def band_nm(self) -> tuple[float, ...]:
        """Return the median friction band of the poses; NaN without one."""
        return tuple(np.median(self._bands, axis=0).tolist()) if self._bands else (float("nan"),) * self._axes


def plain(value: Any) -> Any:
    """Return a value as types that JSON can hold."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
