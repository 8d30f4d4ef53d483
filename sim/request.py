"""Undeclared effect as stated in its file, and addition of effects of the same kind in a plant."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.plant import Plant

Array = NDArray[np.float64]
Transform = Callable[[Plant], Plant]
PointJacobian = Callable[[Array, int, Array], tuple[Array, Array]]


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
