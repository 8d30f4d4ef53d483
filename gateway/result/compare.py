"""Compare two results of one robot, before and after service: changed, unchanged, or undecided.

Every quantity that both results hold is compared with the uncertainty of both. With d the difference, s its standard
deviation and h = z s, where z keeps the chance of one false alarm among all quantities at 5 % (Bonferroni):

    changed       |d| - h > tolerance
    unchanged     |d| + h <= tolerance
    cannot tell   anything else

Without a stated tolerance, `changed` is any significant difference (tolerance 0), and `unchanged` is measured against
the resolution that service needs (`RESOLUTION`). The errors of both results are taken as independent: what they share
(the same link masses, the same unknown constants) makes the true uncertainty of the difference smaller.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import NormalDist
from typing import Any, Final, Literal

import numpy as np

from gateway.errors import InputError
from gateway.result.result import EffectResult, LoadResult, Result
from gateway.result.values import plain_values

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
RESOLUTION: Final = {"mass": 0.1, "com": 0.02, "constant": 0.1, "friction": 0.3}
#: Key of a tolerance -> unit -> factor; a share where the factor is that of %.
UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "mass": {"%": 0.01, "kg": 1.0, "g": 0.001},
    "com": {"mm": 0.001, "m": 1.0},
    "constant": {"%": 0.01},
    "friction": {"%": 0.01, "Nm": 1.0},
}
EXAMPLE: Final = "such as mass=2%,com=5mm,constant=3%,friction=20%"


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
        Of the interval of the difference, at the level of all quantities together.
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

    def as_json(self) -> dict[str, Any]:
        """Return plain values; NaN becomes None."""
        rows = [asdict(each) | {"difference": each.difference} for each in self.quantities]
        about = {"robot": self.robot, "before": self.before, "after": self.after, "created": list(self.created)}
        reported = {"verdict": self.verdict, "quantities": rows, "remarks": list(self.remarks)}
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
    if same:
        remarks.append("both files are the same result")
    if None not in created and str(created[0]) > str(created[1]):
        remarks.append(f"{names[0]} is newer than {names[1]}: check the order of the two files")
    return ResultComparison(before.robot, *names, (created[0], created[1]), rows, _verdict(rows), tuple(remarks))


@dataclass(frozen=True, slots=True)
class _Quantity:
    value: float
    std: float
    unit: str
    kind: str


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
        yield (where, "mass"), _Quantity(load.mass_kg, load.mass_std_kg, "kg", "mass")
        stds = load.com_std_m or (math.nan,) * 3
        for axis, value, std in zip("xyz", load.com_m or (), stds, strict=False):
            yield (where, f"centre {axis} in {load.frame}"), _Quantity(value, std, "m", "com")


def _constants(result: Result) -> Iterator[tuple[tuple[str, str], _Quantity]]:
    """Return the true torque constants: stated constant times identified scale, over the gain 1 + g of the readings."""
    gain = result.nuisance.get("gain")
    for joint in range(1, len(result.noise_floor_nm) + 1):
        found = _scale(result.effects, joint)
        if found is None and (gain is None or joint > len(gain.value)):
            continue
        scale, scale_std = found or (1.0, 0.0)
        error, error_std = (0.0, 0.0)
        if gain is not None and joint <= len(gain.value) and math.isfinite(gain.value[joint - 1]):
            error, error_std = gain.value[joint - 1], gain.std[joint - 1]
        elif found is None:
            continue
        entry = result.provenance.get(f"J{joint}", {})
        stated = entry.get("torque_constant") if isinstance(entry, Mapping) else None
        used = isinstance(stated, Mapping) and "not used" not in str(stated.get("source"))
        constant, unit = (float(stated["value"]), "Nm/A") if used and stated else (1.0, "of stated")
        value = constant * scale / (1.0 + error)
        share = math.hypot(scale_std / scale, error_std / (1.0 + error))
        yield (f"J{joint}", "torque constant"), _Quantity(value, abs(value) * share, unit, "constant")


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
        yield (f"J{joint}", "friction band"), _Quantity(band, _band_std(result, joint), "Nm", "friction")
    for axis in result.motion:
        where = f"J{axis.joint}"
        yield (where, "Coulomb friction"), _Quantity(axis.coulomb_nm, axis.coulomb_std_nm, "Nm", "friction")
        viscous = _Quantity(axis.viscous_nm_s_rad, axis.viscous_std_nm_s_rad, "Nm s/rad", "friction")
        yield (where, "viscous friction"), viscous


def _band_std(result: Result, joint: int) -> float:
    """Return the standard deviation of the median friction band; NaN if the result lacks the visits."""
    rows = [] if result.rows is None else [row[joint - 1] for row in result.rows.band_nm if joint <= len(row)]
    bands = np.array([band for band in rows if math.isfinite(band)])
    return _OF_A_MEDIAN * float(bands.std(ddof=1)) / math.sqrt(len(bands)) if len(bands) > 2 else math.nan


def _compared(
    key: tuple[str, str], one: _Quantity, other: _Quantity, factor: float, tolerance: Mapping[str, Tolerance]
) -> ComparedQuantity:
    half = factor * math.hypot(one.std, other.std) if factor else 0.0
    stated = tolerance.get(one.kind)
    allowed = 0.0 if stated is None else stated.of(one.value)
    resolution = RESOLUTION[one.kind] * (1.0 if one.kind == "com" else abs(one.value))
    off = abs(other.value - one.value)
    outcome: Outcome = CANNOT_TELL
    if one.unit == other.unit and math.isfinite(half):
        if off - half > allowed:
            outcome = CHANGED
        elif off + half <= (resolution if stated is None else allowed):
            outcome = UNCHANGED
    return ComparedQuantity(*key, one.unit, one.value, one.std, other.value, other.std, half, allowed, outcome)


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
