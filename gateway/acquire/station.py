"""Station of a measurement run: arm, workspace, listeners, and the store for visits and periods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from drives.exchange import Pacing
from gateway.acquire.events import Event, Listener
from gateway.data.period import Measured, Period
from gateway.data.visit import Visit
from gateway.errors import GatewayError
from gateway.motion.arm import Arm
from gateway.motion.stops import guarded
from gateway.motion.stream import MoveOptions
from gateway.motion.temperature import MotorTemperatures
from gateway.motion.workspace import Workspace


class VisitStore(Protocol):
    """Store for visits and periods; only `flush` may block the motion loop."""

    def add(self, arm: str, visit: Measured) -> Measured:
        """Add a visit or period; return it with its number."""
        ...

    def written(self) -> Sequence[Visit | Period]:
        """Return what has been stored permanently since the last call."""
        ...

    def trouble(self) -> GatewayError | None:
        """Return the reason to stop measuring, such as a full or slow disk; None if all is well."""
        ...

    def flush(self) -> None:
        """Block until everything is stored permanently.

        Raises
        ------
        InputError
            The data cannot be stored.
        """
        ...


class MemoryStore:
    """Store that keeps visits and periods in memory."""

    def __init__(self) -> None:
        self.visits: list[Visit] = []
        self.periods: list[Period] = []
        self._untold: list[Visit | Period] = []

    def add(self, arm: str, visit: Measured) -> Measured:
        """Add a visit or period."""
        del arm
        kept = replace(visit, number=len(self.visits) + len(self.periods) + 1)
        if isinstance(kept, Period):
            self.periods.append(kept)
        else:
            self.visits.append(kept)
        self._untold.append(kept)
        return kept

    def written(self) -> Sequence[Visit | Period]:
        """Return what was added since the last call."""
        since, self._untold = self._untold, []
        return since

    def trouble(self) -> None:
        """Return None: memory is assumed to be sufficient."""

    def flush(self) -> None:
        """Return at once: memory needs no flush."""


@dataclass(frozen=True, slots=True, eq=False)
class VisitStation:
    """Arm, workspace, store and listeners of a run.

    Attributes
    ----------
    arm : Arm
        Connected and configured, not enabled.
    workspace : Workspace
    store : VisitStore
    listeners : tuple of Listener
        Called with every event, in the thread of the run.
    options : MoveOptions
    pacing : "lockstep" or "real"
    temperatures : MotorTemperatures or None
        Asked while the arm is sampled; None = no drive reports one.
    """

    arm: Arm
    workspace: Workspace
    store: VisitStore
    listeners: tuple[Listener, ...] = ()
    options: MoveOptions = field(default_factory=MoveOptions)
    pacing: Pacing = "lockstep"
    temperatures: MotorTemperatures | None = None

    def temperatures_c(self) -> np.ndarray | None:
        """Motor temperatures (N,) [deg C] read since the sampling began."""
        return None if self.temperatures is None else self.temperatures.read_c

    def notify(self, event: Event) -> None:
        """Send an event to all listeners and observers; an error of a listener requests a stop of the arm.

        All others are still notified.
        """
        for listener in self.listeners:
            guarded(listener, self.options.desk)(event)
        self.options.observers.reported(event)
