"""Undeclared effects of the simulated arm.

Each effect is a function from one `Plant` to the next, written from the mechanism: a spring between two points, a cable
that is wound up, a compliant gear, an error of the reading chain. Nothing here depends on how effects are detected. The
names and the parameters of the library are those of the undeclared-effects file (`[[effect]] name, joints,
parameters`). Of a mechanism outside the library, the correct diagnosis is an unexplained structure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.cellfile import place_of
from sim.motor import AMBIENT_C
from sim.plant import Plant
from sim.urdf import MOST_AXES, turn_about

Array = NDArray[np.float64]
Transform = Callable[[Plant], Plant]
PointJacobian = Callable[[Array, int, Array], tuple[Array, Array]]

WARM_UP_K = 30.0
WARM_UP_TIME_S = 1800.0


class EffectError(ValueError):
    """An effect of the undeclared-effects file is not valid."""


@dataclass(frozen=True, slots=True)
class Request:
    """One effect as the file gives it.

    Attributes
    ----------
    name : name of the effect
    joints : joints counted from 1; empty for the base and the load
    parameters : SI values by name
    geometry : (q_rad (N,), link from 0, point (3,) in the link's frame) -> position (3,) and Jacobian (3, N)
    """

    name: str
    joints: tuple[int, ...]
    parameters: Mapping[str, object]
    geometry: PointJacobian | None = None

    def number(self, key: str, default: float | None = None) -> float:
        """Return one numeric parameter or its default; without a default it is required."""
        value = self.parameters.get(key, default)
        if not isinstance(value, (int, float)) or isinstance(value, bool) or not math.isfinite(value):
            raise EffectError(f"effect {self.name}: parameter {key} must be a finite number, got {value!r}")
        return float(value)

    def vector(self, key: str, default: Sequence[float]) -> Array:
        """Return a parameter of three numbers, or its default."""
        value = np.atleast_1d(np.asarray(self.parameters.get(key, default), dtype=float))
        if value.shape == (1,):
            value = np.array([value[0], 0.0, 0.0])
        if value.shape != (3,) or not np.all(np.isfinite(value)):
            raise EffectError(f"effect {self.name}: parameter {key} must hold three finite numbers")
        return value

    def jacobian(self) -> PointJacobian:
        """Return the geometry of the arm, for an effect that acts between it and its surroundings."""
        if self.geometry is None:
            raise EffectError(f"effect {self.name} needs the geometry of the arm")
        return self.geometry

    def axis(self) -> int:
        """Return the index (from 0) of the effect's only joint."""
        if len(self.joints) != 1:
            raise EffectError(f"effect {self.name} acts on one joint, got joints = {list(self.joints)}")
        return self.joints[0] - 1


def changed(values: Array, index: int | slice, change: Callable[[Array], Array | float]) -> Array:
    """A copy of the values, one of them (or all) as a function makes it."""
    copy = np.array(values, dtype=float)
    copy[index] = change(copy[index])
    return copy


def altered(name: str, index: int | slice, change: Callable[[Array], Array | float]) -> Transform:
    """Return the transform that changes one value (or all) of a field of the plant."""
    return lambda plant: replace(plant, **{name: changed(getattr(plant, name), index, change)})


def add_passive(plant: Plant, torque: Callable[[Array, float, Array], Array]) -> Plant:
    """A further torque on the joints."""
    earlier = plant.passive_torque
    if earlier is None:
        return replace(plant, passive_torque=torque)
    return replace(plant, passive_torque=lambda q, time_s, tau: earlier(q, time_s, tau) + torque(q, time_s, tau))


def add_reading(plant: Plant, error: Callable[[Array, Array], Array]) -> Plant:
    """A further error of the reading."""
    earlier = plant.reading_ripple
    if earlier is None:
        return replace(plant, reading_ripple=error)
    return replace(plant, reading_ripple=lambda q, u: earlier(q, u) + error(q, u))


def passive_on(axis: int, torque: Callable[[Array], float]) -> Transform:
    """Return the transform that adds a torque on one joint, a function of the joint angles."""

    def on_axis(q_rad: Array, _time_s: float, _tau_nm: Array) -> Array:
        out = np.zeros_like(q_rad)
        out[axis] = torque(q_rad)
        return out

    return lambda plant: add_passive(plant, on_axis)


def reading_on(axis: int, error: Callable[[float, float], float]) -> Transform:
    """Return the transform that adds an error to the reading of one axis, a function of its angle and torque."""

    def on_axis(q_rad: Array, torque_nm: Array) -> Array:
        out = np.zeros_like(q_rad)
        out[axis] = error(q_rad[axis], torque_nm[axis])
        return out

    return lambda plant: add_reading(plant, on_axis)


# ---------------------------------------------------------------------------------------------------------- friction


def static_friction(request: Request) -> Transform:
    """Add dry friction at rest: `bias_nm` against the approach direction."""
    axis, bias = request.axis(), request.number("bias_nm")
    kinetic = altered("coulomb_nm", axis, lambda value: value + bias)
    at_rest = altered("stiction_nm", axis, lambda value: value + abs(bias))
    return lambda plant: at_rest(kinetic(plant))


def load_dependent_friction(request: Request) -> Transform:
    """Add gear losses in proportion to the transmitted torque (Hamon, Gautier, Garrec 2010)."""
    nu = request.number("coefficient")
    return altered("load_friction", request.axis(), lambda value: value + nu)


def velocity_friction(request: Request) -> Transform:
    """Add Coulomb and viscous friction in motion."""
    axis = request.axis()
    coulomb, viscous = request.number("coulomb_nm", 0.0), request.number("viscous_nm_s_rad", 0.0)
    dry = altered("coulomb_nm", axis, lambda value: value + coulomb)
    wet = altered("viscous_nm_s_rad", axis, lambda value: value + viscous)
    return lambda plant: wet(dry(plant))


# ---------------------------------------------------------------------------------------------------------- geometry


def base_tilt(request: Request) -> Transform:
    """Tilt the base by the rotation vector (tilt_x, tilt_y, 0), which rotates gravity in the base frame."""
    vector = np.array([request.number("tilt_x_rad", 0.0), request.number("tilt_y_rad", 0.0), 0.0])

    def apply(plant: Plant) -> Plant:
        return replace(plant, gravity_m_s2=turn_about(vector).T @ plant.gravity_m_s2)

    return apply


def joint_zero_offset(request: Request) -> Transform:
    """Shift the link by `offset_rad` against the encoder."""
    offset = request.number("offset_rad")
    return altered("zero_offset_rad", request.axis(), lambda value: value + offset)


def joint_elasticity(request: Request) -> Transform:
    """Add gear elasticity: the gear twists under the transmitted torque."""
    compliance = request.number("compliance_rad_nm")
    return altered("compliance_rad_nm", request.axis(), lambda value: value + compliance)


# ------------------------------------------------------------------------------------------- bodies, springs, cables


def balancer_spring(request: Request) -> Transform:
    """A spring between link 2 (`lever_m` from axis 2) and the base (`anchor_m` from it); shortest at q2 = `phase_rad`.

    Coil: force `stiffness_n_m * (length - free_length_m)`. Gas (`gas_length_m` given): a gas column shortened
    by the pull, `force = F0 (1 - x / gas_length)^-1.3` with stiffness `stiffness_n_m` at its shortest length.
    """
    if request.joints not in ((2,), ()):
        raise EffectError(f"effect {request.name} acts on joint 2, got {list(request.joints)}")
    stiffness = request.number("stiffness_n_m")
    lever, anchor = request.number("lever_m", 0.2), request.number("anchor_m", 0.7)
    phase, free = request.number("phase_rad", 0.0), request.number("free_length_m", 0.4)
    gas = request.number("gas_length_m", 0.0)
    shortest = abs(anchor - lever)

    def force(length_m: float) -> float:
        if gas <= 0:
            return stiffness * (length_m - free)
        stroke = min((length_m - shortest) / gas, 0.95)
        return stiffness * gas / 1.3 * (1.0 - stroke) ** -1.3

    def torque(q_rad: Array) -> float:
        angle = q_rad[1] - phase
        length = math.sqrt(lever**2 + anchor**2 - 2.0 * lever * anchor * math.cos(angle))
        return -force(length) * lever * anchor * math.sin(angle) / length

    return passive_on(1, torque)


def cable_torque(request: Request) -> Transform:
    """Add the torque of a dress pack on one wrist axis: `-stiffness (q - neutral)`, or its sine ("harmonic")."""
    axis, stiffness = request.axis(), request.number("stiffness_nm_rad")
    neutral, harmonic = request.number("neutral_rad", 0.0), request.parameters.get("shape", "linear") == "harmonic"

    def torque(q_rad: Array) -> float:
        wound = q_rad[axis] - neutral
        return -stiffness * (math.sin(wound) if harmonic else wound)

    return passive_on(axis, torque)


def link_mass(request: Request) -> Transform:
    """A body of `mass_kg` with `first_moment_kg_m` in the link's frame, bolted to one link (a welder, a hose)."""
    link, mass = request.axis(), request.number("mass_kg", 0.0)

    def apply(plant: Plant) -> Plant:
        moment = request.vector("first_moment_kg_m", mass * plant.link_com_m[link])
        total = plant.link_mass_kg[link] + mass
        coms = plant.link_com_m.copy()
        coms[link] = (plant.link_mass_kg[link] * coms[link] + moment) / total
        masses = plant.link_mass_kg.copy()
        masses[link] = total
        return replace(plant, link_mass_kg=masses, link_com_m=coms)

    return apply


def payload_shift(request: Request) -> Transform:
    """Shift the load's centre of gravity by `shift_m` at `time_s`, or gradually over `duration_s`."""
    shift = request.vector("shift_m", (0.0, 0.0, 0.0))
    start, duration = request.number("time_s"), request.number("duration_s", 0.0)

    def moved(time_s: float) -> Array:
        if duration <= 0:
            return shift if time_s >= start else np.zeros(3)
        return shift * min(max((time_s - start) / duration, 0.0), 1.0)

    return lambda plant: replace(plant, payload_shift=moved)


# -------------------------------------------------------------------------------- reading chain: drives, motors, wiring


def torque_constant_scale(request: Request) -> Transform:
    """Scale the torque constant: the motor produces `scale` times the stated torque per ampere; no joints = all."""
    scale = request.number("scale")
    if scale <= 0:
        raise EffectError(f"effect {request.name}: scale must be positive, got {scale}")
    which = slice(None) if not request.joints else request.axis()
    return altered("torque_constant_scale", which, lambda value: value * scale)


def torque_offset(request: Request) -> Transform:
    """Add a constant offset to the current reading of one drive."""
    offset = request.number("offset_nm")
    return altered("reading_offset_nm", request.axis(), lambda value: value + offset)


def thermal_drift(request: Request) -> Transform:
    """Add drift of reading or friction with motor temperature (`per_k`) or with time since the start (`per_s`)."""
    axis = request.axis()
    per_k, per_s = request.number("per_k", 0.0), request.number("per_s", 0.0)
    on_friction = request.parameters.get("on", "torque_constant") == "friction"

    def apply(plant: Plant) -> Plant:
        temperature = plant.temperature_c or partial(warm_up, axes=plant.axes)
        start = np.asarray(temperature(0.0))[axis]
        earlier = plant.drift

        def drift(time_s: float) -> dict[str, object]:
            changes: dict[str, object] = dict(earlier(time_s)) if earlier else {}
            factor = 1.0 + per_k * (np.asarray(temperature(time_s))[axis] - start) + per_s * time_s
            if on_friction:
                for name in ("coulomb_nm", "stiction_nm"):
                    changes[name] = changed(changes.get(name, getattr(plant, name)), axis, lambda value: value * factor)  # type: ignore[arg-type]
            else:
                scale = changes.get("torque_constant_scale", plant.torque_constant_scale)
                changes["torque_constant_scale"] = changed(scale, axis, lambda value: value / factor)  # type: ignore[arg-type]
            return changes

        return replace(plant, drift=drift, temperature_c=temperature)

    return apply


def warm_up(time_s: float, axes: int = 6) -> Array:
    """Motor temperatures (N,) while an arm warms up; the wrist motors stay cooler [deg C]."""
    rise = WARM_UP_K * (1.0 - math.exp(-time_s / WARM_UP_TIME_S))
    return AMBIENT_C + rise * np.array([1.0, 1.1, 1.0, *[0.8] * (axes - 4), 0.7])[:axes]


def torque_ripple(request: Request) -> Transform:
    """Add a torque ripple to the reading of one axis, with `per_revolution` periods per joint revolution."""
    amplitude = request.number("amplitude_nm")
    periods, phase = request.number("per_revolution"), request.number("phase_rad", 0.0)
    return reading_on(request.axis(), lambda q, _u: amplitude * math.sin(periods * q + phase))


def axis_coupling(request: Request) -> Transform:
    """Motor j turns when joint i turns; axis i carries `coefficient` times the torque of axis j.

    Several couplings of one arm add up: each is a share of the torque that axis j has by itself.
    """
    if len(request.joints) != 2 or request.joints[0] == request.joints[1]:
        raise EffectError(f"effect {request.name} needs two joints [i, j], got {list(request.joints)}")
    row, column = request.joints[0] - 1, request.joints[1] - 1
    coefficient = request.number("coefficient")

    def apply(plant: Plant) -> Plant:
        coupling = plant.coupling.copy()
        coupling[row, column] += coefficient
        return replace(plant, coupling=coupling)

    return apply


def sign_reversed(request: Request) -> Transform:
    """Reverse the sign of the reported torque of one axis."""
    return altered("torque_sign", request.axis(), lambda value: -value)


def axes_swapped(request: Request) -> Transform:
    """Swap the drives of two axes."""
    if len(request.joints) != 2:
        raise EffectError(f"effect {request.name} needs two joints, got {list(request.joints)}")
    first, second = (joint - 1 for joint in request.joints)

    def apply(plant: Plant) -> Plant:
        order = plant.drive_joint.copy()
        order[[first, second]] = order[[second, first]]
        return replace(plant, drive_joint=order)

    return apply


def current_rms_peak(request: Request) -> Transform:
    """The drive's ampere is a peak value where an rms value is expected (factor sqrt 2), or the reverse."""
    which = slice(None) if not request.joints else request.axis()
    factor = request.number("factor", math.sqrt(2.0))
    return altered("current_factor", which, lambda value: value * factor)


# ------------------------------------------------------------------------------------------------------ off the library


def hardening_cable(request: Request) -> Transform:
    """A pack that is clamped in three places: torque `-amplitude cos(3 q + phase)` on one axis."""
    axis, amplitude, phase = request.axis(), request.number("amplitude_nm"), request.number("phase_rad", 0.0)
    return passive_on(axis, lambda q: -amplitude * math.cos(3.0 * q[axis] + phase))


def end_stop_buffer(request: Request) -> Transform:
    """A rubber buffer that is touched beyond `angle_rad`: torque grows with the square of the penetration."""
    axis, stiffness, angle = request.axis(), request.number("stiffness_nm_rad2"), request.number("angle_rad", 0.0)
    return passive_on(axis, lambda q: -stiffness * max(q[axis] - angle, 0.0) ** 2)


def linkage_spring(request: Request) -> Transform:
    """A spring between the upper arm's parallel link and the forearm: acts on axis 3 by the angle q2 + q3 + phase."""
    stiffness, phase = request.number("stiffness_nm"), request.number("phase_rad", 0.0)
    return passive_on(2, lambda q: -stiffness * math.sin(2.0 * (q[1] + q[2]) + phase))


def saturating_motor(request: Request) -> Transform:
    """Iron saturates: the reading of one axis exceeds the torque by `coefficient * |u| / reference_nm`."""
    coefficient, reference = request.number("coefficient"), request.number("reference_nm")
    return reading_on(request.axis(), lambda _q, u: coefficient * u * abs(u) / reference)


def eccentric_gear(request: Request) -> Transform:
    """The transmission ratio swings once per turn of the joint: reading error `coefficient * u * cos(q + phase)`."""
    coefficient, phase = request.number("coefficient"), request.number("phase_rad", 0.0)
    return reading_on(request.axis(), lambda q, u: coefficient * u * math.cos(q + phase))


def world_hose(request: Request) -> Transform:
    """A hose that pulls a point of one link with a constant force in a fixed direction of the base frame."""
    link, point, jacobian = request.axis(), request.vector("point_m", (0.0, 0.0, 0.0)), request.jacobian()
    force = request.vector("force_n", (0.0, 0.0, 0.0))

    def torque(q_rad: Array, _time_s: float, _tau_nm: Array) -> Array:
        return jacobian(q_rad, link, point)[1].T @ force

    return lambda plant: add_passive(plant, torque)


def bungee(request: Request) -> Transform:
    """An elastic cord from a fixed point of the cell to a point of one link; slack below its free length."""
    link, point, jacobian = request.axis(), request.vector("point_m", (0.0, 0.0, 0.0)), request.jacobian()
    hook, stiffness = request.vector("hook_m", (0.0, 0.0, 0.0)), request.number("stiffness_n_m")
    free = request.number("free_length_m", 0.0)

    def torque(q_rad: Array, _time_s: float, _tau_nm: Array) -> Array:
        position, jac = jacobian(q_rad, link, point)
        reach = hook - position
        length = float(np.linalg.norm(reach))
        return jac.T @ (stiffness * max(length - free, 0.0) * reach / max(length, 1e-9))

    return lambda plant: add_passive(plant, torque)


# --------------------------------------------------------------------------------------------------------------- tables


LIBRARY: dict[str, Callable[[Request], Transform]] = {
    "static_friction": static_friction,
    "load_dependent_friction": load_dependent_friction,
    "velocity_friction": velocity_friction,
    "base_tilt": base_tilt,
    "joint_zero_offset": joint_zero_offset,
    "torque_constant_scale": torque_constant_scale,
    "torque_offset": torque_offset,
    "thermal_drift": thermal_drift,
    "balancer_spring": balancer_spring,
    "cable_torque": cable_torque,
    "joint_elasticity": joint_elasticity,
    "torque_ripple": torque_ripple,
    "axis_coupling": axis_coupling,
    "link_mass": link_mass,
    "payload_shift": payload_shift,
    "sign_reversed": sign_reversed,
    "axes_swapped": axes_swapped,
    "current_rms_peak": current_rms_peak,
}
OFF_LIBRARY: dict[str, Callable[[Request], Transform]] = {
    "hardening_cable": hardening_cable,
    "end_stop_buffer": end_stop_buffer,
    "linkage_spring": linkage_spring,
    "saturating_motor": saturating_motor,
    "eccentric_gear": eccentric_gear,
    "world_hose": world_hose,
    "bungee": bungee,
}


def effect_from_dict(effect: Mapping[str, object], jacobian: PointJacobian | None = None) -> Transform:
    """Return the function that applies one effect to a plant.

    Parameters
    ----------
    effect : mapping with `name`, `joints` (from 1, may be absent) and `parameters` (SI, may be absent)
    jacobian : (q_rad (N,), link from 0, point (3,) in the link's frame) -> position (3,) and Jacobian (3, N);
        needed by effects that act between the arm and its surroundings

    Returns
    -------
    function Plant -> Plant

    Raises
    ------
    EffectError : unknown name, joints that do not fit, a parameter that is missing or not finite
    """
    name = str(effect.get("name"))
    joints = effect.get("joints", ())
    parameters = effect.get("parameters", {})
    if not isinstance(joints, (list, tuple)) or any(not isinstance(j, int) or not 1 <= j <= MOST_AXES for j in joints):
        raise EffectError(f"effect {name}: joints must be numbers from 1 to {MOST_AXES}, got {joints!r}")
    if not isinstance(parameters, Mapping):
        raise EffectError(f"effect {name}: parameters must be a table")
    effects = LIBRARY | OFF_LIBRARY
    if name not in effects:
        raise EffectError(f"unknown effect {name!r} (allowed: {', '.join(effects)})")
    transform = effects[name](Request(name, tuple(joints), parameters, jacobian))

    def apply(plant: Plant) -> Plant:
        if max(joints, default=1) > plant.axes:
            raise EffectError(f"effect {name}: joint {max(joints)} of an arm of {plant.axes} axes")
        return transform(plant)

    return apply


def apply_effects(
    plant: Plant,
    effects: Sequence[Mapping[str, object]],
    jacobian: PointJacobian | None = None,
    file: Path | None = None,
) -> Plant:
    """Apply effects to a plant in order; drifts last, because they scale the values set by the others.

    An error names the line of the effect in `file`, where they were read from one.
    """
    order = sorted(enumerate(effects, start=1), key=lambda entry: entry[1].get("name") == "thermal_drift")
    for number, effect in order:
        try:
            plant = effect_from_dict(effect, jacobian)(plant)
        except EffectError as error:
            raise EffectError(f"{place_of(file, 'effect', number)}: {error}" if file else str(error)) from error
    return plant
