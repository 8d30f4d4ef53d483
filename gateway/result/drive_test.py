"""Result of a drive test: timing figures of a drive with their intervals, and what is wrong with it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from drives.files import replace_file

FORMAT: Final = "servo-gateway drive-test"
VERSION: Final = 1


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
    figures: tuple[TimingFigure, ...]
    findings: tuple[str, ...]

    @property
    def failed(self) -> bool:
        """Return whether a finding exists."""
        return bool(self.findings)

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {"format": FORMAT, "version": VERSION} | asdict(self)

    def write(self, folder: Path) -> Path:
        """Write the report to its file in a folder; return the path."""
        path = folder / f"{self.axis}.json"
        replace_file(path, json.dumps(self.as_json(), indent=1) + "\n")
        return path
