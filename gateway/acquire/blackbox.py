"""The black box of a run that is recorded: looks on, listens in, and is kept where the run is stopped."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

import numpy as np

from drives.errors import DriveError
from gateway.data.blackbox.keeper import BoxKeeper
from gateway.data.blackbox.part import BoxHeader
from gateway.data.blackbox.ring import box_of
from gateway.data.sample import ArmSample
from gateway.motion.observer import Observed, Scene
from gateway.motion.opening import OpenArm


class BlackBoxWatch:
    """An observer that hands all it sees to a keeper.

    Attributes
    ----------
    powered : bool
        Arms were about to be powered.
    """

    def __init__(self, keeper: BoxKeeper) -> None:
        self.powered = False
        self._keeper: BoxKeeper | None = keeper

    def began(self, scene: Scene) -> None:
        """Arms are about to be powered."""
        del scene
        self.powered = True

    def sampled(self, observed: Observed) -> None:
        """One SYNC."""
        if self._keeper is None:
            return
        first = observed.samples[0]
        row = self._keeper.row(first.time_s, first.sync_index)
        at = 0
        for sample, target, modelled in zip(observed.samples, observed.targets_rad, observed.modelled_nm, strict=True):
            at = _fill(row, at, sample, target, modelled)

    def told(self, event: object) -> None:
        """Nothing of it is kept."""

    def ended(self, failure: BaseException | None) -> None:
        """The frames of the stop still come: whoever keeps the recording closes the box."""

    def leave(self) -> None:
        """Take no more."""
        self._keeper = None


def _fill(row: np.ndarray, at: int, sample: ArmSample, target: np.ndarray, modelled: np.ndarray) -> int:
    """Fields of one arm, in the order of `part.FIELDS`; returns where the next arm's begin."""
    axes = len(target)
    for values in (sample.q_rad, target, sample.joint_torque_nm, modelled):
        row[at : at + axes] = values
        at += axes
    for axis, reading in enumerate(sample.readings):
        if reading is None:
            continue
        if reading.current_a is not None:
            row[at + axis] = reading.current_a
        row[at + axes + axis] = reading.statusword
        row[at + 2 * axes + axis] = reading.position_count
        row[at + 3 * axes + axis] = reading.torque_word
    return at + 4 * axes


@contextmanager
def black_box(opened: OpenArm, header: BoxHeader) -> Generator[BlackBoxWatch]:
    """While this is open the last seconds are kept; they stay beside the recording where it ends badly.

    What goes wrong with the box itself is among the notes of what ended the run, and ends nothing.
    """
    keeper = BoxKeeper(header)
    watch, bus = BlackBoxWatch(keeper), opened.group.bus
    keeper.wait_until_kept()
    bus.overhear(keeper.frame)
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
        bus.overhear_no_more(keeper.frame)
        watch.leave()
        trouble = keeper.close(reason)
        if failure is not None and reason is not None:
            box = box_of(header.recording)
            failure.add_note(trouble or f"The last seconds before it: {box}; servo-gateway report {box} -o STOP.html")
