"""Result of `follow`: following error of a path under each setting, and the data of its figures.

Lists per axis have one number per axis; NaN, null in the file, is unknown. Settings are named `OFF`, `MAXIMUM` and
`IDENTIFIED`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

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
    text_of,
)

SCHEMA = 1
KIND = "follow"
OFF, MAXIMUM, IDENTIFIED = "off", "maximum", "identified"


@dataclass(frozen=True, slots=True)
class FollowedPath:
    """The path that was driven, and the file it came from."""

    name: str
    file: str
    duration_s: float
    sync_period_s: float


@dataclass(frozen=True, slots=True)
class FedLoad:
    """The load that the offsets were computed for: in `frame`, inertia (3, 3) about the centre of gravity."""

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
    """One pass: `load` is None without feedforward.

    Per axis: peak and RMS following error, the delay of the axis (NaN where it was not moved), and its overshoot at
    rest points.
    """

    name: str
    load: FedLoad | None
    peak_rad: Numbers
    rms_rad: Numbers
    lag_s: Numbers
    overshoot_rad: Numbers


@dataclass(frozen=True, slots=True)
class PeakRatio:
    """Peak error of each fed setting over that without feedforward; of the identified load over the maximum one."""

    peak_over_off: Mapping[str, Numbers]
    peak_over_maximum: Numbers | None


@dataclass(frozen=True, slots=True)
class FedTrend:
    """Load from the torque beside the load that was fed forward: its mass is (1 + `scale`) times the entered one.

    `mass_kg`, `com_m` in link_6: what the torque asks for with the first moment left free. `rms_nm`: what is left.
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
    """Where each term of an axis comes from, in words; `missing` are the terms that are left out.

    `notes`: what was identified and is not used, or differs from what the cell says.
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
    """What the offsets hold: where the links come from, and the terms of each axis."""

    links: str
    axes: tuple[AxisSources, ...]


@dataclass(frozen=True, slots=True)
class ComputingTime:
    """Time that both offsets of all axes took per SYNC [s]."""

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
        """Refuse curves that are not as long as their times."""
        for curve in self.error_rad:
            check_lengths(time_s=self.time_s, error_rad=curve)


@dataclass(frozen=True, slots=True)
class TorqueCurve:
    """Motor torque of an axis (from 1) over time, as measured and as fed."""

    axis: int
    time_s: Numbers
    measured_nm: Numbers
    offset_nm: Numbers

    def __post_init__(self) -> None:
        """Refuse curves of different length."""
        check_lengths(time_s=self.time_s, measured_nm=self.measured_nm, offset_nm=self.offset_nm)


@dataclass(frozen=True, slots=True)
class TrendCloud:
    """Torque residual of an axis (from 1) over the torque of the load as fed."""

    axis: int
    load_nm: Numbers
    residual_nm: Numbers

    def __post_init__(self) -> None:
        """Refuse lists of different length."""
        check_lengths(load_nm=self.load_nm, residual_nm=self.residual_nm)


@dataclass(frozen=True, slots=True)
class FollowSeries:
    """What is drawn: errors by setting; torque and trend of the axes on which the load weighs most."""

    error: Mapping[str, ErrorCurve]
    torque: tuple[TorqueCurve, ...] = ()
    trend: tuple[TrendCloud, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowResult:
    """The whole file. `trend` is None where the path tells too little, `computing_s` where nothing was fed."""

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
        """The pass under a setting, None where there was none."""
        return next((setting for setting in self.settings if setting.name == name), None)


def follow_from_json(text: str, where: str) -> FollowResult:
    """Read what `follow --json` wrote.

    Raises
    ------
    InputError
        Not JSON, another schema, a key that is missing or of the wrong kind: named with its path.
    """
    data = json_object(text, where)
    check_kind(data, SCHEMA, KIND, where)
    return decoded(FollowResult, data, where)


def read_follow(path: Path) -> FollowResult:
    """Read the file that `follow --json` wrote.

    Raises
    ------
    InputError
        It cannot be read, or as `follow_from_json`.
    """
    return follow_from_json(text_of(path, "name the JSON that `follow --json` wrote"), str(path))
