"""Result of a drive test: timing figures of a drive with their intervals, and what is wrong with it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
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
        Its last part is the unit of a time or angle.
    method : str
        What was done, and what limits the interval; why the quantity was not measured.
    value : float or None
        None where it was not measured.
    interval : (float, float) or None
        95 %: statistics of the samples, resolution of the time stamps and latency of the master.
    samples : int
    """

    name: str
    method: str
    value: float | None = None
    interval: tuple[float, float] | None = None
    samples: int = 0

    def as_json(self) -> dict[str, Any]:
        """Return the figure with its unit as plain values."""
        return asdict(self) | {"unit": "1" if "_pdo_" in self.name else self.name.rpartition("_")[2]}


@dataclass(slots=True, eq=False)
class DriveTestReport:
    """Results of one drive, filled while its test runs; `identity` has plain values, None where it lacks an object."""

    axis: str
    node: int
    identity: Mapping[str, Any]
    figures: list[TimingFigure] = field(default_factory=list[TimingFigure])
    findings: list[str] = field(default_factory=list[str])

    def figure(self, name: str) -> TimingFigure | None:
        """Return the figure of a name; None if the test has not reached it."""
        return next((figure for figure in self.figures if figure.name == name), None)

    def write(self, folder: Path) -> None:
        """Write the report to its file in a folder."""
        figures = [figure.as_json() for figure in self.figures]
        body = {"format": FORMAT, "version": VERSION} | asdict(self) | {"figures": figures}
        replace_file(folder / f"{self.axis}.json", json.dumps(body, indent=1) + "\n")
