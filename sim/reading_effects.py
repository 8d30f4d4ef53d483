"""Effects of the reading chain: errors of drives, motors and wiring in the reported torque.

Each is a function from one `Plant` to the next, as in `sim.effects`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from sim.plant import Plant
from sim.request import Array, EffectError, Request, Transform, altered, changed, reading_on

WARM_UP_K = 30.0
WARM_UP_TIME_S = 1800.0
AMBIENT_C = 25.0


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
