"""What every estimator returns: parameters with covariance, loads, and what each row says of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.result.result import Bare, Finding, NextMeasurement

Floats = NDArray[np.float64]

LOAD_PARTS = ("mass_kg", "com_x_m", "com_y_m", "com_z_m")
_AS_ZERO = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class LoadEstimate:
    """One load.

    Attributes
    ----------
    label : str
    mass_kg, mass_std_kg : float
        NaN where the data cannot give them.
    com_m, com_std_m : arrays of shape (3,)
        In the last link; 1.96 standard deviations hold the truth in 95 %.
    correlation : array of shape (4, 4)
        Of [mass, x, y, z], NaN where unidentifiable.
    covariance : array of shape (4, 4)
        Of [m, hx, hy, hz], as far as the data determine it.
    unidentifiable : tuple of str
    per_pose_mass_kg : mapping of pose number to mass
    refused : str or None
        Why the data of this load contradict each other; everything else is NaN then.
    """

    label: str
    mass_kg: float
    mass_std_kg: float
    com_m: Floats
    com_std_m: Floats
    correlation: Floats
    covariance: Floats
    unidentifiable: tuple[str, ...] = ()
    per_pose_mass_kg: Mapping[str, float] = field(default_factory=dict)
    refused: str | None = None

    @property
    def moment(self) -> Floats:
        """[m, hx, hy, hz]."""
        return self.mass_kg * np.concatenate([[1.0], self.com_m])


@dataclass(frozen=True, slots=True, eq=False)
class FittedRows:
    """Measured and modelled torque, n visits or instants by N axes [Nm]; NaN = not measured or not used.

    `std_nm` is the standard deviation the fit gave each torque, `leverage` the share of its noise the fit took up.
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
        """Measured less modelled torque (n, N)."""
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
        Parameters the data cannot tell apart.
    bare : Bare or None
    findings : tuple of Finding
    next : tuple of NextMeasurement
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
    quality: Mapping[str, Any] = field(default_factory=dict)


def refused_load(label: str, reason: str, per_pose_mass_kg: Mapping[str, float] | None = None) -> LoadEstimate:
    """A load whose data contradict each other."""
    nothing = np.full(3, np.nan)
    square = np.full((4, 4), np.nan)
    return LoadEstimate(
        label, np.nan, np.nan, nothing, nothing, square, square, LOAD_PARTS, dict(per_pose_mass_kg or {}), reason
    )


def load_directions(moment: Floats) -> Floats:
    """Derivatives (4, 4) of [m, x, y, z] by [m, hx, hy, hz] at `moment` (4,)."""
    mass = moment[0] if abs(moment[0]) > _AS_ZERO else _AS_ZERO
    turn = np.zeros((4, 4))
    turn[0, 0] = 1.0
    turn[1:, 0] = -moment[1:] / mass**2
    turn[1:, 1:] = np.eye(3) / mass
    return turn


def load_from_moment(
    label: str,
    moment: Floats,
    covariance: Floats,
    widening: Floats,
    found: NDArray[np.bool_],
    per_pose_mass_kg: Mapping[str, float] | None = None,
) -> LoadEstimate:
    """A load from [m, h] (4,) with covariance (4, 4).

    Parameters
    ----------
    label : str
    moment, covariance : arrays of shape (4,), (4, 4)
    widening : array of shape (4,)
        Factor on the standard deviations of [m, x, y, z].
    found : bool array of shape (4,)
        Which of [m, x, y, z] the data determine.
    per_pose_mass_kg : mapping, optional
    """
    turn = load_directions(moment)
    spread = turn @ covariance @ turn.T
    std = np.where(found, np.sqrt(np.maximum(np.diag(spread), 0.0)), np.nan)
    value = np.where(found, np.concatenate([moment[:1], turn[1, 1] * moment[1:]]), np.nan)
    size = np.where(std > 0, std, np.nan)
    correlation = spread / np.outer(size, size)
    np.fill_diagonal(correlation, np.where(np.isfinite(std), 1.0, np.nan))
    wide = std * widening
    missing = tuple(name for name, good in zip(LOAD_PARTS, found, strict=True) if not good)
    return LoadEstimate(
        label,
        float(value[0]),
        float(wide[0]),
        value[1:],
        wide[1:],
        correlation,
        covariance,
        missing,
        per_pose_mass_kg or {},
    )


def without_guesses(load: LoadEstimate, longest_m: float) -> LoadEstimate:
    """The load without coordinates whose standard deviation exceeds the arm's own length: those are not known."""
    lost = load.com_std_m > longest_m
    if not lost.any():
        return load
    gone = np.concatenate([[False], lost])
    correlation = np.where(gone[:, None] | gone, np.nan, load.correlation)
    return replace(
        load,
        com_m=np.where(lost, np.nan, load.com_m),
        com_std_m=np.where(lost, np.nan, load.com_std_m),
        correlation=correlation,
        unidentifiable=tuple(
            name for name, out in zip(LOAD_PARTS, gone, strict=True) if out or name in load.unidentifiable
        ),
    )
