"""Test of the drives of one arm, phase by phase; what was measured is written after each phase."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from gateway.check.brakes import AskSupport
from gateway.drivetest.frames import FrameRecord
from gateway.drivetest.judge import judge
from gateway.drivetest.powered import PoweredTests
from gateway.drivetest.sheet import DriveSheet
from gateway.drivetest.unpowered import run_unpowered
from gateway.motion.opening import OpenArm
from gateway.motion.stream import MoveOptions
from gateway.result.drive_test import DriveTestReport

#: Takes a remark about progress.
Say = Callable[[str], None]


class DriveTestRun:
    """Test of the drives of an opened arm.

    Parameters
    ----------
    opened : OpenArm
        Connected and configured, in its brakes.
    numbers : collection of int
        Axes to test, from 0.
    folder : Path
        Where the reports are written.
    say : callable
    """

    def __init__(self, opened: OpenArm, numbers: Collection[int], folder: Path, say: Say) -> None:
        self._opened, self._folder, self._say = opened, folder, say
        drives = opened.group.drives
        self._sheets = [DriveSheet(number, drives[number]) for number in sorted(numbers)]
        #: Why the test ended early, if no tested drive has failed.
        self.error: Exception | None = None

    @property
    def reports(self) -> tuple[DriveTestReport, ...]:
        """Reports of the drives so far."""
        return tuple(sheet.report() for sheet in self._sheets)

    def write(self) -> None:
        """Write one file per drive."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for report in self.reports:
            report.write(self._folder)

    def run(self, options: MoveOptions, proof: Path, ask: AskSupport) -> None:
        """Run every phase; a failure of one drive does not end the test of the others.

        Parameters
        ----------
        options, proof, ask
            As `PoweredTests`.
        """
        with FrameRecord(self._opened.group.bus) as record:
            self._say("SDO, SYNC and controlwords with the axes disabled")
            try:
                run_unpowered(self._opened, self._sheets, record)
            finally:
                self.write()
            powered = PoweredTests(self._opened, self._sheets, record, options, proof, ask)
            powered.run(self._say, self.write)
            self.error = powered.error
            judge(self._sheets, self._opened.group.timing.period_s)
            self.write()


def axes_named(names: Sequence[str], count: int) -> frozenset[int]:
    """Return the axes (from 0) of names such as `J2`; all of them without a name.

    Raises
    ------
    ValueError
        No axis has this name.
    """
    known = {f"J{number + 1}": number for number in range(count)}
    wrong = [name for name in names if name.upper() not in known]
    if wrong:
        raise ValueError(f"'{wrong[0]}' is not an axis of this arm: give one of {', '.join(known)}")
    return frozenset(known[name.upper()] for name in names) or frozenset(known.values())
