"""Black box of a motion: record the last seconds of samples and CAN frames, and keep the file when the motion is
stopped.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from drives.errors import DriveError
from gateway.data.blackbox.part import FIELDS, BoxHeader
from gateway.data.blackbox.recorder import BoxRecorder
from gateway.data.blackbox.ring_buffer import box_of, place_in
from gateway.motion.arms import Arms
from gateway.motion.observer import Observed, Observer, Observers, fill
from gateway.motion.opening import OpenArm
from gateway.result.origin import software

KEPT: Final = tuple(name for name, _ in FIELDS)


class BlackBoxWatch(Observer):
    """Observer that passes all samples of one arm to a recorder; its owner closes the box after the frames of the stop.

    Parameters
    ----------
    recorder : BoxRecorder
    arm : str
        Arm whose samples are recorded; other arms may be powered too.

    Attributes
    ----------
    powered : bool
        True once the arms have been powered.
    """

    def __init__(self, recorder: BoxRecorder, arm: str) -> None:
        self.powered = False
        self._recorder: BoxRecorder | None = recorder
        self._arm, self._place = arm, -1

    def began(self, arms: Arms, _workspaces: object, _period_s: float, _state: object) -> None:
        """Note that arms are about to be powered."""
        self.powered = True
        names = [member.name for member in arms.members]
        self._place = names.index(self._arm) if self._arm in names else -1

    def sampled(self, observed: Observed) -> None:
        """Pass the sample of one SYNC to the recorder."""
        if self._recorder is None or self._place < 0:
            return
        sample = observed.samples[self._place]
        fill(self._recorder.row(sample.time_s, sample.sync_index), 0, observed, self._place, KEPT)

    def leave(self) -> None:
        """Stop recording."""
        self._recorder = None


@contextmanager
def black_box(opened: OpenArm, header: BoxHeader) -> Generator[BlackBoxWatch]:
    """Record the last seconds while this context is open; keep the file named in the header after an error.

    Errors of the black box become notes of the error that ended the run. They do not stop the arm.
    """
    recorder = BoxRecorder(opened.disk, header)
    watch, bus = BlackBoxWatch(recorder, opened.config.name), opened.group.bus
    bus.add_tap(recorder.frame)
    reason: str | None = None
    failure: BaseException | None = None
    try:
        yield watch
    except BaseException as error:
        failure = error
        if watch.powered or isinstance(error, DriveError):
            reason = str(error) or type(error).__name__
        raise
    finally:
        bus.remove_tap(recorder.frame)
        watch.leave()
        trouble = recorder.close(reason)
        if failure is not None and reason is not None:
            box = box_of(header.recording)
            failure.add_note(
                trouble
                or f"Recording of the last seconds before the stop: {box}; view it with servo-gateway report {box} -o"
                " STOP.html"
            )


@contextmanager
def last_seconds(opened: OpenArm, folder: Path, observers: Observers) -> Generator[None]:
    """Return the black box context for a motion without a recording; a folder keeps the newest boxes of each arm.

    Parameters
    ----------
    opened : OpenArm
    folder : Path
        Folder of the write ledgers (records of written drive objects).
    observers : Observers
        Observers of the motion loop.
    """
    kind = f"{opened.loaded.cell.name}-{opened.config.name}"
    place = place_in(folder, kind, datetime.now(UTC))
    arms = ((opened.config.name, len(opened.config.axis)),)
    created = datetime.now(UTC).isoformat(timespec="seconds")
    with black_box(opened, BoxHeader(place, arms, opened.loaded.text, created, software())) as watch:
        observers.add(watch)
        yield
