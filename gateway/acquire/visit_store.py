"""Store of a measurement run for visits and periods: in memory here, in a recording `VisitQueue`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from gateway.data.period import Measured, Period
from gateway.data.visit import Visit
from gateway.errors import GatewayError


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
