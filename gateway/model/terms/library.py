"""Which effects are candidates for given visits, and their shapes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.model.terms.balancer import CoilBalancer, GasBalancer
from gateway.model.terms.effects import (
    AxisCoupling,
    BaseTilt,
    CableTorque,
    JointElasticity,
    JointZeroOffset,
    LinkMass,
    LoadDependentFriction,
    PayloadShift,
    ThermalDrift,
    TorqueConstantScale,
    TorqueOffset,
    TorqueRipple,
)
from gateway.model.terms.reading import RestRows
from gateway.model.terms.term import Term
from gateway.model.terms.unnamed import BentGain, PositionTorque, Pull, SumTorque, UnevenBand, UnevenGain

Floats = NDArray[np.float64]
COUPLED = ((4, 5), (1, 2), (3, 4), (3, 5))
RATIOS = (0.35, 0.7, 0.9)
PHASES = tuple(float(v) for v in np.arange(-6, 6) * np.pi / 6)


@dataclass(frozen=True, slots=True)
class Setup:
    """What the candidates depend on besides the visits.

    Attributes
    ----------
    gear_ratio : six gear ratios, NaN where unknown
    common_scale : whether a load or the links are known, so that a common torque scale can be seen
    torque_nm : (n, 6) modelled torque of the model without effects
    """

    gear_ratio: tuple[float, ...]
    common_scale: bool
    torque_nm: Floats


def named_terms(rows: RestRows, setup: Setup) -> list[Term]:
    """Every effect of the library in every place and shape that rest visits can show."""
    terms: list[Term] = [BaseTilt()]
    largest = np.maximum(np.abs(setup.torque_nm).max(axis=0), 1e-6)
    missed = np.nan_to_num(np.abs(rows.sum_nm - setup.torque_nm)).max(axis=0)
    for axis in range(6):
        if not np.isfinite(rows.sum_nm[:, axis]).any():
            continue
        terms += [JointZeroOffset(axis), TorqueConstantScale(axis), TorqueOffset(axis), LoadDependentFriction(axis)]
        if not np.isfinite(rows.wind_up_rad[:, axis]).all():
            terms.append(JointElasticity(axis, float(largest[axis])))
        terms += _drifts(rows, axis)
        terms += _ripples(axis, setup.gear_ratio[axis])
        if axis >= 3:
            terms += [CableTorque(axis, "linear"), CableTorque(axis, "harmonic")]
    terms += [AxisCoupling(row, column) for row, column in COUPLED]
    terms += [LinkMass(link) for link in (1, 2, 3)]
    if np.isfinite(rows.sum_nm[:, 1]).any():
        shapes = list(itertools.product(RATIOS, PHASES))
        size = float(max(largest[1], 4.0 * missed[1]))
        terms += [CoilBalancer(*shape, size) for shape in shapes]
        terms += [GasBalancer(*shape, size, stroke) for shape in shapes for stroke in (0.35, 0.7)]
    terms += _shifts(rows)
    if setup.common_scale:
        terms.append(TorqueConstantScale(None))
    return terms


def unnamed_terms(rows: RestRows, setup: Setup) -> list[Term]:
    """Smooth shapes without a cause: the rivals of the named effects."""
    terms: list[Term] = [PositionTorque(axis, joint) for axis in range(6) for joint in range(1, 6)]
    terms += [SumTorque(axis) for axis in (1, 2)]
    terms += [UnevenGain(axis) for axis in range(1, 6)]
    largest = np.maximum(np.abs(setup.torque_nm).max(axis=0), 1e-6)
    terms += [BentGain(axis, float(largest[axis])) for axis in range(1, 6)]
    terms += [UnevenBand(axis, axis) for axis in range(6)]
    terms += [Pull(link) for link in (2, 3, 4, 5)]
    measured = np.asarray(np.isfinite(rows.sum_nm).any(axis=0))
    return [term for term in terms if isinstance(term, Pull) or measured[term.joints[0] - 1]]


def _drifts(rows: RestRows, axis: int) -> list[Term]:
    causes = []
    if np.isfinite(rows.temperature_c[:, axis]).all() and np.ptp(rows.temperature_c[:, axis]) > 0.5:
        causes.append("temperature")
    if np.ptp(rows.time_s) > 0:
        causes.append("time")
    return [ThermalDrift(axis, cause, on) for cause in causes for on in ("torque", "friction")]


def _ripples(axis: int, ratio: float) -> list[Term]:
    if np.isfinite(ratio) and ratio != 0:
        return [TorqueRipple(axis, abs(ratio)), TorqueRipple(axis, 2.0 * abs(ratio))]
    return []


def _shifts(rows: RestRows) -> list[Term]:
    """Jumps between the visits of the loads, and a drift over them."""
    terms: list[Term] = []
    loaded = rows.load != "none"
    times = np.unique(rows.time_s[loaded])
    if len(times) < 4 or len(times) != loaded.sum():
        return terms
    terms += [PayloadShift(float(when)) for when in times[2:-1]]
    terms.append(PayloadShift(float(times[0]), float(times[-1])))
    return terms
