"""Undeclared effects of the simulated arm.

Each effect is a function from one `Plant` to the next, written from the mechanism: a spring between two points, a cable
that is wound up, a compliant gear. Nothing here depends on how effects are detected. The names and the parameters
of the library are those of the undeclared-effects file (`[[effect]] name, joints, parameters`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim.off_library import OFF_LIBRARY
from sim.plant import Plant
from sim.reading_effects import (
    axes_swapped,
    axis_coupling,
    current_rms_peak,
    sign_reversed,
    thermal_drift,
    torque_constant_scale,
    torque_offset,
    torque_ripple,
)
from sim.request import Array, EffectError, PointJacobian, Request, Transform, altered, passive_on
from sim.urdf import MOST_AXES, turn_about

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
    plant: Plant, effects: Sequence[Mapping[str, object]], jacobian: PointJacobian | None = None
) -> Plant:
    """Apply effects to a plant in order; drifts last, because they scale the values set by the others."""
    for effect in sorted(effects, key=lambda effect: effect.get("name") == "thermal_drift"):
        plant = effect_from_dict(effect, jacobian)(plant)
    return plant


__all__ = [
    "LIBRARY",
    "OFF_LIBRARY",
    "EffectError",
    "Request",
    "apply_effects",
    "effect_from_dict",
]
