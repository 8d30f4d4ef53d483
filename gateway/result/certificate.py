"""Content of a load certificate: values with expanded uncertainty, uncertainty budget, traceability, equipment.

Expanded uncertainty U = k u (JCGM 100, 6.2): u is the standard deviation of the result file, k the two-sided 95 %
quantile of the normal distribution; a standard deviation from few readings is already widened by Student's quantile.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from gateway.result.names import INERTIA_PARTS
from gateway.result.numerals import TWO_SIDED_95
from gateway.result.result import UNKNOWN_THREE, LoadResult, Result

COVERAGE_FACTOR: Final = TWO_SIDED_95
COVERAGE_PROBABILITY: Final = 0.95
NOT_STATED: Final = "not stated"
NOT_TRACEABLE: Final = "NOT TRACEABLE"
#: Source of the budget -> (how the report calls it, GUM kind of evaluation: A = from the scatter of the readings of
#: this measurement, B = from other knowledge, such as data sheets, an earlier calibration, or a prior).
EVALUATIONS: Final[Mapping[str, tuple[str, str]]] = {
    "constants": ("torque constants", "B"),
    "links": ("links", "B"),
    "friction": ("friction", "B"),
    "drift": ("drift of the torque readings", "B"),
    "zeros": ("zero errors of the joints", "B"),
    "cable": ("hose or cable of the load, uneven friction", "B"),
    "noise": ("noise", "A"),
}
#: What the provenance of a torque constant from `calibrate` starts with: date, load, mass.
_JOINT: Final = re.compile(r"J\d+")
_MEASURED: Final = re.compile(r"measured (?P<date>\d{4}-\d\d-\d\d) with load (?P<load>.+) of (?P<mass>\S+) kg")


@dataclass(frozen=True, slots=True)
class CertifiedQuantity:
    """One value with its expanded uncertainty, both in `unit`; NaN where the data do not determine it."""

    name: str
    unit: str
    value: float
    expanded: float


@dataclass(frozen=True, slots=True)
class BudgetLine:
    """One uncertainty source of a mass: standard uncertainty [kg], share of the variance, evaluation type A or B."""

    source: str
    evaluation: str
    std_kg: float
    share: float


@dataclass(frozen=True, slots=True)
class CertifiedLoad:
    """Certified values of one load; `refused` is the reason if nothing is certified."""

    label: str
    frame: str
    quantities: tuple[CertifiedQuantity, ...]
    unidentifiable: tuple[str, ...] = ()
    budget: tuple[BudgetLine, ...] = ()
    refused: str = ""


@dataclass(frozen=True, slots=True)
class Traceability:
    """Whether the torque constants were measured with a weighed mass, and a statement on it."""

    is_traceable: bool
    statement: str


@dataclass(frozen=True, slots=True)
class Certificate:
    """Content of a certificate; `temperatures` are axis, lowest and highest temperature [deg C]."""

    loads: tuple[CertifiedLoad, ...]
    traceability: Traceability
    temperatures: tuple[tuple[str, float, float], ...] = ()

    @property
    def refused(self) -> tuple[CertifiedLoad, ...]:
        """Return the loads without certified values."""
        return tuple(load for load in self.loads if load.refused)


def certificate(result: Result, label: str | None = None) -> Certificate:
    """Return the certificate of a result, for one load or for all."""
    loads = [load for load in result.loads if label in (None, load.label)]
    recorded = () if result.data is None else result.data.temperature_c
    temperatures = [(f"J{joint}", low, high) for joint, (low, high) in enumerate(recorded, 1) if math.isfinite(low)]
    return Certificate(tuple(_load(result, load) for load in loads), traceability(result), tuple(temperatures))


def traceability(result: Result) -> Traceability:
    """Return whether the torque constants of a result were measured with a weighed mass (`calibrate`)."""
    measured: dict[str, list[str]] = {}
    for joint, constants in result.provenance.items():
        found = _measured(constants)
        if found is not None:
            measured.setdefault(found, []).append(joint)
    if not measured:
        return Traceability(
            False,
            "the torque constants are stated values, not measured with a weighed mass; calibrate them with "
            "servo-gateway calibrate CELL --known LABEL=MASS and estimate again",
        )
    by = "; ".join(f"{', '.join(joints)}: {source}" for source, joints in measured.items())
    axes = {joint: constants for joint, constants in result.provenance.items() if _JOINT.fullmatch(joint)}
    others = [joint for joint, constants in axes.items() if _measured(constants) is None]
    rest = f". Stated constants, with the standard deviations of the cell file: {', '.join(others)}" if others else ""
    return Traceability(
        True,
        f"torque constants of {by}{rest}. The certificate of the weighed mass is kept by the operator: its own "
        "uncertainty is not part of this budget",
    )


def _measured(constants: Any) -> str | None:
    """Return date, load and mass of the calibration of an axis; None if it was not calibrated."""
    if not isinstance(constants, Mapping):
        return None
    scale = constants.get("torque_scale")
    found = _MEASURED.match(str(scale.get("source"))) if isinstance(scale, Mapping) else None
    if found is None:
        return None
    return f"measured {found['date']} with weighed mass {found['load']} of {found['mass']} kg"


def _load(result: Result, load: LoadResult) -> CertifiedLoad:
    in_flange = None if result.data is None else result.data.flange.get(load.label)
    flange = load.com_flange_m is not None and in_flange is not None
    frame = "flange" if flange else load.frame
    if load.refused or not math.isfinite(load.mass_kg):
        missing = ", ".join(load.unidentifiable) or "no mass was estimated"
        return CertifiedLoad(load.label, frame, (), load.unidentifiable, refused=load.refused or missing)
    com_m, com_std_m = load.com_m, load.com_std_m
    if flange and in_flange is not None:
        com_m, com_std_m = load.com_flange_m, in_flange.com_std_m
    quantities = [_quantity("mass", "kg", load.mass_kg, load.mass_std_kg)]
    for axis, value, std in zip("xyz", com_m or UNKNOWN_THREE, com_std_m or UNKNOWN_THREE, strict=True):
        quantities.append(_quantity(f"centre of gravity {axis}", "m", value, std))
    quantities += _inertia(load)
    return CertifiedLoad(load.label, frame, tuple(quantities), load.unidentifiable, tuple(_budget(load)))


def _inertia(load: LoadResult) -> Iterator[CertifiedQuantity]:
    """Return the six moments of inertia about the centre of gravity, axes of the last link, if motion determined
    them.
    """
    if load.inertia_kg_m2 is None:
        return
    stds = load.inertia_std_kg_m2 or (math.nan,) * len(INERTIA_PARTS)
    for name, value, std in zip(INERTIA_PARTS, load.inertia_kg_m2, stds, strict=True):
        yield _quantity(f"inertia {name.split('_')[1]}, axes of {load.frame}", "kg m2", value, std)


def _quantity(name: str, unit: str, value: float, std: float) -> CertifiedQuantity:
    """Return a certified quantity; a value without uncertainty is not certified."""
    known = math.isfinite(value) and math.isfinite(std)
    return CertifiedQuantity(name, unit, value if known else math.nan, COVERAGE_FACTOR * std if known else math.nan)


def _budget(load: LoadResult) -> Iterator[BudgetLine]:
    for source, share in load.budget.items():
        words, evaluation = EVALUATIONS.get(source, (source.replace("_", " "), "B"))
        yield BudgetLine(words, evaluation, math.sqrt(max(share, 0.0)) * load.mass_std_kg, share)
