"""Data of the report's figures and headings: the object `data` of the result file.

Every key may be absent; what is absent is left out of the page.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gateway.result.names import SILENT
from gateway.result.origin import DriveOrigin
from gateway.result.values import NAN, Matrix, Number, Numbers, Vector, check_lengths

#: Role of a visit that no fit has seen because it was measured afterwards.
FRESH = "fresh"


@dataclass(frozen=True, slots=True)
class DrawnSource:
    """A file that was read: `kind` in words, how many rows or visits it gave, how the recording ended, its checksum."""

    file: str
    kind: str
    visits: int
    exit_status: str | None = field(default=None, metadata=SILENT)
    created: str | None = field(default=None, metadata=SILENT)
    sha256: str | None = field(default=None, metadata=SILENT)


@dataclass(frozen=True, slots=True)
class DrawnPose:
    """The arm in one pose: `points_m` from base to flange (k, 3) and the load's `com_m`, base frame [m].

    `pose` is negative for an instant of a moving run; `role` is a value of `Drawn.role`.
    """

    pose: int
    load: str
    role: str = "fit"
    q_rad: Numbers = ()
    points_m: tuple[Vector, ...] = ()
    com_m: Vector | None = field(default=None, metadata=SILENT)
    time_s: Number = NAN


@dataclass(frozen=True, slots=True)
class Curve:
    """One effect on `joint` over what it depends on: the curve `x`, `y` with its 95 % band, and what was measured."""

    name: str
    joint: int | None = None
    x_label: str = ""
    x_unit: str = ""
    y_label: str = "torque [Nm]"
    x: Numbers = ()
    y: Numbers = ()
    low: Numbers = ()
    high: Numbers = ()
    points_x: Numbers = ()
    points_y: Numbers = ()

    def __post_init__(self) -> None:
        """Refuse a curve whose lists differ in length."""
        check_lengths(x=self.x, y=self.y, low=self.low, high=self.high)
        check_lengths(points_x=self.points_x, points_y=self.points_y)


@dataclass(frozen=True, slots=True)
class Spread:
    """Uncertainty of a load in the frame of the flange; `correlation` (4, 4) of [mass, x, y, z]."""

    com_std_m: Vector
    correlation: Matrix


@dataclass(frozen=True, slots=True)
class Drawn:
    """What is drawn.

    `model_before_nm` (n, axes): what the model said of each row before the effects were added; `band_model_nm` and
    `band_model_before_nm`: of half the difference of the two sides of a visit (`band_nm` of the rows is what was
    measured of it). `role` is one word per row: "fit", "held out" or "fresh". `bus`: a line of counters per recorded
    arm, named in words. `drives`: that answered when it was recorded. `flange`: by the label of the load;
    `flange_source`: where the cell file has the flange from.
    `temperature_c` (axes, 2): lowest and highest temperature of motor or drive while measuring, NaN where unknown.
    """

    created: str | None = field(default=None, metadata=SILENT)
    software: str | None = field(default=None, metadata=SILENT)
    cell: str | None = field(default=None, metadata=SILENT)
    arm: str | None = field(default=None, metadata=SILENT)
    operator: str | None = field(default=None, metadata=SILENT)
    flange_source: str | None = field(default=None, metadata=SILENT)
    drives: tuple[DriveOrigin, ...] = field(default=(), metadata=SILENT)
    sources: tuple[DrawnSource, ...] = ()
    role: tuple[str, ...] = ()
    poses: tuple[DrawnPose, ...] = ()
    flange: Mapping[str, Spread] = field(default_factory=dict)
    bus: tuple[Mapping[str, str | int | float | None], ...] = ()
    torque_limit_nm: Numbers = field(default=(), metadata=SILENT)
    temperature_c: Matrix = field(default=(), metadata=SILENT)
    model_before_nm: Matrix = field(default=(), metadata=SILENT)
    band_model_nm: Matrix = field(default=(), metadata=SILENT)
    band_model_before_nm: Matrix = field(default=(), metadata=SILENT)
    curves: tuple[Curve, ...] = field(default=(), metadata=SILENT)
