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
from gateway.acquire.events import Event, Listener, PoseDone, VisitDone
from gateway.acquire.plan import Plan
from gateway.acquire.planning import make_plan, plan_of_poses
from gateway.acquire.powered_run import RunRequest, run_plan
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
    poses = _all_poses(plan, earlier)
    stored = None if earlier is None else earlier.arm(plan.arm)
    wanted = {(pose.number, side) for pose in plan.poses for side in (-1, 1)}
    done = () if stored is None or request.again else tuple(wanted.intersection(stored.done(request.load)))
    with keeping(opened, request.path, arm_header(opened, poses), earlier) as kept:
        if len(done) < len(wanted):
            run_plan(kept.station(listeners, options), RunRequest(plan, request.load, done))
    return kept.summary(request.load, len(done))


class Kept:
    """Recording that is being written, and what the run adds to it.

    Attributes
    ----------
    reason : str
        Reason of the end of a run without error.
    statistics : dict
        Bus statistics, once the run has ended without error.
    """

    def __init__(self, opened: OpenArm, queue: VisitQueue, watch: BlackBoxWatch) -> None:
        self.reason = "all poses measured"
        self._opened, self._queue, self._watch = opened, queue, watch
        self._tally = _Tally(len(opened.config.axis))
        self.statistics: dict[str, Any] = {}

    def station(self, listeners: Sequence[Listener], options: MoveOptions | None) -> VisitStation:
        """Return the station of a run: the arm and the store for its visits."""
        opened, pacing = self._opened, self._opened.group.timing.pacing
        store = QueuedStore(self._queue, opened.config.name, pacing)
        listening = (self._tally, *listeners)
        options = options or MoveOptions()
        options.observers.add(self._watch)
        temperatures = motor_temperatures(opened)
        return VisitStation(opened.arm, opened.workspace, store, listening, options, pacing, temperatures)

    def finish(self) -> None:
        """Store that the run has ended without error."""
        self.statistics = plain(asdict(self._opened.group.statistics))
        self._queue.finish(self._opened.config.name, "success", self.reason, self.statistics)

    def summary(self, load: str, skipped: int) -> RecordingSummary:
        """Return the summary of what the run has added."""
        return RecordingSummary(
            path=self._queue.path,
            load=load,
            visits=self._tally.visits,
            skipped=skipped,
            incomplete_epochs=self._tally.incomplete,
            friction_band_nm=self._tally.band_nm(),
            statistics=self.statistics,
        )


@contextmanager
def keeping(opened: OpenArm, path: Path, header: ArmHeader, earlier: Recording | None) -> Generator[Kept]:
    """Open a recording for writing; on exit, also after an error, the measured data and the reason are on disk.

    Parameters
    ----------
    opened : OpenArm
    path : Path
    header : ArmHeader
        Description of the arm for the recording, as far as known.
    earlier : Recording or None
        Recording that is continued.

    Raises
    ------
    InputError
        As `VisitQueue`.
    """
    about = _recording_header(opened)
    writer = VisitQueue(path, about, header, earlier)
    box = BoxHeader(path, ((header.name, len(opened.config.axis)),), about.cell, about.created, about.software)
    try:
        with black_box(opened, box) as watch:
            kept = Kept(opened, writer, watch)
            yield kept
            kept.finish()
    except BaseException as error:
        _finish_broken(writer, opened, opened.config.name, error)
        raise
    finally:
        writer.close()


def _finish_broken(writer: VisitQueue, opened: OpenArm, arm: str, error: BaseException) -> None:
    """Store the reason of an early end if anything was measured; an error of this becomes a note."""
    if not writer.visits:
        return
    status = "abort" if isinstance(error, KeyboardInterrupt) else "fail"
    reason = str(error) or "stopped by the operator"
    try:
        writer.finish(arm, status, reason, plain(asdict(opened.group.statistics)))
    except GatewayError as failed:
        error.add_note(str(failed))


def _all_poses(plan: Plan, earlier: Recording | None) -> tuple[RestPose, ...]:
    """Return the poses of the file and of the plan, each number once.

    Raises
    ------
    InputError
        The file uses a number for another posture.
    """
    stored = None if earlier is None else earlier.arm(plan.arm)
    poses = {pose.number: pose for pose in (() if stored is None else stored.poses)}
    for pose in plan.poses:
        known = poses.setdefault(pose.number, pose)
        if np.abs(np.array(known.q_rad) - np.array(pose.q_rad)).max() > 1e-6:
            raise InputError(
                f"{earlier.path if earlier else ''}: pose {pose.number} is another posture in this file; continue"
                " with the poses of the file, or give new poses new numbers"
            )
    return tuple(poses[number] for number in sorted(poses))


def _recording_header(opened: OpenArm) -> RecordingHeader:
    """Return the header of a recording: cell, drive profiles, robot and software."""
    return RecordingHeader(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        cell=opened.loaded.text,
        profiles={
            axis.profile: profile.text for axis, profile in zip(opened.config.axis, opened.profiles, strict=True)
        },
        robot=opened.robot_text,
        software=software(),
        calibration=opened.loaded.calibration,
    )


def arm_header(
    opened: OpenArm, poses: tuple[RestPose, ...], excitations: dict[int, dict[str, Any]] | None = None
) -> ArmHeader:
    """Return the header of an arm in a recording: expected content and drives."""
    return ArmHeader(
        name=opened.config.name,
        poses=poses,
        constants=opened.constants,
        identities=[plain(asdict(identity)) for identity in opened.identities],
        ledger=[plain(asdict(entry)) for entry in opened.group.noted],
        excitations=excitations or {},
    )


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


class _Tally:
    def __init__(self, axes: int) -> None:
        self.visits = self.incomplete = 0
        self._axes = axes
        self._bands: list[tuple[float, ...]] = []

    def __call__(self, event: Event) -> None:
        if isinstance(event, VisitDone):
            self.visits += 1
            self.incomplete += event.incomplete_epochs
        elif isinstance(event, PoseDone):
            self._bands.append(event.friction_band_nm)

    def band_nm(self) -> tuple[float, ...]:
        return tuple(np.median(self._bands, axis=0).tolist()) if self._bands else (float("nan"),) * self._axes


def plain(value: Any) -> Any:
    """Return a value as types that JSON can hold."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
