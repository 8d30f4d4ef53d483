"""The result file: what an estimation or a diagnosis hands over, as frozen values and as JSON.

What the data cannot give is never filled in: NaN, null in the file. Joints count from 1. Frame `link_6` is the frame of
the sixth link of the robot model: the last one, of an arm of six axes. Keys that a newer writer added are kept in
`Result.extra` and written back.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from gateway.errors import InputError
from gateway.result.drawn import Drawn
from gateway.result.finding import Finding
from gateway.result.names import SILENT
from gateway.result.seal import refuse_edited, sealed
from gateway.result.values import (
    NAN,
    Matrix,
    Number,
    Numbers,
    Vector,
    check_kind,
    check_lengths,
    decoded,
    json_object,
    plain_values,
    schema_of,
    text_of,
)

SCHEMA = 1
#: Where nothing is known of an arm of six axes.
UNKNOWN_SIX = (NAN,) * 6
UNKNOWN_THREE = (NAN,) * 3
Verdict = Literal["none_needed", "explained", "improved", "unexplained", "undecided"]
HoldoutKind = Literal["fresh", "given", "blocks"]
Outcome = Literal["pass", "fail", "cannot tell"]
#: Columns [m, hx, hy, hz] of each link.
PER_LINK = 4
#: Larger than any mass, place or variance of an arm; beyond it the arithmetic overflows.
LARGEST = 1e12


@dataclass(frozen=True, slots=True)
class LoadResult:
    """One load on the flange.

    `com_m`, `com_std_m` [m] in `frame`, that of the last link; `correlation` of [mass, x, y, z]; `per_pose_mass_kg`
    keyed by the pose number; `budget` the share of the mass's variance by source, `constants`, `links`, `friction` and
    `noise`, sum 1. `inertia_kg_m2` [Ixx, Iyy, Izz, Ixy, Ixz, Iyz] about the centre of gravity, axes of `frame`; null
    and named in `unidentifiable` where nothing moved; `inertia_flange_kg_m2` the same with the axes of the flange. A
    refused load keeps NaN everywhere and says why in `refused`.
    """

    label: str
    mass_kg: Number = NAN
    mass_std_kg: Number = NAN
    com_m: Vector | None = None
    com_std_m: Vector | None = None
    frame: str = "link_6"
    com_flange_m: Vector | None = field(default=None, metadata=SILENT)
    correlation: Matrix | None = field(default=None, metadata=SILENT)
    unidentifiable: tuple[str, ...] = ()
    per_pose_mass_kg: Mapping[str, Number] = field(default_factory=dict)
    budget: Mapping[str, Number] = field(default_factory=dict, metadata=SILENT)
    inertia_kg_m2: Numbers | None = field(default=None, metadata=SILENT)
    inertia_std_kg_m2: Numbers | None = field(default=None, metadata=SILENT)
    inertia_flange_kg_m2: Numbers | None = field(default=None, metadata=SILENT)
    refused: str | None = field(default=None, metadata=SILENT)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Why an effect is believed; `holdout_rms_ratio` = after / before on data that no fit has seen."""

    holdout_rms_ratio: Number = NAN
    p_value: Number = NAN
    runner_up: str | None = None
    odds: Number = NAN


@dataclass(frozen=True, slots=True)
class EffectResult:
    """An effect the model lacked: name, joints from 1 ([] for base and load), parameters with their std."""

    name: str
    joints: tuple[int, ...] = ()
    parameters: Mapping[str, Number] = field(default_factory=dict)
    std: Mapping[str, Number] = field(default_factory=dict)
    evidence: Evidence = Evidence()


@dataclass(frozen=True, slots=True)
class FitSummary:
    """Residual RMS per axis [Nm] of one model, in the fit and held out, with the loads that model gives."""

    rms_nm: Numbers = UNKNOWN_SIX
    holdout_rms_nm: Numbers = UNKNOWN_SIX
    loads: tuple[LoadResult, ...] = ()


@dataclass(frozen=True, slots=True)
class Rejected:
    """A candidate that did not earn its place."""

    name: str
    joints: tuple[int, ...] = ()
    holdout_rms_ratio: Number = NAN


@dataclass(frozen=True, slots=True)
class NuisanceResult:
    """What every arm has, one number an axis, with its standard deviation: `gain`, `bias_nm`, `load_friction`."""

    value: Numbers = ()
    std: Numbers = ()


@dataclass(frozen=True, slots=True)
class SetAside:
    """A visit or a period that was found gross on one axis, and is in no fit: by how many bands it lies off.

    `pose` at rest, `from_s` and `to_s` in motion; `joint` from 1; `reason` in words.
    """

    run: str
    load: str
    joint: int
    bands: Number
    pose: int | None = field(default=None, metadata=SILENT)
    from_s: Number = field(default=NAN, metadata=SILENT)
    to_s: Number = field(default=NAN, metadata=SILENT)
    reason: str = ""


@dataclass(frozen=True, slots=True)
class NextMeasurement:
    """What to measure next; `reduction` = expected std afterwards over std now, where that is the purpose."""

    what: str
    poses_rad: Matrix = ()
    tells_apart: tuple[str, ...] = ()
    reduction: Number = field(default=NAN, metadata=SILENT)


@dataclass(frozen=True, slots=True)
class Acceptance:
    """A load held against what it was said to be, or against the rating of the arm.

    `what` is `mass`, or `rated mass`, `rated reach`, `rated moment`; `value` in `unit` with `half_width`, that of its
    95 % interval. An expectation has `expected` and `tolerance`, a rating has `most`.
    """

    load: str
    what: str
    unit: str
    value: Number
    half_width: Number
    outcome: Outcome
    source: str
    expected: Number = field(default=NAN, metadata=SILENT)
    tolerance: Number = field(default=NAN, metadata=SILENT)
    most: Number = field(default=NAN, metadata=SILENT)


@dataclass(frozen=True, slots=True)
class Parameter:
    """An estimated quantity beside the loads: link parameters, friction, offsets."""

    name: str
    value: Number
    std: Number = NAN
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Rows:
    """What was measured and what the model says, a row per visit (or per instant): figures are drawn from this.

    `tau_nm`, `model_nm`, `band_nm`, `std_nm` (n, N) joint side [Nm]; `direction` (n, N) is 0 for a two-sided visit.
    """

    run: tuple[str, ...] = ()
    load: tuple[str, ...] = ()
    pose: tuple[int, ...] = ()
    time_s: Numbers = ()
    q_rad: Matrix = ()
    direction: tuple[tuple[int, ...], ...] = ()
    tau_nm: Matrix = ()
    model_nm: Matrix = ()
    band_nm: Matrix = ()
    std_nm: Matrix = ()

    def __post_init__(self) -> None:
        """Refuse tables that are not of one length and width."""
        check_lengths(**{item.name: getattr(self, item.name) for item in dataclasses.fields(self)})
        tables = (self.q_rad, self.direction, self.tau_nm, self.model_nm, self.band_nm, self.std_nm)
        if len({len(row) for table in tables for row in table}) > 1:
            raise ValueError("one number per axis is needed in every row of every table")


@dataclass(frozen=True, slots=True)
class Bare:
    """Base gravity parameters of the bare arm: what a later identification subtracts.

    `columns` are indices into the columns [m, hx, hy, hz] of links 1 to N; `value` [kg or kg m] belongs to them,
    `covariance` has the squared units; `combination` (rank, 4 N) says which link parameters each of them lumps.
    `offset_nm` is the torque of each axis that does not turn with gravity, NaN where it was not estimated. `gain` is
    that of the torque of each axis, NaN where not measured; `gain_covariance` belongs to `value`, `gain` and, in newer
    files, `offset_nm` together.
    """

    robot: str
    gravity_m_s2: Numbers
    columns: tuple[int, ...]
    names: tuple[str, ...]
    value: Numbers
    covariance: Matrix
    combination: Matrix
    offset_nm: Numbers = UNKNOWN_SIX
    gain: Numbers = field(default=(), metadata=SILENT)
    gain_covariance: Matrix = field(default=(), metadata=SILENT)


@dataclass(frozen=True, slots=True)
class AxisMotion:
    """What motion tells of one axis, at the gear output; NaN where it does not.

    Friction is (coulomb_nm + load_friction |tau| + (breakaway_nm - coulomb_nm) exp(-(qd / stribeck_rad_s)^2)) sign(qd)
    + viscous_nm_s_rad qd; `stribeck_rad_s` is NaN where no Stribeck curve shows, and that term is not there then.
    `load_friction` is that of the torque's mean size: it may grow with another power. `delay_s` is by how much the
    torque that is reported lags behind the position. `speed_rad_s` is the fastest that the axis was driven at.
    """

    joint: int
    coulomb_nm: Number = NAN
    coulomb_std_nm: Number = NAN
    viscous_nm_s_rad: Number = NAN
    viscous_std_nm_s_rad: Number = NAN
    breakaway_nm: Number = NAN
    breakaway_std_nm: Number = NAN
    stribeck_rad_s: Number = NAN
    load_friction: Number = NAN
    load_friction_std: Number = NAN
    rotor_inertia_kg_m2: Number = NAN
    rotor_inertia_std_kg_m2: Number = NAN
    delay_s: Number = NAN
    delay_std_s: Number = NAN
    speed_rad_s: Number = NAN


@dataclass(frozen=True, slots=True)
class Result:
    """The whole result file. `loads` is the final answer and equals `after.loads`.

    `sha256` is what the file said that this was read from; what is written carries its own.
    """

    robot: str
    loads: tuple[LoadResult, ...] = ()
    verdict: Verdict | None = None
    effects: tuple[EffectResult, ...] = ()
    before: FitSummary = FitSummary()
    after: FitSummary = FitSummary()
    holdout_kind: HoldoutKind | None = None
    noise_floor_nm: Numbers = UNKNOWN_SIX
    friction_band_nm: Numbers = UNKNOWN_SIX
    rejected: tuple[Rejected, ...] = ()
    next: tuple[NextMeasurement, ...] = ()
    findings: tuple[Finding, ...] = ()
    acceptance: tuple[Acceptance, ...] = field(default=(), metadata=SILENT)
    nuisance: Mapping[str, NuisanceResult] = field(default_factory=dict, metadata=SILENT)
    set_aside: tuple[SetAside, ...] = field(default=(), metadata=SILENT)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    method: str | None = field(default=None, metadata=SILENT)
    parameters: tuple[Parameter, ...] = ()
    quality: Mapping[str, Any] = field(default_factory=dict)
    rows: Rows | None = field(default=None, metadata=SILENT)
    bare: Bare | None = field(default=None, metadata=SILENT)
    motion: tuple[AxisMotion, ...] = field(default=(), metadata=SILENT)
    data: Drawn | None = field(default=None, metadata=SILENT)
    schema: int = SCHEMA
    sha256: str | None = field(default=None, metadata=SILENT)
    extra: Mapping[str, Any] = field(default_factory=dict, metadata=SILENT)

    @property
    def failed(self) -> bool:
        """Whether a failing finding stands."""
        return any(finding.severity == "fail" for finding in self.findings)


def to_dict(result: Result) -> dict[str, Any]:
    """Plain dictionaries, lists and numbers of a result, with their checksum; NaN and infinity become None."""
    plain = plain_values(result)
    extra = plain.pop("extra", {})
    plain = {"schema": plain.pop("schema")} | plain | {key: value for key, value in extra.items() if key not in plain}
    return sealed(plain)


def to_json(result: Result) -> str:
    """JSON text of a result, one value list per line where that is readable."""
    return json.dumps(to_dict(result), indent=1, allow_nan=False) + "\n"


def from_json(text: str, where: str = "result") -> Result:
    """Read a result file.

    Parameters
    ----------
    text : str
    where : str
        Name of the file, for messages.

    Raises
    ------
    InputError
        Not JSON, another schema, a key that is missing or of the wrong kind: named with its path.
    """
    return _from_object(json_object(text, where), where)


def _from_object(data: dict[str, Any], where: str) -> Result:
    check_kind(data, SCHEMA, None, where)
    known = {item.name for item in dataclasses.fields(Result)} - {"extra"}
    extra = {key: value for key, value in data.items() if key not in known}
    result = decoded(Result, {key: value for key, value in data.items() if key in known}, where)
    _check_loads(result, where)
    if result.bare is not None:
        _check_bare(result.bare, where)
    return dataclasses.replace(result, extra=extra)


def read_result(path: Path) -> Result:
    """A result from disk, as it was written.

    Raises
    ------
    InputError
        It cannot be read, as `from_json`, or it was edited since.
    """
    data = json_object(text_of(path, "name the JSON that `estimate --json` wrote"), str(path))
    result = _from_object(data, str(path))
    refuse_edited(data, str(path))
    return result


def json_schema() -> dict[str, Any]:
    """JSON schema of the result file."""
    schema = schema_of(Result)
    schema["properties"].pop("extra")
    return schema


def _check_loads(result: Result, where: str) -> None:
    for index, load in enumerate(result.loads):
        if any(abs(value) > LARGEST for value in (load.mass_kg, load.mass_std_kg, *(load.com_m or ()))):
            raise InputError(f"{where}: loads[{index}]: a mass or a place beyond {LARGEST:g}")
        if any(value < 0 for value in (load.mass_std_kg, *(load.com_std_m or ()))):
            raise InputError(f"{where}: loads[{index}]: a standard deviation below 0; write it again from the data")


def _check_bare(bare: Bare, where: str) -> None:
    rank, columns = len(bare.value), PER_LINK * len(bare.offset_nm)
    shapes = {"gravity_m_s2": (1, 3), "value": (1, rank), "covariance": (rank, rank), "combination": (rank, columns)}
    if bare.gain:
        axes = len(bare.offset_nm)
        both = rank + (2 if len(bare.gain_covariance) > rank + axes else 1) * axes
        shapes |= {"gain": (1, axes), "gain_covariance": (both, both)}
    for key, (height, width) in shapes.items():
        given = getattr(bare, key)
        rows = given if key.endswith("covariance") or key == "combination" else (given,)
        if len(rows) != height or any(len(row) != width for row in rows):
            raise InputError(f"{where}: bare.{key}: {height} x {width} numbers are needed")
        if any(abs(value) > LARGEST for row in rows for value in row):
            raise InputError(f"{where}: bare.{key}: a number beyond {LARGEST:g}")
