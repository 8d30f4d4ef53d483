"""Result of a drive test: clauses of CiA 301 and CiA 402 with pass or fail, and timing figures with their intervals."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

from drives.files import replace_file

FORMAT: Final = "servo-gateway drive-test"
VERSION: Final = 1

Outcome = Literal["pass", "fail", "not tested"]


@dataclass(frozen=True, slots=True)
class ClauseResult:
    """Result of one conformance check.

    Attributes
    ----------
    clause : str
        Clause of the standard, for example `CiA 301 7.2.4 SDO`.
    check : str
        Name of the check, for programs.
    result : "pass", "fail" or "not tested"
    detail : str
        What was measured, or why the clause was not tested.
    """

    clause: str
    check: str
    result: Outcome
    detail: str


@dataclass(frozen=True, slots=True)
class TimingFigure:
    """One measured quantity of a drive.

    Attributes
    ----------
    name : str
    value : float or None
        None where it was not measured; `method` then states why.
    interval : (float, float) or None
        95 %: statistics of the samples, resolution of the time stamps and latency of the master.
    unit : str
    samples : int
    method : str
        What was done, and what limits the interval.
    """

    name: str
    value: float | None
    interval: tuple[float, float] | None
    unit: str
    samples: int
    method: str


@dataclass(frozen=True, slots=True)
class DriveTestReport:
    """Results of one drive; `identity` has plain values, None where the drive lacks an object."""

    axis: str
    node: int
    identity: Mapping[str, Any]
    clauses: tuple[ClauseResult, ...]
    figures: tuple[TimingFigure, ...]
    findings: tuple[str, ...]

    @property
    def failed(self) -> bool:
        """Return whether a clause failed or a finding exists."""
        return bool(self.findings) or any(clause.result == "fail" for clause in self.clauses)

    def count(self, result: Outcome) -> int:
        """Return the number of clauses with a result."""
        return sum(clause.result == result for clause in self.clauses)

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {"format": FORMAT, "version": VERSION} | asdict(self)

    def write(self, folder: Path) -> Path:
        """Write the report to its file in a folder; return the path."""
        path = folder / f"{self.axis}.json"
        replace_file(path, json.dumps(self.as_json(), indent=1) + "\n")
        return path
