"""Data of the report's figures and headings: object `data` of the result file.

Every key is optional; the page omits missing parts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway.result.names import SILENT
from gateway.result.numerals import TWO_SIDED_95
from gateway.result.origin import DriveOrigin
from gateway.result.values import NAN, Matrix, Number, Numbers, Vector, check_lengths, numbers

Floats = NDArray[np.float64]

#: Role of a visit that no fit has seen because it was measured afterwards.
FRESH = "fresh"


@dataclass(frozen=True, slots=True)
class DrawnSource:
    """Input file: kind, number of samples or visits, exit status of the recording, checksum."""

    file: str
    kind: str
    visits: int
    exit_status: str | None = field(default=None, metadata=SILENT)
    created: str | None = field(default=None, metadata=SILENT)
    sha256: str | None = field(default=None, metadata=SILENT)


@dataclass(frozen=True, slots=True)
class DrawnPose:
    """Arm posture in one pose: `points_m` from base to flange (k, 3) and the load's `com_m`, base frame [m].

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
    """One effect on `joint` over its independent variable: curve `x`, `y` with 95 % band, and measured points."""

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

    @classmethod
    def of(
        cls,
        name: str,
        axis: int,
        y_label: str,
        over: tuple[Floats, str, str],
        y: Floats,
        std: Floats,
        points: tuple[Floats, Floats],
    ) -> Curve:
        """Return the curve of an effect on an axis (from 0), sorted along its independent variable.

        Parameters
        ----------
        name : str
        axis : int
        y_label : str
        over : array of shape (n,), label and unit
            Independent variable.
        y, std : arrays of shape (n,)
            The effect and its standard deviation.
        points : two arrays of shape (m,)
            Measured points.
        """
        x, x_label, x_unit = over
        order = np.argsort(x, kind="stable")
        y, half = y[order], TWO_SIDED_95 * std[order]
        drawn = map(numbers, (x[order], y, y - half, y + half, *points))
        return cls(name, axis + 1, x_label, x_unit, y_label, *drawn)

    def __post_init__(self) -> None:
        """Check that the lists of a curve have equal lengths."""
        check_lengths(x=self.x, y=self.y, low=self.low, high=self.high)
        check_lengths(points_x=self.points_x, points_y=self.points_y)


@dataclass(frozen=True, slots=True)
class Spread:
    """Uncertainty of a load in the flange frame; `correlation` (4, 4) of [mass, x, y, z]."""

    com_std_m: Vector
    correlation: Matrix


@dataclass(frozen=True, slots=True)
class Drawn:
    """Data of all figures of a report.

    `model_before_nm` (n, axes): modelled torque before the effects were added. `band_model_nm` and
    `band_model_before_nm`: modelled half-difference of the two approach directions of a visit (measured: `band_nm` of
    the samples). `role`: "fit", "held out" or "fresh" per sample. `bus`: a line of counters per recorded arm.
    `drives`: drives that answered during the recording. `flange`: by label of the load; `flange_source`: origin of
    the flange frame of the cell file. `temperature_c` (axes, 2): lowest and highest temperature of motor or drive,
    NaN if unknown.
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
