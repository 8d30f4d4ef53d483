"""The result file: what an estimation or a diagnosis hands over, as frozen values and as JSON.

NaN stands for "unknown" inside and is written as null; what the data cannot give is never filled in. Joints count
from 1. Frame `link_6` is the frame of the sixth link of the robot model: the last one, of an arm of six axes. Keys that
a newer writer added are kept in `Result.extra` and written back.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, TypeAdapter, ValidationError, WithJsonSchema
from pydantic_core import ErrorDetails

from gateway.errors import InputError

SCHEMA = 1
NAN = math.nan
#: Where nothing is known of an arm of six axes.
UNKNOWN_SIX = (NAN,) * 6
UNKNOWN_THREE = (NAN,) * 3
Verdict = Literal["none_needed", "explained", "improved", "unexplained", "undecided"]
HoldoutKind = Literal["fresh", "given", "blocks"]
Severity = Literal["info", "warn", "fail"]
#: Columns [m, hx, hy, hz] of each link.
PER_LINK = 4
#: Larger than any mass, place or variance of an arm; beyond it the arithmetic overflows.
LARGEST = 1e12


def _nan_if_null(value: Any) -> Any:
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        return math.inf
    return NAN if value is None else value


def _not_infinite(value: float) -> float:
    if math.isinf(value):
        raise ValueError("a number that is too large to hold")
    return value


#: A number, or NaN = unknown, which is null in the file.
Number = Annotated[
    float, BeforeValidator(_nan_if_null), AfterValidator(_not_infinite), WithJsonSchema({"type": ["number", "null"]})
]
Numbers = tuple[Number, ...]
Matrix = tuple[Numbers, ...]


@dataclass(frozen=True, slots=True)
class LoadResult:
    """One load on the flange.

    `com_m`, `com_std_m` [m] in `frame`, that of the last link; `correlation` of [mass, x, y, z]; `per_pose_mass_kg`
    keyed by the pose number. A refused load keeps NaN everywhere and says why in `refused`.
    """

    label: str
    mass_kg: Number = NAN
    mass_std_kg: Number = NAN
    com_m: Numbers | None = None
    com_std_m: Numbers | None = None
    frame: str = "link_6"
    com_flange_m: Numbers | None = None
    correlation: Matrix | None = None
    unidentifiable: tuple[str, ...] = ()
    per_pose_mass_kg: Mapping[str, Number] = field(default_factory=dict)
    refused: str | None = None


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
class NextMeasurement:
    """What to measure next; `reduction` = expected std afterwards over std now, where that is the purpose."""

    what: str
    poses_rad: Matrix = ()
    tells_apart: tuple[str, ...] = ()
    reduction: Number = NAN


@dataclass(frozen=True, slots=True)
class Finding:
    """Something the reader has to know: severity `info`, `warn` or `fail`."""

    severity: Severity
    where: str
    what: str
    advice: str = ""


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


@dataclass(frozen=True, slots=True)
class Bare:
    """Base gravity parameters of the bare arm: what a later identification subtracts.

    `columns` are indices into the columns [m, hx, hy, hz] of links 1 to N; `value` [kg or kg m] belongs to them,
    `covariance` has the squared units; `combination` (rank, 4 N) says which link parameters each of them lumps.
    `offset_nm` is the torque of each axis that does not turn with gravity, NaN where it was not estimated.
    """

    robot: str
    gravity_m_s2: Numbers
    columns: tuple[int, ...]
    names: tuple[str, ...]
    value: Numbers
    covariance: Matrix
    combination: Matrix
    offset_nm: Numbers = UNKNOWN_SIX


@dataclass(frozen=True, slots=True)
class Result:
    """The whole result file. `loads` is the final answer and equals `after.loads`."""

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
    provenance: Mapping[str, Any] = field(default_factory=dict)
    method: str | None = None
    parameters: tuple[Parameter, ...] = ()
    quality: Mapping[str, Any] = field(default_factory=dict)
    rows: Rows | None = None
    bare: Bare | None = None
    schema: int = SCHEMA
    extra: Mapping[str, Any] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether a failing finding stands."""
        return any(finding.severity == "fail" for finding in self.findings)


# Keys that are left out where they say nothing, rather than written as null.
_OPTIONAL = {
    "LoadResult": {"com_flange_m", "refused", "correlation"},
    "NextMeasurement": {"reduction"},
    "Result": {"method", "rows", "bare", "extra"},
}
_ORDER_FIRST = ("schema",)


def to_dict(result: Result) -> dict[str, Any]:
    """Plain dictionaries, lists and numbers of a result; NaN and infinity become None."""
    plain = plain_values(result)
    extra = plain.pop("extra", {})
    first = {key: plain.pop(key) for key in _ORDER_FIRST}
    return first | plain | {key: value for key, value in extra.items() if key not in plain}


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
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{where}:{error.lineno}: not valid JSON: {error.msg}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: holds a number or a nesting that no result file has: {error}") from error
    if not isinstance(data, dict):
        raise InputError(f"{where}: a result file is one JSON object, this is {_kind_of(data)}")
    if data.get("schema") != SCHEMA:
        raise InputError(f"{where}: schema: this version reads schema {SCHEMA}, the file says {data.get('schema')!r}")
    known = {item.name for item in dataclasses.fields(Result)} - {"extra"}
    extra = {key: value for key, value in data.items() if key not in known}
    result = _decoded({key: value for key, value in data.items() if key in known}, where)
    _check_loads(result, where)
    if result.bare is not None:
        _check_bare(result.bare, where)
    return dataclasses.replace(result, extra=extra)


def json_schema() -> dict[str, Any]:
    """JSON schema of the result file."""
    schema = plain_values(TypeAdapter(Result).json_schema())
    schema["properties"].pop("extra")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _decoded(data: Mapping[str, Any], where: str) -> Result:
    try:
        return TypeAdapter(Result).validate_json(json.dumps(data), strict=True)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        raise InputError(f"{where}: {_path(problem['loc'])}{_in_words(problem)}") from error


def _path(place: tuple[int | str, ...]) -> str:
    """`loads[0].mass_kg: ` of a place in the file."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
    return f"{text}: " if text else ""


_EXPECTED = {
    "float_type": "a number or null",
    "string_type": "text",
    "int_type": "an integer",
    "tuple_type": "a list",
    "dict_type": "an object",
    "dataclass_type": "an object",
}


def _in_words(problem: ErrorDetails) -> str:
    kind, given = problem["type"], problem["input"]
    if kind == "missing":
        return "the key is missing"
    if kind == "literal_error":
        return f"{given!r} is not {problem['ctx']['expected'] if 'ctx' in problem else 'one of the words'}"
    if kind in _EXPECTED:
        return f"expected {_EXPECTED[kind]}, got {_kind_of(given)}"
    return problem["msg"].removeprefix("Value error, ")


def _kind_of(value: Any) -> str:
    """A value in words, for messages."""
    return "null" if value is None else f"{type(value).__name__} {value!r}"[:80]


def _check_loads(result: Result, where: str) -> None:
    for index, load in enumerate(result.loads):
        for key in ("com_m", "com_std_m"):
            value = getattr(load, key)
            if value is not None and len(value) != 3:
                raise InputError(f"{where}: loads[{index}].{key}: three numbers are needed, got {len(value)}")
        if any(abs(value) > LARGEST for value in (load.mass_kg, load.mass_std_kg, *(load.com_m or ()))):
            raise InputError(f"{where}: loads[{index}]: a mass or a place beyond {LARGEST:g}")


def _check_bare(bare: Bare, where: str) -> None:
    rank, columns = len(bare.value), PER_LINK * len(bare.offset_nm)
    shapes = {"gravity_m_s2": (1, 3), "value": (1, rank), "covariance": (rank, rank), "combination": (rank, columns)}
    for key, (height, width) in shapes.items():
        given = getattr(bare, key)
        rows = given if key in ("covariance", "combination") else (given,)
        if len(rows) != height or any(len(row) != width for row in rows):
            raise InputError(f"{where}: bare.{key}: {height} x {width} numbers are needed")
        if any(abs(value) > LARGEST for row in rows for value in row):
            raise InputError(f"{where}: bare.{key}: a number beyond {LARGEST:g}")


def plain_values(value: Any) -> Any:
    """The same in what JSON can hold: dataclasses as dictionaries, arrays as lists, NaN and infinity as None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        optional = _OPTIONAL.get(type(value).__name__, set())
        items = {item.name: plain_values(getattr(value, item.name)) for item in dataclasses.fields(value)}
        return {key: plain for key, plain in items.items() if plain is not None or key not in optional}
    if isinstance(value, Mapping):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain_values(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
