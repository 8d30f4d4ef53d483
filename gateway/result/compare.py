"""Compare two results of one robot, before and after service: changed, unchanged, or undecided.

Every quantity that both results hold is compared with the uncertainty of both. With d the difference, s its standard
deviation and h = z s, where z keeps the chance of one false alarm among all quantities at 5 % (Bonferroni):

    changed       |d| - h > tolerance
    unchanged     |d| + h <= tolerance
    cannot tell   anything else

Without a stated tolerance, `changed` is any significant difference (tolerance 0), and `unchanged` is measured against
the resolution that service needs (`RESOLUTION`). Both results share errors of link masses and torque constants, which
each result states for its loads: with their effects c1 and c2, `s^2 = s1^2 + s2^2 - 2 c1 c2`.

Friction scatters from start to start by `START_SCATTER`, and one result is of one start alone.

The prior of a torque constant is not changed by a service. Its value follows a true change only in part (`response`
of the gain), so the limits are multiplied by that part. A constant whose standard deviation is above 0.9 of the prior's
is not measured: cannot tell.

`differences` compares a stored result file with one recomputed from the same data (`replay`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import NormalDist
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from gateway.errors import InputError
from gateway.result.data_roles import shared_rows
from gateway.result.result import EffectResult, LoadResult, Result
from gateway.result.values import plain_values

Floats = NDArray[np.float64]

OPTION: Final = "--tolerance"
Outcome = Literal["changed", "unchanged", "cannot tell"]
CHANGED: Final = "changed"
UNCHANGED: Final = "unchanged"
CANNOT_TELL: Final = "cannot tell"
#: Chance that all quantities together raise a false alarm where nothing changed.
FALSE_ALARM: Final = 0.05
#: Standard deviation of a median of n over that of one value, times sqrt(n).
_OF_A_MEDIAN: Final = 1.2533
#: Resolution that service needs: a larger half width leaves "unchanged" undecided. Shares, except `com` in m.
RESOLUTION: Final = {"mass": 0.1, "com": 0.02, "constant": 0.1, "friction": 0.5}
#: Relative standard deviation of friction from one start of the arm to the next.
START_SCATTER: Final = 0.1
#: Least part of a true change that a measured value follows: its standard deviation is 0.9 of the prior's.
LEAST_RESPONSE: Final = 1.0 - 0.9**2
#: Key of a tolerance -> unit -> factor; a share where the factor is that of %.
UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "mass": {"%": 0.01, "kg": 1.0, "g": 0.001},
    "com": {"mm": 0.001, "m": 1.0},
    "constant": {"%": 0.01},
    "friction": {"%": 0.01, "Nm": 1.0},
}
EXAMPLE: Final = "such as mass=2%,com=5mm,constant=3%,friction=20%"
#: Numbers that differ by no more, relative to the larger of 1 and the number, are equal: rounding of another computer.
TOLERANCE: Final = 1e-9
#: What is of the moment or of the program that computed it, not of the measurement.
_OF_THE_MOMENT: Final = frozenset({"sha256", "truth", "data.created", "data.software"})
#: Findings on a calibration speak of its age today.
_OF_TODAY: Final = "calibration"


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Allowed change of a quantity: absolute in its unit, or relative to the value before."""

    value: float
    is_share: bool

    def of(self, before: float) -> float:
        """Return the tolerance in the unit of the quantity."""
        return self.value * abs(before) if self.is_share else self.value


@dataclass(frozen=True, slots=True)
class ComparedQuantity:
    """One quantity of both results.

    Attributes
    ----------
    where, what, unit : str
        `load tool`, `mass`, `kg`; `J2`, `torque constant`, `Nm/A`.
    before, before_std, after, after_std : float
        Values and standard deviations; NaN = not stated.
    half_width : float
        Of the interval of the difference, at the level of all quantities together; NaN = not measured.
    tolerance : float
        Allowed change, in the unit; 0 where none was stated.
    outcome : "changed", "unchanged" or "cannot tell"
    """

    where: str
    what: str
    unit: str
    before: float
    before_std: float
    after: float
    after_std: float
    half_width: float
    tolerance: float
    outcome: Outcome

    @property
    def difference(self) -> float:
        """Value after minus value before."""
        return self.after - self.before


@dataclass(frozen=True, slots=True)
class ResultComparison:
    """Compared quantities, verdict, and remarks on quantities that only one result contains."""

    robot: str
    before: str
    after: str
    created: tuple[str | None, str | None]
    quantities: tuple[ComparedQuantity, ...]
    verdict: Outcome
    remarks: tuple[str, ...]
    shared: Mapping[str, Any]

    def as_json(self) -> dict[str, Any]:
        """Return plain values; NaN becomes None."""
        rows = [asdict(each) | {"difference": each.difference} for each in self.quantities]
        about = {"robot": self.robot, "before": self.before, "after": self.after, "created": list(self.created)}
        reported = {"verdict": self.verdict, "quantities": rows, "remarks": list(self.remarks), "shared": self.shared}
        return {"schema": 1, "kind": "comparison", **about, **plain_values(reported)}


def parse_tolerance(text: str) -> dict[str, Tolerance]:
    """Parse `mass=2%,com=5mm,...`; a bare `5%` applies to all quantities that allow a relative tolerance.

    Raises
    ------
    InputError
        Another key, no unit, or a number below 0.
    """
    found: dict[str, Tolerance] = {}
    for part in text.split(","):
        key, equals, value = (word.strip() for word in part.rpartition("="))
        keys = (key,) if equals else tuple(name for name, units in UNITS.items() if "%" in units)
        for name in keys:
            units = UNITS.get(name, {})
            unit = max((each for each in units if value.endswith(each)), key=len, default="")
            try:
                number = float(value.removesuffix(unit)) * units[unit]
            except (KeyError, ValueError):
                number = math.nan
            if not number >= 0:
                raise InputError(f"{OPTION} {text}: '{part.strip()}' is not a tolerance with its unit; write {EXAMPLE}")
            found[name] = Tolerance(number, unit == "%")
    return found


def compare(
    before: Result, after: Result, names: tuple[str, str], tolerance: Mapping[str, Tolerance]
) -> ResultComparison:
    """Compare two results of one robot.

    Parameters
    ----------
    before, after : Result
    names : tuple of 2 str
        Their files, for messages.
    tolerance : mapping
        As `parse_tolerance`.

    Raises
    ------
    InputError
        They are of different robots, cells, arms or frames, or hold nothing that can be compared.
    """
    refuse_other_arms(before, after, names)
    one, other = _quantities(before), _quantities(after)
    shared = [key for key in one if key in other]
    if not shared:
        raise InputError(f"{names[0]} and {names[1]} hold no quantity in common: {_held(one)}; {_held(other)}")
    same = before.sha256 is not None and before.sha256 == after.sha256
    judged = sum(math.isfinite(one[key].std) and math.isfinite(other[key].std) for key in shared)
    factor = 0.0 if same else NormalDist().inv_cdf(1.0 - FALSE_ALARM / 2.0 / max(judged, 1))
    rows = tuple(_compared(key, one[key], other[key], factor, tolerance) for key in shared)
    created = tuple(None if each.data is None else each.data.created for each in (before, after))
    remarks = [
        f"{where} {what}: only in {name}"
        for have, lack, name in ((one, other, names[0]), (other, one, names[1]))
        for where, what in have
        if (where, what) not in lack
    ]
    stated = [" ".join(key) for key in shared if not _response(one[key], other[key]) >= LEAST_RESPONSE]
    if stated:
        remarks.append(f"{', '.join(stated)}: not measured, the value is that of its prior; a change is not visible")
    if same:
        remarks.append("both files are the same result")
    shared = shared_rows(before.data_roles, after.data_roles)
    if shared["all"]:
        remarks.append("both results are of the same data: what differs is the evaluation, not the arm or the load")
    elif both := {**shared["visits"], **shared["moving_samples"]}:
        counts = ", ".join(f"{count} under load {label}" for label, count in both.items())
        remarks.append(f"{names[0]} and {names[1]} share measured data ({counts}); a shared unloaded arm is usual")
    if None not in created and str(created[0]) > str(created[1]):
        remarks.append(f"{names[0]} is newer than {names[1]}: check the order of the two files")
    return ResultComparison(
        before.robot, *names, (created[0], created[1]), rows, _verdict(rows), tuple(remarks), shared
    )


@dataclass(frozen=True, slots=True)
class _Quantity:
    value: float
    std: float
    unit: str
    kind: str
    response: float = 1.0
    load: LoadResult | None = None
    part: int = 0


def refuse_other_arms(before: Result, after: Result, names: tuple[str, str]) -> None:
    """Refuse results of different robots, cells or arms."""
    pairs = [("robot", before.robot, after.robot)]
    if before.data is not None and after.data is not None:
        pairs += [("cell", before.data.cell, after.data.cell), ("arm", before.data.arm, after.data.arm)]
    for what, one, other in pairs:
        if None not in (one, other) and one != other:
            raise InputError(
                f"{names[0]} is of {what} '{one}', {names[1]} of {what} '{other}': only results of one arm are compared"
            )


def _held(quantities: Mapping[tuple[str, str], _Quantity]) -> str:
    return ", ".join(f"{where} {what}" for where, what in quantities) or "nothing"


def _quantities(result: Result) -> dict[tuple[str, str], _Quantity]:
    """Return the quantities of a result that have a value, by place and name."""
    found = dict(_loads(result.loads)) | dict(_constants(result)) | dict(_friction(result))
    return {key: each for key, each in found.items() if math.isfinite(each.value)}


def _loads(loads: Sequence[LoadResult]) -> Iterator[tuple[tuple[str, str], _Quantity]]:
    for load in loads:
        where = f"load {load.label}"
        yield (where, "mass"), _Quantity(load.mass_kg, load.mass_std_kg, "kg", "mass", load=load)
        stds = load.com_std_m or (math.nan,) * 3
        for part, (axis, value, std) in enumerate(zip("xyz", load.com_m or (), stds, strict=False), 1):
            yield (where, f"centre {axis} in {load.frame}"), _Quantity(value, std, "m", "com", load=load, part=part)


def shared_errors(loads: Sequence[LoadResult], part: int) -> Floats | None:
    """Return the errors (n, m) of one quantity that all loads state under one name; None if one states none."""
    if not all(load.common_errors for load in loads):
        return None
    tables = [{kind: np.asarray(rows) for kind, rows in load.common_errors.items()} for load in loads]
    same = [kind for kind in tables[0] if len({table[kind].shape if kind in table else () for table in tables}) == 1]
    return np.array([np.concatenate([table[kind][part] for kind in same]) for table in tables])


def _constants(result: Result) -> Iterator[tuple[tuple[str, str], _Quantity]]:
    """Return the true torque constants: stated constant times identified scale, over the gain 1 + g of the readings."""
    gain = result.nuisance.get("gain")
    for joint in range(1, len(result.noise_floor_nm) + 1):
        found = _scale(result.effects, joint)
        if found is None and (gain is None or joint > len(gain.value)):
            continue
        scale, scale_std = found or (1.0, 0.0)
        error, error_std, response = (0.0, 0.0, 1.0)
        if gain is not None and joint <= len(gain.value) and math.isfinite(gain.value[joint - 1]):
            error, error_std = gain.value[joint - 1], gain.std[joint - 1]
            response = gain.response[joint - 1] if joint <= len(gain.response) else math.nan
        elif found is None:
            continue
        entry = result.provenance.get(f"J{joint}", {})
        stated = entry.get("torque_constant") if isinstance(entry, Mapping) else None
        used = isinstance(stated, Mapping) and "not used" not in str(stated.get("source"))
        constant, unit = (float(stated["value"]), "Nm/A") if used and stated else (1.0, "of stated")
        value = constant * scale / (1.0 + error)
        share = math.hypot(scale_std / scale, error_std / (1.0 + error))
        yield (f"J{joint}", "torque constant"), _Quantity(value, abs(value) * share, unit, "constant", response)


def _scale(effects: Sequence[EffectResult], joint: int) -> tuple[float, float] | None:
    """Return the identified scale of a torque constant with its standard deviation: of the joint, else the common
    one.
    """
    for joints in ((joint,), ()):
        for effect in effects:
            scale = effect.parameters.get("scale")
            if effect.name == "torque_constant_scale" and tuple(effect.joints) == joints and isinstance(scale, float):
                std = effect.std.get("scale")
                return scale, std if isinstance(std, float) else math.nan
    return None


def _friction(result: Result) -> Iterator[tuple[tuple[str, str], _Quantity]]:
    """Return friction bands at rest (half-difference of the approach directions), Coulomb and viscous friction."""
    for joint, band in enumerate(result.friction_band_nm, start=1):
        yield (f"J{joint}", "friction band"), _of_one_start(band, _band_std(result, joint), "Nm")
    for axis in result.motion:
        where = f"J{axis.joint}"
        yield (where, "Coulomb friction"), _of_one_start(axis.coulomb_nm, axis.coulomb_std_nm, "Nm")
        viscous = _of_one_start(axis.viscous_nm_s_rad, axis.viscous_std_nm_s_rad, "Nm s/rad")
        yield (where, "viscous friction"), viscous


def _of_one_start(value: float, std: float, unit: str) -> _Quantity:
    """Return friction with its scatter from start to start."""
    return _Quantity(value, math.hypot(std, START_SCATTER * value), unit, "friction")


def _band_std(result: Result, joint: int) -> float:
    """Return the standard deviation of the median friction band; NaN if the result lacks the visits."""
    rows = [] if result.rows is None else [row[joint - 1] for row in result.rows.band_nm if joint <= len(row)]
    bands = np.array([band for band in rows if math.isfinite(band)])
    return _OF_A_MEDIAN * float(bands.std(ddof=1)) / math.sqrt(len(bands)) if len(bands) > 2 else math.nan


def _compared(
    key: tuple[str, str], one: _Quantity, other: _Quantity, factor: float, tolerance: Mapping[str, Tolerance]
) -> ComparedQuantity:
    variance, response = one.std**2 + other.std**2, _response(one, other)
    if one.load is not None and other.load is not None:
        common = shared_errors((one.load, other.load), one.part)
        variance -= 0.0 if common is None else 2.0 * float(common[0] @ common[1])
    half = factor * math.sqrt(max(variance, 0.0)) if factor else 0.0
    if not response >= LEAST_RESPONSE:
        half = math.nan
    stated = tolerance.get(one.kind)
    allowed = 0.0 if stated is None else stated.of(one.value)
    resolution = RESOLUTION[one.kind] * (1.0 if one.kind == "com" else abs(one.value))
    off = abs(other.value - one.value)
    outcome: Outcome = CANNOT_TELL
    if one.unit == other.unit and math.isfinite(half):
        if off - half > response * allowed:
            outcome = CHANGED
        elif off + half <= response * (resolution if stated is None else allowed):
            outcome = UNCHANGED
    return ComparedQuantity(*key, one.unit, one.value, one.std, other.value, other.std, half, allowed, outcome)


def _response(one: _Quantity, other: _Quantity) -> float:
    """Return the part of a true change that the difference of both values shows; NaN = not stated."""
    return float(np.minimum(one.response, other.response))


def _verdict(rows: Sequence[ComparedQuantity]) -> Outcome:
    """Return `changed` if any quantity changed, `unchanged` if all with an uncertainty are unchanged."""
    outcomes = {row.outcome for row in rows if math.isfinite(row.half_width)}
    if CHANGED in outcomes:
        return CHANGED
    return UNCHANGED if outcomes == {UNCHANGED} else CANNOT_TELL


def sentence(found: ResultComparison) -> str:
    """Return the verdict as one sentence."""
    changed = [row for row in found.quantities if row.outcome == CHANGED]
    if changed:
        first = max(changed, key=lambda row: abs(row.difference) / max(row.half_width, 1e-12))
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        return f"changed: {first.what} of {first.where}{more}"
    open_ = [row for row in found.quantities if row.outcome == CANNOT_TELL and math.isfinite(row.half_width)]
    if found.verdict == UNCHANGED:
        return "unchanged within the uncertainty of both results"
    return f"cannot tell: the uncertainty of {len(open_) or len(found.quantities)} quantities is too large"


@dataclass(frozen=True, slots=True)
class Difference:
    """One differing value: key path, stored value, recomputed value; None if missing."""

    where: str
    stored: Any
    again: Any


def differences(stored: Mapping[str, Any], again: Mapping[str, Any]) -> tuple[Difference, ...]:
    """Return every value of two result files that differs beyond `TOLERANCE`."""
    return tuple(_differ("", _lasting(stored), _lasting(again)))


def _lasting(plain: Mapping[str, Any]) -> dict[str, Any]:
    findings = [item for item in plain.get("findings", ()) if _place(item) != _OF_TODAY]
    return {**plain, "findings": findings}


def _place(finding: Any) -> Any:
    return finding.get("where") if isinstance(finding, Mapping) else None


def _differ(where: str, stored: Any, again: Any) -> Iterator[Difference]:
    if where in _OF_THE_MOMENT:
        return
    if isinstance(stored, Mapping) and isinstance(again, Mapping):
        for key in dict.fromkeys((*stored, *again)):
            yield from _differ(f"{where}.{key}" if where else str(key), stored.get(key), again.get(key))
    elif _is_list(stored) and _is_list(again) and len(stored) == len(again):
        for index, pair in enumerate(zip(stored, again, strict=True)):
            yield from _differ(f"{where}[{index}]", *pair)
    elif not _equal(stored, again):
        yield Difference(where, stored, again)


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _equal(stored: Any, again: Any) -> bool:
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in (stored, again)):
        return type(stored) is type(again) and stored == again
    return math.isclose(stored, again, rel_tol=TOLERANCE, abs_tol=TOLERANCE)
