"""Files of a fleet analysis: one line per robot, and per robot its trends, loads and curves.

NaN is null in the file and means unknown. Times are UTC. Joints count from 1; joint 0 is the load.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

from drives.printable import one_line
from gateway.errors import InputError
from gateway.result.names import SILENT
from gateway.result.origin import read_sealed
from gateway.result.result import Outcome
from gateway.result.values import NAN, Number, Numbers, check_lengths, decoded

SCHEMA: Final = 1
FLEET_KIND: Final = "servo-gateway fleet"
ROBOT_KIND: Final = "servo-gateway fleet robot"
#: What writes an analysis again.
AGAIN: Final = "with servo-gateway fleet analyse STORE"


@dataclass(frozen=True, slots=True)
class Tracked:
    """A quantity that a check determines for every axis.

    Attributes
    ----------
    stem, suffix : the key is `stem + suffix`, its standard deviation `stem_std + suffix`
    words : name on a page
    unit : "" = a ratio
    relative : whether a drift is stated as a share of the level
    tolerance : yearly drift above which a service visit is recommended; NaN = never for this quantity
    """

    stem: str
    suffix: str
    words: str
    unit: str
    relative: bool
    tolerance: float

    @property
    def key(self) -> str:
        """Column name."""
        return self.stem + self.suffix

    @property
    def std_key(self) -> str:
        """Column name of its standard deviation."""
        return f"{self.stem}_std{self.suffix}"

    def flat(self, joint: int) -> tuple[str, str]:
        """Return the column names of one axis in a table of summaries: value and standard deviation."""
        return f"{self.stem}{joint}{self.suffix}", f"{self.stem}{joint}_std{self.suffix}"


#: A gain is measured over true torque, less 1: its drift is a share by itself.
GAIN: Final = Tracked("gain", "", "gain of the torque", "", relative=False, tolerance=0.02)
QUANTITIES: Final = (
    GAIN,
    Tracked("friction_band", "_nm", "friction band at rest", "Nm", relative=True, tolerance=0.3),
    Tracked("coulomb", "_nm", "Coulomb friction", "Nm", relative=True, tolerance=0.3),
    Tracked("viscous", "_nm_s_rad", "viscous friction", "Nm s/rad", relative=True, tolerance=0.3),
    Tracked("zero_offset", "_rad", "zero offset", "rad", relative=False, tolerance=0.001),
    Tracked("bias", "_nm", "bias by direction", "Nm", relative=False, tolerance=NAN),
)
MASS: Final = Tracked("mass", "_kg", "mass of the load", "kg", relative=True, tolerance=0.05)
State = Literal["visit", "not seen", "cannot tell", "healthy"]
#: In the order in which robots are visited.
STATES: Final[tuple[State, ...]] = ("visit", "not seen", "cannot tell", "healthy")


def quantity(key: str) -> Tracked:
    """Return the tracked quantity of a key.

    Raises
    ------
    KeyError
        The key is unknown.
    """
    return {each.key: each for each in (*QUANTITIES, MASS)}[key]


@dataclass(frozen=True, slots=True)
class FleetTrend:
    """Trend over the months of one quantity of one axis, or of the mass of one load.

    Attributes
    ----------
    quantity : key of a `Tracked`
    joint : from 1; 0 = the load
    program : label of the load, where it is one
    checks : number of checks in the trend
    level : at the mean temperature and load, when the first check was made
    drift_per_year, drift_std_per_year : in the quantity's unit
    sigmas : significance of the drift, signed: square root of twice the log-likelihood ratio with and without drift
    needed_sigmas : detection threshold of `sigmas`
    found_on : day on which the drift was first detected
    detectable_per_year : drift that would be detected today with a probability of 95 %
    per_k, per_kg : dependence on temperature and load, NaN where it did not vary
    """

    quantity: str
    joint: int
    program: str = ""
    checks: int = 0
    level: Number = NAN
    level_std: Number = NAN
    drift_per_year: Number = NAN
    drift_std_per_year: Number = NAN
    sigmas: Number = NAN
    needed_sigmas: Number = NAN
    found_on: str | None = field(default=None, metadata=SILENT)
    detectable_per_year: Number = NAN
    per_k: Number = NAN
    per_kg: Number = NAN

    @property
    def share_per_year(self) -> float:
        """Drift relative to the level; the drift itself where the quantity is a ratio."""
        return self.drift_per_year / self._scale

    @property
    def share_std_per_year(self) -> float:
        """Standard deviation of the relative drift."""
        return self.drift_std_per_year / self._scale

    @property
    def detectable_share(self) -> float:
        """Relative drift per year that would be detected today with a probability of 95 %."""
        return self.detectable_per_year / self._scale

    @property
    def _scale(self) -> float:
        return (abs(self.level) or NAN) if quantity(self.quantity).relative else 1.0


@dataclass(frozen=True, slots=True)
class ProgramLoad:
    """Load of one program: first and last identified mass, and whether it is still the verified load."""

    program: str
    checks: int
    first_kg: Number
    first_std_kg: Number
    last_kg: Number
    last_std_kg: Number
    last_seen: str
    outcome: Outcome
    why: str


@dataclass(frozen=True, slots=True)
class TrendCurve:
    """Data of a trend figure: days since the first check, values, and the fitted line with its 95 % band."""

    quantity: str
    joint: int
    program: str
    day: Numbers
    value: Numbers
    line_day: Numbers
    line: Numbers
    low: Numbers
    high: Numbers

    def __post_init__(self) -> None:
        """Check that the lists have equal lengths."""
        check_lengths(day=self.day, value=self.value)
        check_lengths(line_day=self.line_day, line=self.line, low=self.low, high=self.high)


@dataclass(frozen=True, slots=True)
class RobotLine:
    """A robot in the list of the fleet; `why` lists the reasons for its state, most urgent first.

    `gain_per_year`, `gain_std_per_year`: gain drift of axis `gain_joint`, the axis with the most significant drift.
    """

    robot: str
    cell: str
    arm: str
    state: State
    urgency: Number
    why: tuple[str, ...]
    checks: int
    first_seen: str
    last_seen: str
    serial_numbers: tuple[int | None, ...] = ()
    gain_joint: int = 0
    gain_per_year: Number = NAN
    gain_std_per_year: Number = NAN


@dataclass(frozen=True, slots=True)
class RobotHealth:
    """Analysis of one robot."""

    line: RobotLine
    as_of: str
    software: str
    trends: tuple[FleetTrend, ...] = ()
    loads: tuple[ProgramLoad, ...] = ()
    curves: tuple[TrendCurve, ...] = ()
    remarks: tuple[str, ...] = ()
    first_check: str = ""
    kind: str = ROBOT_KIND
    schema: int = SCHEMA
    sha256: str | None = field(default=None, metadata=SILENT)


@dataclass(frozen=True, slots=True)
class FleetHealth:
    """Analysis of all robots, the most urgent service visit first."""

    as_of: str
    software: str
    robots: tuple[RobotLine, ...]
    checks: int = 0
    estimated: int = 0
    failed: tuple[str, ...] = ()
    kind: str = FLEET_KIND
    schema: int = SCHEMA
    sha256: str | None = field(default=None, metadata=SILENT)

    def count(self, state: State) -> int:
        """Return the number of robots in a state."""
        return sum(line.state == state for line in self.robots)


def read_fleet(path: Path) -> FleetHealth:
    """Read the analysis of a fleet from disk.

    Raises
    ------
    InputError
        It cannot be read, is of another kind or schema, or was edited.
    """
    found = decoded(FleetHealth, read_sealed(path, SCHEMA, AGAIN, FLEET_KIND), str(path))
    for line in found.robots:
        if not re.fullmatch(r"[\w-]+", line.robot):
            raise InputError(f"{path}: '{one_line(line.robot)}' is not a name of a robot: write it {AGAIN}")
    return found


def read_robot(path: Path) -> RobotHealth:
    """Read the analysis of one robot from disk; errors as in `read_fleet`."""
    return decoded(RobotHealth, read_sealed(path, SCHEMA, AGAIN, ROBOT_KIND), str(path))
