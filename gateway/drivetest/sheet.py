"""What was found about one drive while its test runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from drives.drive import Cia402Drive
from drives.errors import DriveError
from gateway.result.drive_test import DriveTestReport, TimingFigure


@dataclass(slots=True, eq=False)
class DriveSheet:
    """Results of one drive so far.

    Attributes
    ----------
    number : int
        Axis, from 0.
    drive : Cia402Drive
    figures, findings : lists
    broken : str
        Why the drive is not tested further; empty = it is.
    """

    number: int
    drive: Cia402Drive
    figures: list[TimingFigure] = field(default_factory=list[TimingFigure])
    findings: list[str] = field(default_factory=list[str])
    broken: str = ""

    @property
    def axis(self) -> str:
        """Name of the axis."""
        return f"J{self.number + 1}"

    def broke(self, error: DriveError, during: str) -> None:
        """Note a failure of the drive; the other drives are tested further."""
        self.broken = f"{during}: {error}"
        self.findings.append(self.broken)

    def figure(self, name: str) -> TimingFigure | None:
        """Return a figure that was measured; None = it was not."""
        return next((each for each in self.figures if each.name == name and each.value is not None), None)

    def report(self) -> DriveTestReport:
        """Return the report so far."""
        identity = self.drive.identity
        found = {
            "vendor": None if identity is None else identity.vendor_id,
            "product": None if identity is None else identity.product_code,
            "revision": None if identity is None else identity.revision,
            "serial": None if identity is None else identity.serial_number,
            "firmware": None if identity is None else identity.software_version,
            "name": None if identity is None else identity.name,
        }
        return DriveTestReport(self.axis, self.drive.node_id, found, tuple(self.figures), tuple(self.findings))


def usable(sheets: Sequence[DriveSheet]) -> list[DriveSheet]:
    """Return the sheets of the drives that are still tested."""
    return [sheet for sheet in sheets if not sheet.broken]
