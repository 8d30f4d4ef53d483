"""Files of a pair of arms: runs for the report, taught points, transform functions, output of `pair`.

NaN is null in the file and means unknown. Path positions `s_m` are measured along the path of the master's gripper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from gateway.result.names import SILENT
from gateway.result.values import NAN, Matrix, Number, Vector, check_lengths, three

SCHEMA = 1
#: Largest number that any run has, in whatever unit.
LARGEST = 1e9
#: Largest speed setting that a function may have been learned at.
FASTEST = 1e3
POINTS_KIND = "servo-gateway taught points"
POINT_UNITS = {"relation": "m", "correction_m": "m", "correction_rad": "rad", "servo_law_s": "s"}
FUNCTION_KIND = "servo-gateway transform function"
KNOT_UNITS = {"s_m": "m", "position_m": "m", "rotation": "1"}
FRAMES = {"from": "gripper of the master (E1)", "to": "gripper of the slave (E2)"}


def _plausible(value: float) -> float:
    if abs(value) > LARGEST:
        raise ValueError(f"{value:g} is not a finite number below {LARGEST:g}")
    return value


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("holds a character that cannot be printed")
    return text


def _said(text: str) -> str:
    if not text:
        raise ValueError("text is needed")
    return _printable(text)


def _pose(rows: Matrix) -> Matrix:
    if [len(row) for row in rows] != [4] * 4 or rows[3] != (0.0, 0.0, 0.0, 1.0):
        raise ValueError("4 x 4 numbers are needed, the last row 0 0 0 1")
    return rows


_Text = Annotated[str, AfterValidator(_printable)]
_Said = Annotated[str, AfterValidator(_said)]
_Value = Annotated[Number, AfterValidator(_plausible)]
_Known = Annotated[float, Field(allow_inf_nan=False), AfterValidator(_plausible)]
_Count = Annotated[int, Field(ge=0, le=LARGEST)]
_Speed = Annotated[float, Field(ge=0.0, le=FASTEST)]
_Knowns = tuple[_Known, ...]
_Place = Annotated[_Knowns, AfterValidator(three)]
_Pose = Annotated[tuple[_Knowns, ...], AfterValidator(_pose)]
#: The second function of the return path has its own file.
Stage = Literal["first", "second", "back"]
STAGES: tuple[Stage, ...] = ("first", "second", "back")


# -- runs --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CycleSummary:
    """One finished cycle.

    Attributes
    ----------
    cycle : number, from 1
    complete : every command was executed, with every SYNC answered
    learned : whether the second function was rebuilt from it
    reason : why not, or ""
    function : "first" or "second", what the slave followed
    knots : of that function
    force_n, moment_nm : largest internal force and moment as estimated, NaN where no force is measured
    at_command : index of the largest force, -1 = none
    correction_m, correction_rad : largest correction of the slave
    change_m, change_rad : how far the knots of the second function moved, NaN where it was not rebuilt
    gap_m : largest deviation of a distance from the demanded one, NaN where none is measured
    """

    cycle: _Count = 0
    complete: bool = True
    learned: bool = False
    reason: _Text = ""
    function: _Text = ""
    knots: _Count = 0
    force_n: _Value = NAN
    moment_nm: _Value = NAN
    at_command: int = -1
    correction_m: _Value = NAN
    correction_rad: _Value = NAN
    change_m: _Value = NAN
    change_rad: _Value = NAN
    gap_m: _Value = NAN


@dataclass(frozen=True, slots=True)
class Skew:
    """Delay of the slave's SYNC behind the master's [s]; `p99` and `max` of its absolute value."""

    median: float
    p99: float
    max: float


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """SYNCs, incomplete and delayed ones of the master's and the slave's bus; `skew_s` in real time only."""

    pacing: Literal["real", "lockstep"]
    cycles: tuple[int, int]
    incomplete: tuple[int, int]
    late: tuple[int, int]
    skew_s: Skew | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PairRunResult:
    """Cycles of one run of an embodiment.

    Attributes
    ----------
    name, text : embodiment, and the same in words
    speed : speed setting
    s_m, x_m : path position and position of the master's gripper in the world, per command
    first_n, last_n : force along the line between the grippers in the first and the last cycle
    first_size_n, last_size_n : size of the whole force, which the limit is on; absent in runs of before
    first_half_n, last_half_n : half the width of its 95 % interval
    first_m, last_m : in their place where a gap is kept: the distance that is furthest off, by how much
    knots_s_m : path positions of the function's knots
    learning_s, evaluation_s : longest learning step, mean evaluation of the controller
    """

    name: _Text
    text: _Text
    speed: _Known
    s_m: Annotated[_Knowns, Field(min_length=2)]
    x_m: _Knowns
    first_n: tuple[_Value, ...] = field(default=(), metadata=SILENT)
    last_n: tuple[_Value, ...] = field(default=(), metadata=SILENT)
    first_size_n: tuple[_Value, ...] = field(default=(), metadata=SILENT)
    last_size_n: tuple[_Value, ...] = field(default=(), metadata=SILENT)
    first_half_n: tuple[_Value, ...] = field(default=(), metadata=SILENT)
    last_half_n: tuple[_Value, ...] = field(default=(), metadata=SILENT)
    first_m: tuple[_Value, ...] = field(default=(), metadata=SILENT)
    last_m: tuple[_Value, ...] = field(default=(), metadata=SILENT)
    knots_s_m: _Knowns
    cycles: tuple[CycleSummary, ...]
    statistics: LinkStatistics | None = field(default=None, metadata=SILENT)
    learning_s: Number = NAN
    evaluation_s: Number = NAN

    def __post_init__(self) -> None:
        """Check that the run can be drawn."""
        if bool(self.last_n) == bool(self.last_m):
            raise ValueError("either last_n or last_m is needed")
        if len(self.x_m) != len(self.s_m):
            raise ValueError(f"x_m: {len(self.s_m)} numbers are needed as in s_m, got {len(self.x_m)}")
        check_lengths(s_m=self.s_m, first_n=self.first_n, last_n=self.last_n, first_m=self.first_m, last_m=self.last_m)
        check_lengths(s_m=self.s_m, first_size_n=self.first_size_n, last_size_n=self.last_size_n)


# -- taught points and functions ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TaughtPoint:
    """A taught point.

    Attributes
    ----------
    command : of the path, from 1
    s_m : path position
    relation : (4, 4), gripper 2 in gripper 1 by the adjusted commands
    correction_m, correction_rad : of the slave at this point, its base
    force_n, moment_nm : of every sweep, the last one below the set value
    """

    command: Annotated[int, Field(ge=1)]
    s_m: _Known
    relation: _Pose
    correction_m: _Place
    correction_rad: _Place
    force_n: _Knowns
    moment_nm: _Knowns


@dataclass(frozen=True, slots=True, kw_only=True)
class TaughtPathFile:
    """Points taught so far, for one path of one cell.

    Attributes
    ----------
    servo_law_s : T and tau of `e + tau e' = T u'`, by which each joint of both arms followed its setpoints, null =
        unknown; empty = not stated
    """

    kind: str = POINTS_KIND
    schema: int = SCHEMA
    path_hash: _Said
    cell_hash: _Said
    units: Mapping[str, str] = field(default_factory=lambda: POINT_UNITS)
    points: tuple[TaughtPoint, ...]
    servo_law_s: tuple[tuple[_Known, _Known] | None, ...] = ()


@dataclass(frozen=True, slots=True)
class FunctionKnot:
    """Knot of a transform function: relation of the grippers at a path position."""

    s_m: _Known
    position_m: Vector
    rotation: Matrix


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredFunction:
    """A transform function and its origin.

    Attributes
    ----------
    stage : "first" (taught) or "second" (learned)
    learn_source : "taught", "command", "measured" or "master_measured"
    speed : speed setting of the path it was learned at, 0 = at rest
    date : ISO 8601
    embodiment : name of the row it was learned with
    cycles : cycles it was learned from
    path_hash, cell_hash : what it is valid for (hexadecimal)
    """

    kind: str = FUNCTION_KIND
    schema: int = SCHEMA
    units: Mapping[str, str] = field(default_factory=lambda: KNOT_UNITS)
    frames: Mapping[str, str] = field(default_factory=lambda: FRAMES)
    interpolation: str = "straight line; turn about a fixed axis"
    stage: Stage
    learn_source: _Said
    speed: _Speed
    date: _Said
    embodiment: _Text = ""
    cycles: _Count = 0
    path_hash: _Said
    cell_hash: _Said
    knots: Annotated[tuple[FunctionKnot, ...], Field(min_length=1)]

    @property
    def origin(self) -> FunctionOrigin:
        """Return the summary of this function."""
        return FunctionOrigin(
            points=len(self.knots),
            learn_source=self.learn_source,
            speed=self.speed,
            date=self.date,
            embodiment=self.embodiment,
            cycles=self.cycles,
        )


@dataclass(frozen=True, slots=True)
class LearningSwitch:
    """State of learning: switched off or not."""

    frozen: bool = False


# -- output of the commands ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FunctionOrigin:
    """Summary of a stored function."""

    points: int
    learn_source: str
    speed: float
    date: str
    embodiment: str
    cycles: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnStatus:
    """Output of `learn --json`; None where no function of a stage is stored."""

    schema: int = SCHEMA
    learning: Literal["on", "off"]
    functions: Mapping[Stage, FunctionOrigin | None]
