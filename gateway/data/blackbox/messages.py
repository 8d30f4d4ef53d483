"""What the motion loop and the process that keeps the black box say to each other, beside `BoxHeader` and parts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BoxVerdict:
    """Last message: why the run was stopped; None = it ended well, and nothing is kept."""

    reason: str | None


@dataclass(frozen=True, slots=True)
class BoxReady:
    """First answer: parts are kept from now on."""


@dataclass(frozen=True, slots=True)
class BoxEnd:
    """Answer to the verdict: what could not be written; empty = all is done."""

    failed: str
