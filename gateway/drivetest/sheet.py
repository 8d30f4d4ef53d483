"""What was found about one drive while its test runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from drives.drive import Cia402Drive
from drives.errors import DriveError
from gateway.result.drive_test import ClauseResult, DriveTestReport, Outcome, TimingFigure


@dataclass(slots=True, eq=False)
class DriveSheet:
    """Results of one drive so far.

    Attributes
    ----------
    number : int
        Axis, from 0.
    drive : Cia402Drive
    clauses, figures, findings : lists
    broken : str
        Why the drive is not tested further; empty = it is.
    """

    number: int
    drive: Cia402Drive
    clauses: list[ClauseResult] = field(default_factory=list[ClauseResult])
    figures: list[TimingFigure] = field(default_factory=list[TimingFigure])
    findings: list[str] = field(default_factory=list[str])
    broken: str = ""

    @property
    def axis(self) -> str:
        """Name of the axis."""
        return f"J{self.number + 1}"

    def clause(self, clause: str, check: str, result: Outcome, detail: str) -> None:
        """Add the result of one check."""
        self.clauses.append(ClauseResult(clause, check, result, detail))

    def broke(self, error: DriveError, during: str) -> None:
        """Note a failure of the drive; the other drives are tested further."""
        self.broken = f"{during}: {error}"
        self.findings.append(self.broken)

    def figure(self, name: str) -> TimingFigure | None:
        """Return a figure that was measured; None = it was not."""
        return next((each for each in self.figures if each.name == name and each.value is not None), None)

    def report(self) -> DriveTestReport:
        """Return the report so far; a clause that failed is a finding."""
        identity = self.drive.identity
        found = {
            "vendor": None if identity is None else identity.vendor_id,
            "product": None if identity is None else identity.product_code,
            "revision": None if identity is None else identity.revision,
            "serial": None if identity is None else identity.serial_number,
            "firmware": None if identity is None else identity.software_version,
            "name": None if identity is None else identity.name,
        }
        failed = [f"{each.clause}: {each.detail}" for each in self.clauses if each.result == "fail"]
        return DriveTestReport(
            self.axis,
            self.drive.node_id,
            found,
            tuple(self.clauses),
            tuple(self.figures),
            (*failed, *(each for each in self.findings if each not in failed)),
        )


def usable(sheets: Sequence[DriveSheet]) -> list[DriveSheet]:
    """Return the sheets of the drives that are still tested."""
    return [sheet for sheet in sheets if not sheet.broken]
