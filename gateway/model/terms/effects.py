"""The effects that a model of an arm at rest may lack, one frozen dataclass each.

An effect puts its parameters `theta` into a `Setting`; `parameters` and `units` name them, `linear` says which of them
the torque is linear in, `start` is where the others begin (they are profiled out), `spread` is how large each may
plausibly be (standard deviation of its prior; NaN = as far as ten noise floors reach). `report` turns the fitted values
into the parameters an engineer reads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from gateway.model.terms.reading import RestRows, Setting

Floats = NDArray[np.float64]
NAN = float("nan")


class Term(Protocol):
    """What the search needs of an effect."""

    name: ClassVar[str]
    parameters: ClassVar[tuple[str, ...]]
    units: ClassVar[tuple[str, ...]]
    linear: ClassVar[tuple[bool, ...]]

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints counted from 1; empty for the base and the load."""
        ...

    @property
    def start(self) -> tuple[float, ...]:
        """Where the parameters begin; 0 for linear ones."""
        ...

    @property
    def spread(self) -> tuple[float, ...]:
        """Plausible size of each parameter, NaN = no opinion."""
        ...

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        """The setting with the effect in it."""
        ...

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        """Whether the mechanism can do that: a spring that pushes where it should pull cannot."""
        ...

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        """Parameters and standard deviations by name."""
        ...


@dataclass(frozen=True, slots=True)
class _Base:
    """What most effects share: linear parameters that start at 0 and are reported as they are."""

    name: ClassVar[str] = ""
    parameters: ClassVar[tuple[str, ...]] = ()
    units: ClassVar[tuple[str, ...]] = ()
    linear: ClassVar[tuple[bool, ...]] = (True,)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN,)

    @property
    def joints(self) -> tuple[int, ...]:
        return ()

    @property
    def start(self) -> tuple[float, ...]:
        return (0.0,) * len(self.linear)

    @property
    def spread(self) -> tuple[float, ...]:
        return self.SPREAD

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        return True

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        pairs = zip(self.parameters, theta, std, strict=True)
        listed = [(key, float(value), float(error)) for key, value, error in pairs]
        return {key: value for key, value, _ in listed}, {key: error for key, _, error in listed}


@dataclass(frozen=True, slots=True)
class _OnAxis(_Base):
    """An effect of one axis, counted from 0."""

    axis: int

    @property
    def joints(self) -> tuple[int, ...]:
        return (self.axis + 1,)


def _plus(values: Floats, index: object, change: Floats | float) -> Floats:
    moved = values.copy()
    moved[index] += change  # type: ignore[index]
    return moved


@dataclass(frozen=True, slots=True)
class StaticFriction(_OnAxis):
    """Mean friction by approach direction; only one-sided visits tell it from the band."""

    name: ClassVar[str] = "static_friction"
    parameters: ClassVar[tuple[str, ...]] = ("bias_nm",)
    units: ClassVar[tuple[str, ...]] = ("Nm",)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        return replace(setting, side_nm=_plus(setting.side_nm, self.axis, theta[0]))


@dataclass(frozen=True, slots=True)
class LoadDependentFriction(_OnAxis):
    """`nu |tau| sign(dir)`: gear losses in proportion to the transmitted torque (Hamon, Gautier, Garrec 2010)."""

    name: ClassVar[str] = "load_dependent_friction"
    parameters: ClassVar[tuple[str, ...]] = ("coefficient",)
    units: ClassVar[tuple[str, ...]] = ("1",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.2,)

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        return bool(theta[0] > 0)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        return replace(setting, load_friction=_plus(setting.load_friction, self.axis, theta[0]))


@dataclass(frozen=True, slots=True)
class BaseTilt(_Base):
    """Gravity turned by two angles: the base is not level."""

    name: ClassVar[str] = "base_tilt"
    parameters: ClassVar[tuple[str, ...]] = ("tilt_x_rad", "tilt_y_rad")
    units: ClassVar[tuple[str, ...]] = ("rad", "rad")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (0.1, 0.1)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        return replace(setting, tilt_rad=setting.tilt_rad + theta)


@dataclass(frozen=True, slots=True)
class JointZeroOffset(_OnAxis):
    """The link stands `offset_rad` further than reported."""

    name: ClassVar[str] = "joint_zero_offset"
    parameters: ClassVar[tuple[str, ...]] = ("offset_rad",)
    units: ClassVar[tuple[str, ...]] = ("rad",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.1,)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        return replace(setting, zero_offset_rad=_plus(setting.zero_offset_rad, self.axis, theta[0]))


@dataclass(frozen=True, slots=True)
class TorqueConstantScale(_Base):
    """Torque per ampere, true over stored (`scale`), of one axis or (`axis` None) of all."""

    axis: int | None = None
    name: ClassVar[str] = "torque_constant_scale"
    parameters: ClassVar[tuple[str, ...]] = ("scale",)
    units: ClassVar[tuple[str, ...]] = ("1",)
    SPREAD: ClassVar[tuple[float, ...]] = (0.2,)

    @property
    def joints(self) -> tuple[int, ...]:
        return () if self.axis is None else (self.axis + 1,)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        gain = setting.gain.copy()
        gain[:, slice(None) if self.axis is None else self.axis] *= 1.0 + theta[0]
        return replace(setting, gain=gain)

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        scale = 1.0 / (1.0 + float(theta[0]))
        return {"scale": scale}, {"scale": float(np.sqrt(covariance[0, 0])) * scale**2}


@dataclass(frozen=True, slots=True)
class TorqueOffset(_OnAxis):
    """A constant in the reading of one axis."""

    name: ClassVar[str] = "torque_offset"
    parameters: ClassVar[tuple[str, ...]] = ("offset_nm",)
    units: ClassVar[tuple[str, ...]] = ("Nm",)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        return replace(setting, offset_nm=_plus(setting.offset_nm, (slice(None), self.axis), theta[0]))


@dataclass(frozen=True, slots=True)
class ThermalDrift(_OnAxis):
    """Reading (or friction) of one axis changes with its temperature, or with time, since the first visit."""

    by: str = "time"
    on: str = "torque"
    name: ClassVar[str] = "thermal_drift"
    parameters: ClassVar[tuple[str, ...]] = ("per_k",)
    units: ClassVar[tuple[str, ...]] = ("1/K or 1/s",)

    @property
    def spread(self) -> tuple[float, ...]:
        return (0.02,) if self.by == "temperature" else (3e-4,)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
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
class _Balancer(_Base):
    """A spring between base and link 2: torque `F(l) dl/dq2`, shortest at q2 = phase.

    Lever a and anchor b enter as `ratio = 2 a b / (a^2 + b^2)`, fitted as its logit; in units of sqrt(a^2 + b^2) the
    length is `l = sqrt(1 - ratio cos(q2 - phase))`. Torque alone gives k a b and not k, so stiffness is reported for
    `sqrt(a^2 + b^2) = reach_m`.
    """

    ratio: float = 0.6
    phase_rad: float = 0.0
    largest_nm: float = 1.0
    name: ClassVar[str] = "balancer_spring"
    REACH_M: ClassVar[float] = 1.0

    @property
    def joints(self) -> tuple[int, ...]:
        return (2,)

    def geometry(self, theta: Floats, rows: RestRows) -> tuple[Floats, Floats, float]:
        """Angle, length (n,) and ratio for the last two or three parameters."""
        angle = rows.q_rad[:, 1] - theta[0]
        ratio = float(1.0 / (1.0 + np.exp(-np.clip(theta[1], -5.0, 5.0))))
        return angle, np.sqrt(1.0 - ratio * np.cos(angle)), ratio

    def _with(self, setting: Setting, torque: Floats) -> Setting:
        return replace(setting, passive_nm=_plus(setting.passive_nm, (slice(None), 1), torque))

    @property
    def _logit(self) -> float:
        return float(np.log(self.ratio / (1.0 - self.ratio)))

    def _shape(self, theta: Floats, std: Floats) -> tuple[dict[str, float], dict[str, float]]:
        ratio = float(1.0 / (1.0 + np.exp(-theta[1])))
        values = {"phase_rad": float(theta[0]), "lever_ratio": ratio, "reach_m": self.REACH_M}
        return values, {"phase_rad": float(std[0]), "lever_ratio": float(std[1]) * ratio * (1.0 - ratio)}


@dataclass(frozen=True, slots=True)
class CoilBalancer(_Balancer):
    """Coil spring: force `k (l - l0)`."""

    parameters: ClassVar[tuple[str, ...]] = ("stiffness_n_m", "preload_nm", "phase_rad", "lever_ratio")
    units: ClassVar[tuple[str, ...]] = ("N/m", "Nm", "rad", "1")
    linear: ClassVar[tuple[bool, ...]] = (True, True, False, False)

    @property
    def start(self) -> tuple[float, ...]:
        return (0.0, 0.0, self.phase_rad, self._logit)

    @property
    def spread(self) -> tuple[float, ...]:
        return (0.5 * self.largest_nm, 0.5 * self.largest_nm, 0.4, 0.8)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        angle, length, _ = self.geometry(theta[2:], rows)
        return self._with(setting, -np.sin(angle) * (theta[0] + theta[1] / length))

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        """The spring is under tension wherever the arm was, and pulls harder the longer it is."""
        _, length, _ = self.geometry(theta[2:], rows)
        force = theta[0] * length + theta[1]
        return bool(theta[0] > 0 and (force > -0.1 * np.abs(force).max()).all())

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        values, errors = self._shape(theta[2:], std[2:])
        unit = 2.0 / (values["lever_ratio"] * self.REACH_M**2)
        first = {"stiffness_n_m": float(theta[0]) * unit, "preload_nm": float(theta[1])}
        return first | values, {"stiffness_n_m": float(std[0]) * unit, "preload_nm": float(std[1])} | errors


@dataclass(frozen=True, slots=True)
class GasBalancer(_Balancer):
    """Gas spring: a column of gas that the pull shortens, `force = F0 (1 - x / column)^-1.3`."""

    stroke: float = 0.5
    parameters: ClassVar[tuple[str, ...]] = ("stiffness_n_m", "phase_rad", "lever_ratio", "gas_stroke")
    units: ClassVar[tuple[str, ...]] = ("N/m", "rad", "1", "1")
    linear: ClassVar[tuple[bool, ...]] = (True, False, False, False)
    POLYTROPIC: ClassVar[float] = 1.3

    @property
    def start(self) -> tuple[float, ...]:
        return (0.0, self.phase_rad, self._logit, float(np.log(self.stroke / (1.0 - self.stroke))))

    @property
    def spread(self) -> tuple[float, ...]:
        return (0.5 * self.largest_nm, 0.4, 0.8, 0.8)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        angle, length, ratio = self.geometry(theta[1:], rows)
        shortest, longest = np.sqrt(1.0 - ratio), np.sqrt(1.0 + ratio)
        stroke = 1.0 / (1.0 + np.exp(-np.clip(theta[3], -5.0, 3.0)))
        pressed = (1.0 - stroke * (length - shortest) / (longest - shortest)) ** -self.POLYTROPIC
        return self._with(setting, -np.sin(angle) * theta[0] * pressed / length)

    def plausible(self, theta: Floats, rows: RestRows) -> bool:
        return bool(theta[0] > 0)

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        """Stiffness at the shortest length; `gas_stroke` = full stroke of the rod over the length of the gas column."""
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        values, errors = self._shape(theta[1:], std[1:])
        ratio = values["lever_ratio"]
        stroke = float(1.0 / (1.0 + np.exp(-theta[3])))
        slope = self.POLYTROPIC * stroke / (np.sqrt(1.0 + ratio) - np.sqrt(1.0 - ratio))
        unit = float(2.0 / (ratio * self.REACH_M**2) * slope)
        first = {"stiffness_n_m": float(theta[0]) * unit, "gas_stroke": stroke}
        return first | values, {"stiffness_n_m": float(std[0]) * unit} | errors


@dataclass(frozen=True, slots=True)
class CableTorque(_OnAxis):
    """A dress pack wound up by a wrist axis: linear in q about a neutral angle, or its first harmonic."""

    shape: str = "linear"
    name: ClassVar[str] = "cable_torque"
    parameters: ClassVar[tuple[str, ...]] = ("stiffness_nm_rad", "neutral_rad")
    units: ClassVar[tuple[str, ...]] = ("Nm/rad", "rad")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        q = rows.q_rad[:, self.axis]
        torque = theta[0] * q + theta[1] if self.shape == "linear" else theta[0] * np.sin(q) + theta[1] * np.cos(q)
        return replace(setting, passive_nm=_plus(setting.passive_nm, (slice(None), self.axis), torque))

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
class JointElasticity(_OnAxis):
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

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        return replace(setting, compliance_rad_nm=_plus(setting.compliance_rad_nm, self.axis, theta[0]))


@dataclass(frozen=True, slots=True)
class TorqueRipple(_OnAxis):
    """The reading swings `per_revolution` times per turn of the joint: motor or wave generator harmonics."""

    per_revolution: float = 100.0
    name: ClassVar[str] = "torque_ripple"
    parameters: ClassVar[tuple[str, ...]] = ("sine_nm", "cosine_nm")
    units: ClassVar[tuple[str, ...]] = ("Nm", "Nm")
    linear: ClassVar[tuple[bool, ...]] = (True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        angle = self.per_revolution * rows.q_rad[:, self.axis]
        swing = theta[0] * np.sin(angle) + theta[1] * np.cos(angle)
        return replace(setting, offset_nm=_plus(setting.offset_nm, (slice(None), self.axis), swing))

    def report(self, theta: Floats, covariance: Floats) -> tuple[dict[str, float], dict[str, float]]:
        amplitude = float(np.hypot(theta[0], theta[1]))
        slope = theta / max(amplitude, 1e-12)
        error = float(np.sqrt(max(slope @ covariance @ slope, 0.0)))
        phase = float(np.arctan2(theta[1], theta[0]))
        values = {"amplitude_nm": amplitude, "per_revolution": self.per_revolution, "phase_rad": phase}
        return values, {"amplitude_nm": error, "phase_rad": error / max(amplitude, 1e-12)}


@dataclass(frozen=True, slots=True)
class AxisCoupling(_Base):
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

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        mixing = np.eye(6)
        mixing[self.row, self.column] = theta[0]
        return replace(setting, coupling=mixing @ setting.coupling)


@dataclass(frozen=True, slots=True)
class LinkMass(_OnAxis):
    """A body [m, hx, hy, hz] bolted to one link; it is seen as far as the prior on the links says."""

    name: ClassVar[str] = "link_mass"
    parameters: ClassVar[tuple[str, ...]] = ("mass_kg", "first_x_kg_m", "first_y_kg_m", "first_z_kg_m")
    units: ClassVar[tuple[str, ...]] = ("kg", "kg m", "kg m", "kg m")
    linear: ClassVar[tuple[bool, ...]] = (True, True, True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (NAN, NAN, NAN, NAN)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
        part = slice(4 * self.axis, 4 * self.axis + 4)
        return replace(setting, link_extra=_plus(setting.link_extra, part, theta))


@dataclass(frozen=True, slots=True)
class PayloadShift(_Base):
    """The load's centre of gravity jumps at `time_s`, or drifts from then until `until_s`."""

    time_s: float
    until_s: float | None = None
    name: ClassVar[str] = "payload_shift"
    parameters: ClassVar[tuple[str, ...]] = ("shift_x_m", "shift_y_m", "shift_z_m")
    units: ClassVar[tuple[str, ...]] = ("m", "m", "m")
    linear: ClassVar[tuple[bool, ...]] = (True, True, True)
    SPREAD: ClassVar[tuple[float, ...]] = (0.2, 0.2, 0.2)

    def apply(self, setting: Setting, theta: Floats, rows: RestRows) -> Setting:
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
