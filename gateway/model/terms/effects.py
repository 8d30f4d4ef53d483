"""The effects that a model of an arm at rest may lack, one frozen dataclass each (balancers in their own file)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gateway.model.terms.reading import AlteredModel, RestRows
from gateway.model.terms.term import NAN, OnAxis, Plain, plus

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LoadDependentFriction(OnAxis):
    """`nu |tau| sign(dir)`: gear losses in proportion to the transmitted torque (Hamon, Gautier, Garrec 2010)."""

    name: ClassVar[str] = "load_dependent_friction"
    parameters: ClassVar[tuple[str, ...]] = ("coefficient",)
    units: ClassVar[tuple[str, ...]] = ("1",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.2,)

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        return bool(theta[0] > 0)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        return replace(setting, load_friction=plus(setting.load_friction, self.axis, theta[0]))


@dataclass(frozen=True, slots=True)
class BaseTilt(Plain):
    """Gravity turned by two angles: the base is not level."""

    name: ClassVar[str] = "base_tilt"
    parameters: ClassVar[tuple[str, ...]] = ("tilt_x_rad", "tilt_y_rad")
    units: ClassVar[tuple[str, ...]] = ("rad", "rad")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (0.1, 0.1)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        return replace(setting, tilt_rad=setting.tilt_rad + theta)


@dataclass(frozen=True, slots=True)
class JointZeroOffset(OnAxis):
    """The link stands `offset_rad` further than reported."""

    name: ClassVar[str] = "joint_zero_offset"
    parameters: ClassVar[tuple[str, ...]] = ("offset_rad",)
    units: ClassVar[tuple[str, ...]] = ("rad",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.1,)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        return replace(setting, zero_offset_rad=plus(setting.zero_offset_rad, self.axis, theta[0]))


@dataclass(frozen=True, slots=True)
class TorqueConstantScale(Plain):
    """Torque per ampere, true over stored (`scale`), of one axis or (`axis` None) of all."""

    axis: int | None = None
    name: ClassVar[str] = "torque_constant_scale"
    parameters: ClassVar[tuple[str, ...]] = ("scale",)
    units: ClassVar[tuple[str, ...]] = ("1",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.2,)

    @property
    def joints(self) -> tuple[int, ...]:
        return () if self.axis is None else (self.axis + 1,)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        gain = setting.gain.copy()
        gain[:, slice(None) if self.axis is None else self.axis] *= 1.0 + theta[0]
        return replace(setting, gain=gain)

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        scale = 1.0 / (1.0 + float(theta[0]))
        return {"scale": scale}, {"scale": float(np.sqrt(covariance[0, 0])) * scale**2}


@dataclass(frozen=True, slots=True)
class TorqueOffset(OnAxis):
    """A constant in the reading of one axis."""

    name: ClassVar[str] = "torque_offset"
    parameters: ClassVar[tuple[str, ...]] = ("offset_nm",)
    units: ClassVar[tuple[str, ...]] = ("Nm",)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        return replace(setting, offset_nm=plus(setting.offset_nm, (slice(None), self.axis), theta[0]))


@dataclass(frozen=True, slots=True)
class ThermalDrift(OnAxis):
    """Reading (or friction) of one axis changes with its temperature, or with time, since the first visit."""

    by: str = "time"
    on: str = "torque"
    name: ClassVar[str] = "thermal_drift"
    parameters: ClassVar[tuple[str, ...]] = ("per_k",)
    units: ClassVar[tuple[str, ...]] = ("1/K or 1/s",)

    @property
    def spread(self) -> tuple[float, ...]:
        return (0.02,) if self.by == "temperature" else (3e-4,)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        since = self.since(rows)
        field = "gain" if self.on == "torque" else "band_gain"
        values = getattr(setting, field).copy()
        values[:, self.axis] *= 1.0 + theta[0] * since
        return replace(setting, **{field: values})

    def since(self, rows: RestRows) -> Floats:
        """Temperature rise [K] or time [s] (n,) since the first visit."""
        values = rows.temperature_c[:, self.axis] if self.by == "temperature" else rows.time_s
        return values - values[int(np.argmin(rows.time_s))]

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        key = "per_k" if self.by == "temperature" else "per_s"
        return {key: float(theta[0])}, {key: float(np.sqrt(covariance[0, 0]))}


@dataclass(frozen=True, slots=True)
class CableTorque(OnAxis):
    """A dress pack wound up by a wrist axis: linear in q about a neutral angle, or its first harmonic."""

    shape: str = "linear"
    name: ClassVar[str] = "cable_torque"
    parameters: ClassVar[tuple[str, ...]] = ("stiffness_nm_rad", "neutral_rad")
    units: ClassVar[tuple[str, ...]] = ("Nm/rad", "rad")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        q = rows.q_rad[:, self.axis]
        torque = theta[0] * q + theta[1] if self.shape == "linear" else theta[0] * np.sin(q) + theta[1] * np.cos(q)
        return replace(setting, passive_nm=plus(setting.passive_nm, (slice(None), self.axis), torque))

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        a, b = float(theta[0]), float(theta[1])
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        if self.shape == "linear":
            neutral = -b / a if a else NAN
            slope = np.array([b / a**2, -1.0 / a]) if a else np.zeros(2)
            error = float(np.sqrt(max(slope @ covariance @ slope, 0.0)))
            return {"stiffness_nm_rad": -a, "neutral_rad": neutral}, {
                "stiffness_nm_rad": float(std[0]),
                "neutral_rad": error,
            }
        stiffness, neutral = float(np.hypot(a, b)), float(np.arctan2(b, -a))
        slope = np.array([a, b]) / max(stiffness, 1e-12)
        error = float(np.sqrt(max(slope @ covariance @ slope, 0.0)))
        values = {"stiffness_nm_rad": stiffness, "neutral_rad": neutral, "harmonic": 1.0}
        return values, {"stiffness_nm_rad": error, "neutral_rad": error / max(stiffness, 1e-12)}


@dataclass(frozen=True, slots=True)
class JointElasticity(OnAxis):
    """The link stands at `q - compliance tau`: the gear winds up under load."""

    largest_nm: float = 1.0
    name: ClassVar[str] = "joint_elasticity"
    parameters: ClassVar[tuple[str, ...]] = ("compliance_rad_nm",)
    units: ClassVar[tuple[str, ...]] = ("rad/Nm",)

    @property
    def spread(self) -> tuple[float, ...]:
        return (0.1 / self.largest_nm,)

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        return bool(theta[0] > 0)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        return replace(setting, compliance_rad_nm=plus(setting.compliance_rad_nm, self.axis, theta[0]))


@dataclass(frozen=True, slots=True)
class TorqueRipple(OnAxis):
    """The reading swings `per_revolution` times per turn of the joint: motor or wave generator harmonics."""

    per_revolution: float = 100.0
    name: ClassVar[str] = "torque_ripple"
    parameters: ClassVar[tuple[str, ...]] = ("sine_nm", "cosine_nm")
    units: ClassVar[tuple[str, ...]] = ("Nm", "Nm")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        angle = self.per_revolution * rows.q_rad[:, self.axis]
        swing = theta[0] * np.sin(angle) + theta[1] * np.cos(angle)
        return replace(setting, offset_nm=plus(setting.offset_nm, (slice(None), self.axis), swing))

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        amplitude = float(np.hypot(theta[0], theta[1]))
        slope = theta / max(amplitude, 1e-12)
        error = float(np.sqrt(max(slope @ covariance @ slope, 0.0)))
        phase = float(np.arctan2(theta[1], theta[0]))
        values = {"amplitude_nm": amplitude, "per_revolution": self.per_revolution, "phase_rad": phase}
        return values, {"amplitude_nm": error, "phase_rad": error / max(amplitude, 1e-12)}


@dataclass(frozen=True, slots=True)
class AxisCoupling(Plain):
    """Motor j turns with joint i: axis i shows `coefficient` times the torque of axis j."""

    row: int
    column: int
    name: ClassVar[str] = "axis_coupling"
    parameters: ClassVar[tuple[str, ...]] = ("coefficient",)
    units: ClassVar[tuple[str, ...]] = ("1",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.7,)

    @property
    def joints(self) -> tuple[int, ...]:
        return (self.row + 1, self.column + 1)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        mixing = np.eye(6)
        mixing[self.row, self.column] = theta[0]
        return replace(setting, coupling=mixing @ setting.coupling)


@dataclass(frozen=True, slots=True)
class LinkMass(OnAxis):
    """A body [m, hx, hy, hz] bolted to one link; it is seen as far as the prior on the links says."""

    name: ClassVar[str] = "link_mass"
    parameters: ClassVar[tuple[str, ...]] = ("mass_kg", "first_x_kg_m", "first_y_kg_m", "first_z_kg_m")
    units: ClassVar[tuple[str, ...]] = ("kg", "kg m", "kg m", "kg m")
    linear: ClassVar[tuple[bool, ...]] = (True, True, True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN, NAN, NAN)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        part = slice(4 * self.axis, 4 * self.axis + 4)
        return replace(setting, link_extra=plus(setting.link_extra, part, theta))


@dataclass(frozen=True, slots=True)
class PayloadShift(Plain):
    """The load's centre of gravity jumps at `time_s`, or drifts from then until `until_s`."""

    time_s: float
    until_s: float | None = None
    name: ClassVar[str] = "payload_shift"
    parameters: ClassVar[tuple[str, ...]] = ("shift_x_m", "shift_y_m", "shift_z_m")
    units: ClassVar[tuple[str, ...]] = ("m", "m", "m")
    linear: ClassVar[tuple[bool, ...]] = (True, True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (0.2, 0.2, 0.2)

    def apply(self, setting: AlteredModel, theta: Floats, rows: RestRows) -> AlteredModel:
        after = np.where(rows.time_s >= self.time_s - 1e-9, 1.0, 0.0)
        if self.until_s is not None:
            after = after * (rows.time_s - self.time_s) / max(self.until_s - self.time_s, 1e-9)
        return replace(setting, moment_factor=setting.moment_factor + after[:, None] * theta)

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        distance = float(np.linalg.norm(theta))
        slope = theta / max(distance, 1e-12)
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        axes = list(zip("xyz", theta, std, strict=True))
        values = {"shift_m": distance} | {f"shift_{axis}_m": float(value) for axis, value, _ in axes}
        errors = {"shift_m": float(np.sqrt(max(slope @ covariance @ slope, 0.0)))}
        return values | {"time_s": self.time_s}, errors | {f"shift_{axis}_m": float(e) for axis, _, e in axes}
