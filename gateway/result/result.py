"""Result file of an estimation or diagnosis: immutable values, read from and written as JSON.

A quantity that the data do not determine is NaN, null in the file. Joints count from 1. Frame `link_6` is the frame
of the last link of a six-axis robot model. Keys of newer versions are kept in `Result.extra` and written back.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from gateway.errors import InputError
from gateway.result.data_roles import Roles
from gateway.result.drawn import Drawn
from gateway.result.finding import Finding
from gateway.result.library import result_file
from gateway.result.names import SILENT
from gateway.result.origin import KEY, refuse_edited, sealed
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
    keyed by the pose number; `budget` is the share of the mass's variance by source, `constants`, `links`, `friction`
    and `noise`, sum 1. `common_errors` by kind of prior: change of mass [kg], x, y, z [m] (rows) per standard
    deviation of each error that all measurements of the arm share (columns).

    `inertia_kg_m2` [Ixx, Iyy, Izz, Ixy, Ixz, Iyz] about the centre of gravity, axes of `frame`; null and listed in
    `unidentifiable` without motion; `inertia_flange_kg_m2` has the axes of the flange. A refused load has NaN values
    and the reason in `refused`.
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
    common_errors: Mapping[str, Matrix] = field(default_factory=dict, metadata=SILENT)
    inertia_kg_m2: Numbers | None = None
    inertia_std_kg_m2: Numbers | None = None
    inertia_flange_kg_m2: Numbers | None = field(default=None, metadata=SILENT)
    refused: str | None = field(default=None, metadata=SILENT)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence for an effect; `holdout_rms_ratio` = residual after / before on data not used in the fit."""

    holdout_rms_ratio: Number = NAN
    p_value: Number = NAN
    runner_up: str | None = None
    odds: Number = NAN


@dataclass(frozen=True, slots=True)
class EffectResult:
    """Identified effect: name, joints from 1 ([] for base and load), parameters with standard deviations."""

    name: str
    joints: tuple[int, ...] = ()
    parameters: Mapping[str, Number] = field(default_factory=dict)
    std: Mapping[str, Number] = field(default_factory=dict)
    evidence: Evidence = Evidence()


@dataclass(frozen=True, slots=True)
class FitSummary:
    """Residual RMS per axis [Nm] of one model, in the fit and on held-out data, with the loads of that model."""

    rms_nm: Numbers = UNKNOWN_SIX
    holdout_rms_nm: Numbers = UNKNOWN_SIX
    loads: tuple[LoadResult, ...] = ()


@dataclass(frozen=True, slots=True)
class Rejected:
    """Candidate effect that did not improve the model sufficiently."""

    name: str
    joints: tuple[int, ...] = ()
    holdout_rms_ratio: Number = NAN


@dataclass(frozen=True, slots=True)
class FormulaPiece:
    """Product of a formula: expression in q1 .. qN [rad], `u` (modelled torque of the axis) and `friction` [Nm]."""

    expression: str
    coefficient: Number = NAN
    std: Number = NAN
    unit: str = "Nm"


@dataclass(frozen=True, slots=True)
class Formula:
    """Candidate formula for a torque that no effect of the library explains: what the modelled motor torque lacks.

    `joints` is [] for a force on the arm or a displacement of the load. `holdout_rms_ratio` and `p_value` are of poses
    that did not take part in its choice. `runner_up` are the products of the next best formula, `odds` those against
    it. `after` are residuals and loads with the formula in the model. `predicted_nm` is what the formula of the other
    poses predicts for each of their rows, `residual_nm` their residual without a formula.
    """

    joints: tuple[int, ...] = ()
    pieces: tuple[FormulaPiece, ...] = ()
    holdout_rms_ratio: Number = NAN
    p_value: Number = NAN
    runner_up: str | None = None
    odds: Number = NAN
    after: FitSummary = FitSummary()
    predicted_nm: Numbers = ()
    residual_nm: Numbers = ()


@dataclass(frozen=True, slots=True)
class Decided:
    """Effects between which the data could not decide before further poses were measured, and the number of these."""

    effects: tuple[EffectResult, ...] = ()
    poses: int = 0


@dataclass(frozen=True, slots=True)
class NuisanceResult:
    """Nuisance parameter, one number per axis with its standard deviation: `gain`, `bias_nm`, `load_friction`.

    `response` of the gain: part of a change of the axis's own torque constant by which its value moves, 0 to 1; 0 where
    the prior alone gives the value.
    """

    value: Numbers = ()
    std: Numbers = ()
    response: Numbers = field(default=(), metadata=SILENT)


@dataclass(frozen=True, slots=True)
class SetAside:
    """Sample rejected as an outlier on one axis, with its deviation in friction bands.

    `pose` at rest, `from_s` and `to_s` in motion; `joint` from 1; `reason` as text.
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
    """Next measurement; `reduction` = expected standard deviation after it over the present one, if that is its
    purpose.
    """

    what: str
    poses_rad: Matrix = ()
    tells_apart: tuple[str, ...] = ()
    reduction: Number = field(default=NAN, metadata=SILENT)


@dataclass(frozen=True, slots=True)
class Acceptance:
    """Comparison of a load with its expected mass, or with the rating of the arm.

    `what` is `mass`, or `rated mass`, `rated reach`, `rated moment`; `value` in `unit` with `half_width` of its 95 %
    interval. An expectation has `expected` and `tolerance`, a rating has `most`.
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
    """Estimated quantity other than a load: link parameters, friction, offsets."""

    name: str
    value: Number
    std: Number = NAN
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Rows:
    """Measured and modelled torques, one row per visit or instant: data of the figures.

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

    @classmethod
    def of(cls, **columns: NDArray[Any]) -> Rows:
        """Build the rows from an array for every field: shape (n,), or (n, N) for a table by axis."""
        plain: dict[str, Any] = {
            name: tuple(map(tuple, values.tolist())) if values.ndim > 1 else tuple(values.tolist())
            for name, values in columns.items()
        }
        return cls(**plain)

    def __post_init__(self) -> None:
        """Check that the tables have equal shapes."""
        check_lengths(**{item.name: getattr(self, item.name) for item in dataclasses.fields(self)})
        tables = (self.q_rad, self.direction, self.tau_nm, self.model_nm, self.band_nm, self.std_nm)
        if len({len(row) for table in tables for row in table}) > 1:
            raise ValueError("one number per axis is needed in every row of every table")


@dataclass(frozen=True, slots=True)
class Bare:
    """Base gravity parameters of the unloaded arm, subtracted by a later load identification.

    `columns` are indices into the columns [m, hx, hy, hz] of links 1 to N; `value` [kg or kg m] belongs to them,
    `covariance` has the squared units. `combination` (rank, 4 N) gives the link parameters in each base parameter.

    `offset_nm` is the torque of each axis that does not depend on gravity, NaN if not estimated. `gain` is the torque
    gain of each axis, NaN if not measured. `gain_covariance` is of `value`, `gain` and, in newer files, `offset_nm`
    together.
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
    """Parameters of one axis identified from motion, at the gear output; NaN if not determined.

    Friction is (coulomb_nm + load_friction |tau| + (breakaway_nm - coulomb_nm) exp(-(qd / stribeck_rad_s)^2))
    sign(qd) + viscous_nm_s_rad qd. Without an identifiable Stribeck curve, `stribeck_rad_s` is NaN and that term is
    absent. `load_friction` holds at the mean torque; it may increase with another power. `delay_s` is the delay of
    the reported torque behind the position, `speed_rad_s` the highest speed driven.
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
    """Content of the result file. `loads` is the final answer and equals `after.loads`.

    `sha256` is the checksum of the file that was read; a written file gets its own. `data_roles` are the measured data
    by role, as in `gateway.result.data_roles`.
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
    formula: Formula | None = field(default=None, metadata=SILENT)
    decided: Decided | None = field(default=None, metadata=SILENT)
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
    data_roles: Roles = field(default_factory=dict, metadata=SILENT)
    schema: int = SCHEMA
    sha256: str | None = field(default=None, metadata=SILENT)
    extra: Mapping[str, Any] = field(default_factory=dict, metadata=SILENT)

    @property
    def failed(self) -> bool:
        """Return whether the result has a failing finding."""
        return any(finding.severity == "fail" for finding in self.findings)


def to_dict(result: Result) -> dict[str, Any]:
    """Return a result as plain dictionaries, lists and numbers, with checksum; NaN and infinity become None."""
    plain = plain_values(result)
    extra = plain.pop("extra", {})
    plain = {"schema": plain.pop("schema")} | plain | {key: value for key, value in extra.items() if key not in plain}
    return sealed(plain)


def to_json(result: Result) -> str:
    """Return the JSON text of a result, one list of values per line where readable."""
    return json.dumps(to_dict(result), indent=1, allow_nan=False) + "\n"


def from_json(text: str, where: str = "result") -> Result:
    """Parse the JSON text of a result file.

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
    check_kind(data, SCHEMA, where)
    known = {item.name for item in dataclasses.fields(Result)} - {"extra"}
    extra = {key: value for key, value in data.items() if key not in known}
    result = decoded(Result, {key: value for key, value in data.items() if key in known}, where)
    for index, load in enumerate(result.loads):
        if any(abs(value) > LARGEST for value in (load.mass_kg, load.mass_std_kg, *(load.com_m or ()))):
            raise InputError(f"{where}: loads[{index}]: a mass or a place beyond {LARGEST:g}")
        if any(value < 0 for value in (load.mass_std_kg, *(load.com_std_m or ()))):
            raise InputError(f"{where}: loads[{index}]: a standard deviation below 0; write it again from the data")
        if any([len(row) for row in rows] != [len(rows[0])] * 4 for rows in load.common_errors.values() if rows):
            raise InputError(f"{where}: loads[{index}].common_errors: four rows of one length are needed")
    if result.bare is not None:
        _check_bare(result.bare, where)
    return dataclasses.replace(result, extra=extra)


def read_result(path: Path) -> Result:
    """Read a result file, or the result of one load of a library (`result_file`); check that it was not edited.

    A result that was written by hand has no checksum (`Result.sha256`).

    Raises
    ------
    InputError
        It cannot be read, as `from_json`, or it was edited since.
    """
    path, label = result_file(path)
    data = json_object(text_of(path, "name the JSON that `estimate --json` wrote"), str(path))
    result = _from_object(data, str(path))
    if KEY in data:
        refuse_edited(data, str(path))
    if label is None:
        return result
    return dataclasses.replace(result, loads=tuple(load for load in result.loads if load.label == label))


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of the result file."""
    schema = schema_of(Result)
    schema["properties"].pop("extra")
    return schema


def _check_bare(bare: Bare, where: str) -> None:
    rank, columns = len(bare.value), PER_LINK * len(bare.offset_nm)
    shapes = {"gravity_m_s2": (1, 3), "value": (1, rank), "covariance": (rank, rank), "combination": (rank, columns)}
    if bare.gain:
        axes = len(bare.offset_nm)
        both = rank + (2 if len(bare.gain_covariance) > rank + axes else 1) * axes
        shapes |= {"gain": (1, axes), "gain_covariance": (both, both)}
    for key, (height, width) in shapes.items():
        stated = getattr(bare, key)
        rows = stated if key.endswith("covariance") or key == "combination" else (stated,)
        if len(rows) != height or any(len(row) != width for row in rows):
            raise InputError(f"{where}: bare.{key}: {height} x {width} numbers are needed")
        if any(abs(value) > LARGEST for row in rows for value in row):
            raise InputError(f"{where}: bare.{key}: a number beyond {LARGEST:g}")
