"""Messages between the motion loop and the process that stores the black box, besides `BoxHeader` and parts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BoxVerdict:
    """Last message to the process: reason of the stop; None = normal end, the stored data are deleted."""

    reason: str | None


@dataclass(frozen=True, slots=True)
class BoxReady:
    """First answer of the process: it stores parts from now on."""


@dataclass(frozen=True, slots=True)
class BoxEnd:
    """Answer to the verdict: write error; empty if all was written."""

    failed: str
