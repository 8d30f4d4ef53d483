"""Result of `follow`: following error of a path for each feedforward setting, and the data of its figures.

Lists per axis have one number per axis; NaN is null in the file and means unknown. The settings are `OFF`, `MAXIMUM`
and `IDENTIFIED`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gateway.result.names import SILENT
from gateway.result.origin import Origin
from gateway.result.result import Finding
from gateway.result.values import (
    Matrix,
    Number,
    Numbers,
    Vector,
    check_kind,
    check_lengths,
    decoded,
    json_object,
)

SCHEMA = 1
KIND = "follow"
OFF, MAXIMUM, IDENTIFIED = "off", "maximum", "identified"


@dataclass(frozen=True, slots=True)
class FollowedPath:
    """Path that was driven, and its file."""

    name: str
    file: str
    duration_s: float
    sync_period_s: float


@dataclass(frozen=True, slots=True)
class FedLoad:
    """Load of the feedforward torque: in `frame`, inertia (3, 3) about the centre of gravity."""

    label: str
    mass_kg: Number
    mass_std_kg: Number
    com_m: Vector
    frame: str
    inertia_kg_m2: Matrix
    source: str
    inertia_source: str


@dataclass(frozen=True, slots=True)
class FollowedSetting:
    """One pass of the path; `load` is None without feedforward.

    Per axis: peak and RMS following error, delay of the axis (NaN if not moved), and overshoot at rest points.
    """

    name: str
    load: FedLoad | None
    peak_rad: Numbers
    rms_rad: Numbers
    lag_s: Numbers
    overshoot_rad: Numbers


@dataclass(frozen=True, slots=True)
class PeakRatio:
    """Peak error with each feedforward setting over that without; of the identified load over the maximum load."""

    peak_over_off: Mapping[str, Numbers]
    peak_over_maximum: Numbers | None


@dataclass(frozen=True, slots=True)
class FedTrend:
    """Load estimated from the torque during the pass, relative to the feedforward load: mass = (1 + `scale`) ×
    entered.

    `mass_kg`, `com_m` in link_6: estimate with free first moment. `rms_nm`: remaining residual.
    """

    scale: Number
    scale_std: Number
    mass_kg: Number
    mass_std_kg: Number
    com_m: Vector
    com_std_m: Vector
    rms_nm: Numbers


@dataclass(frozen=True, slots=True)
class AxisSources:
    """Source of each term of an axis, as text; `missing` are the omitted terms.

    `notes`: identified quantities that are not used, or differ from the cell file.
    """

    gear_losses: str
    rotor_inertia: str
    coulomb: str
    viscous: str
    velocity_share: str
    missing: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=(), metadata=SILENT)


@dataclass(frozen=True, slots=True)
class FedModel:
    """Model of the feedforward torque: source of the link parameters, and the terms of each axis."""

    links: str
    axes: tuple[AxisSources, ...]


@dataclass(frozen=True, slots=True)
class ComputingTime:
    """Computing time of the torque and velocity offsets of all axes per SYNC [s]."""

    median: float
    p99: float
    largest: float
    count: int


@dataclass(frozen=True, slots=True)
class ErrorCurve:
    """Following error over time: `error_rad` (axes, n)."""

    time_s: Numbers
    error_rad: Matrix

    def __post_init__(self) -> None:
        """Check that the curves are as long as their times."""
        for curve in self.error_rad:
            check_lengths(time_s=self.time_s, error_rad=curve)


@dataclass(frozen=True, slots=True)
class TorqueCurve:
    """Motor torque of an axis (from 1) over time, measured and feedforward."""

    axis: int
    time_s: Numbers
    measured_nm: Numbers
    offset_nm: Numbers

    def __post_init__(self) -> None:
        """Check that the curves have equal lengths."""
        check_lengths(time_s=self.time_s, measured_nm=self.measured_nm, offset_nm=self.offset_nm)


@dataclass(frozen=True, slots=True)
class TrendCloud:
    """Torque residual of an axis (from 1) over its feedforward torque of the load."""

    axis: int
    load_nm: Numbers
    residual_nm: Numbers

    def __post_init__(self) -> None:
        """Check that the lists have equal lengths."""
        check_lengths(load_nm=self.load_nm, residual_nm=self.residual_nm)


@dataclass(frozen=True, slots=True)
class FollowSeries:
    """Data of the figures: errors by setting; torque and trend of the axes with the largest load torque."""

    error: Mapping[str, ErrorCurve]
    torque: tuple[TorqueCurve, ...] = ()
    trend: tuple[TrendCloud, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowResult:
    """Content of the file. `trend` is None if the path cannot determine it, `computing_s` without feedforward."""

    schema: int = SCHEMA
    kind: str = KIND
    robot: str
    cell: str
    arm: str
    path: FollowedPath
    settings: tuple[FollowedSetting, ...]
    ratio: PeakRatio
    trend: FedTrend | None
    model: FedModel
    computing_s: ComputingTime | None
    left_out_syncs: int
    findings: tuple[Finding, ...]
    origin: Origin | None = field(default=None, metadata=SILENT)
    series: FollowSeries = field(default_factory=lambda: FollowSeries({}))

    def setting(self, name: str) -> FollowedSetting | None:
        """Return the pass with a setting, None if it was not driven."""
        return next((setting for setting in self.settings if setting.name == name), None)


def follow_from_json(text: str, where: str) -> FollowResult:
    """Parse the text of a `follow --json` file.

    Raises
    ------
    InputError
        Not JSON, another schema, a key that is missing or of the wrong kind: named with its path.
    """
    data = json_object(text, where)
    check_kind(data, SCHEMA, where, KIND)
    return decoded(FollowResult, data, where)
