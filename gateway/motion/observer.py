"""Observers of the motion loop: notified after every SYNC and of every event; they must not block.

The motion loop calls an observer from its own thread, after each SYNC. An observer stores the data and returns at once:
it does not wait, lock, write to a disk or use the bus. An observer that raises is removed and does not affect the
motion. To stop an arm, use a stop request (`gateway.motion.stops`) instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gateway.data.sample import ArmSample
from gateway.motion.arms import Arms
from gateway.motion.state import StateTracker
from gateway.motion.workspace import Workspace


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Data of one SYNC; each tuple has one member per arm.

    Attributes
    ----------
    samples : tuple of ArmSample
        Answers of the drives.
    targets_rad : tuple of arrays of shape (N,)
        Joint setpoints sent with this SYNC.
    modelled_nm : tuple of arrays of shape (N,)
        Modelled torque without friction at these setpoints; 0 where the links are unknown.
    """

    samples: tuple[ArmSample, ...]
    targets_rad: tuple[np.ndarray, ...]
    modelled_nm: tuple[np.ndarray, ...]


class Observer(Protocol):
    """Observer of the motion loop; its methods must return at once."""

    def began(self, arms: Arms, workspaces: tuple[Workspace, ...], period_s: float, state: StateTracker, /) -> None:
        """Called before the arms are powered, with a workspace per arm, the SYNC period and the state of the arms."""
        ...

    def sampled(self, observed: Observed, /) -> None:
        """Called after every answered SYNC, including the one that ends the motion, before anything is stopped."""
        ...

    def reported(self, event: object, /) -> None:
        """Called with an event of `gateway.acquire.events`, or a `MotionProgress`."""
        ...

    def ended(self, failure: BaseException | None, /) -> None:
        """Called when the brakes are on, or the stop is finished otherwise; `error` is None without an error."""
        ...


@dataclass(frozen=True, slots=True)
class MotionProgress:
    """Progress of a motion: its description, the present sample number and the number of samples."""

    what: str
    row: int
    rows: int


class Observers:
    """Observers of one command; one that raises is removed.

    Parameters
    ----------
    observers : Observer

    Attributes
    ----------
    troubles : list of Exception
        Exceptions of the removed observers.
    """

    def __init__(self, *observers: Observer) -> None:
        self.troubles: list[Exception] = []
        self._present = list(observers)

    def add(self, observer: Observer) -> None:
        """Add an observer from now on."""
        self._present.append(observer)

    def began(self, arms: Arms, workspaces: tuple[Workspace, ...], period_s: float, state: StateTracker) -> None:
        """Notify the observers that the arms will be powered."""
        self._each(lambda observer: observer.began(arms, workspaces, period_s, state))

    def sampled(
        self, samples: tuple[ArmSample, ...], targets_rad: tuple[np.ndarray, ...], modelled_nm: tuple[np.ndarray, ...]
    ) -> None:
        """Pass on the data of one SYNC."""
        if self._present:
            observed = Observed(samples, targets_rad, modelled_nm)
            self._each(lambda observer: observer.sampled(observed))

    def reported(self, event: object) -> None:
        """Pass on an event."""
        self._each(lambda observer: observer.reported(event))

    def ended(self, failure: BaseException | None) -> None:
        """Notify the observers that the arms are no longer under power."""
        self._each(lambda observer: observer.ended(failure))

    def _each(self, call: Callable[[Observer], None]) -> None:
        for observer in tuple(self._present):
            try:
                call(observer)
            except Exception as error:
                self._present.remove(observer)
                self.troubles.append(error)
