"""Mechanisms outside the effect library: the correct diagnosis is an unexplained structure."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from sim.request import Array, Request, Transform, add_passive, passive_on, reading_on


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


OFF_LIBRARY: dict[str, Callable[[Request], Transform]] = {
    "hardening_cable": hardening_cable,
    "end_stop_buffer": end_stop_buffer,
    "linkage_spring": linkage_spring,
    "saturating_motor": saturating_motor,
    "eccentric_gear": eccentric_gear,
    "world_hose": world_hose,
    "bungee": bungee,
}
