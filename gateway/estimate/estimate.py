"""Result type of every estimator: parameters with covariance, loads, and measured against modelled torque."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.identify.load_estimate import LoadEstimate
from gateway.result.result import AxisMotion, Bare, Finding, NextMeasurement, NuisanceResult, SetAside

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FittedRows:
    """Measured and modelled torque, n visits or instants by N axes [Nm]; NaN = not measured or not used.

    `std_nm` is the standard deviation of each torque in the fit. `leverage` is the share of the row's own noise that
    the fit absorbs, 0 to 1.
    """

    run: NDArray[np.str_]
    load: NDArray[np.str_]
    pose: NDArray[np.int_]
    time_s: Floats
    q_rad: Floats
    direction: NDArray[np.int_]
    tau_nm: Floats
    model_nm: Floats
    band_nm: Floats
    std_nm: Floats
    leverage: Floats

    @property
    def residual_nm(self) -> Floats:
        """Measured minus modelled torque (n, N)."""
        return self.tau_nm - self.model_nm

    @property
    def rms_nm(self) -> Floats:
        """Root mean square (N,) of the residual over the rows used; NaN where there is none."""
        left = self.residual_nm
        count = np.isfinite(left).sum(axis=0)
        total = np.nansum(left**2, axis=0)
        return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Result of one estimator.

    Attributes
    ----------
    method : str
    loads : tuple of LoadEstimate
    sigma_nm : array of shape (N,)
        Noise floor of a half-sum; NaN where not known.
    band_nm : array of shape (N,)
        Friction band of each axis; NaN where not seen.
    names, units : tuples of p str
    value, std : arrays of shape (p,)
        `std` is NaN for what the data do not determine.
    covariance : array of shape (p, p)
    rows : FittedRows or None
    rank : int
    condition : float
        Of the scaled, weighted columns.
    lumped : tuple of str
        Parameter combinations that the data cannot separate.
    bare : Bare or None
    findings : tuple of Finding
    next : tuple of NextMeasurement
    nuisance : mapping
        Nuisance parameters, by their names in the result.
    set_aside : tuple of SetAside
        Outliers that were rejected from the fit.
    motion : tuple of AxisMotion
        Friction, rotor inertia and delay of the axes that moved.
    quality : mapping
        Further figures for the report.
    """

    method: str
    loads: tuple[LoadEstimate, ...]
    sigma_nm: Floats
    band_nm: Floats
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    value: Floats = field(default_factory=lambda: np.zeros(0))
    std: Floats = field(default_factory=lambda: np.zeros(0))
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    rows: FittedRows | None = None
    rank: int = 0
    condition: float = np.nan
    lumped: tuple[str, ...] = ()
    bare: Bare | None = None
    findings: tuple[Finding, ...] = ()
    next: tuple[NextMeasurement, ...] = ()
    nuisance: Mapping[str, NuisanceResult] = field(default_factory=dict)
    set_aside: tuple[SetAside, ...] = ()
    motion: tuple[AxisMotion, ...] = ()
    quality: Mapping[str, Any] = field(default_factory=dict)
