"""Coordination by distance sensors: two hands keep a gap without contact (CN104379308 embodiment 5).

Sensors on one gripper measure the distance to planes on the other one. Their readings give the displacement of the
slave's fingertip from the demanded relation, in as many components as the sensors determine; only the selected ones are
corrected. Functions and learning are as with force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from gateway.errors import ConfigError
from gateway.pair.transform import Floats

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
#: Lever that makes turning comparable with moving [m].
LEVER_M = 0.1
LEAST_SINGULAR = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class DistanceSensors:
    """Distance sensors on one gripper, and the planes on the other gripper to which they measure.

    Attributes
    ----------
    origin_m, beam : arrays of shape (n, 3)
        Position and unit direction of a sensor, frame of the gripper that carries it.
    point_m, normal : arrays of shape (n, 3)
        A point of the plane and its unit normal, frame of the other gripper.
    on_master : array of bool of shape (n,)
        Carried by gripper 1; all by gripper 2 unless given.
    """

    origin_m: Floats
    beam: Floats
    point_m: Floats
    normal: Floats
    on_master: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def __post_init__(self) -> None:
        if len(self.on_master) != len(self.origin_m):
            object.__setattr__(self, "on_master", np.zeros(len(self.origin_m), dtype=bool))
        shapes = {np.shape(value) for value in (self.origin_m, self.beam, self.point_m, self.normal)}
        if len(shapes) != 1 or next(iter(shapes))[1:] != (3,):
            raise ConfigError(f"distance sensors: origin, beam, point and normal need one shape (n, 3), got {shapes}")
        for name, value in (("beam", self.beam), ("normal", self.normal)):
            if np.abs(np.linalg.norm(value, axis=1) - 1.0).max() > 1e-9:
                raise ConfigError(f"distance sensors: {name} needs unit vectors")

    def readings(self, e1_t_e2: ArrayLike) -> Floats:
        """Return the distances (n,) [m] along the beams at a relation (4, 4)."""
        origin, beam, point, normal = self._in_gripper_1(np.asarray(e1_t_e2, dtype=float))
        return np.sum(normal * (point - origin), axis=1) / np.sum(normal * beam, axis=1)

    def sensitivity(self, e1_t_e2: ArrayLike) -> Floats:
        """Return the change (n, 6) of the readings per displacement `[m; rad]` of fingertip 2, axes of gripper 1."""
        relation = np.asarray(e1_t_e2, dtype=float)
        origin, beam, _, normal = self._in_gripper_1(relation)
        facing = np.sum(normal * beam, axis=1, keepdims=True)
        spot = origin + self.readings(relation)[:, None] * beam - relation[:3, 3]
        away = np.where(self.on_master, 1.0, -1.0)[:, None] / facing
        return away * np.concatenate([normal, np.cross(spot, normal)], axis=1)

    def _in_gripper_1(self, relation: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return origin, beam, point and normal (n, 3), all in the frame of gripper 1."""
        turn, shift, there = relation[:3, :3].T, relation[:3, 3], self.on_master[:, None]
        return (
            np.where(there, self.origin_m, self.origin_m @ turn + shift),
            np.where(there, self.beam, self.beam @ turn),
            np.where(there, self.point_m @ turn + shift, self.point_m),
            np.where(there, self.normal @ turn, self.normal),
        )


class DistanceEstimator:
    """Remaining displacement of the slave's fingertip, from distances.

    Parameters
    ----------
    sensors : DistanceSensors
    wanted : array of shape (4, 4)
        Relation `E1_T_E2` at which every gap is as demanded.
    components : sequence of str
        Which of x, y, z, rx, ry, rz (axes of gripper 1) are measured and corrected.

    Attributes
    ----------
    sensors : DistanceSensors
    selection : array of shape (k, 6)
        Ones where a component is corrected.

    Raises
    ------
    ConfigError
        Unknown component, or one that the sensors do not determine.
    """

    def __init__(self, sensors: DistanceSensors, wanted: ArrayLike, components: Sequence[str] = COMPONENTS) -> None:
        unknown = [name for name in components if name not in COMPONENTS]
        if unknown or not components:
            raise ConfigError(f"distance sensors: components must be among {', '.join(COMPONENTS)}, got {components}")
        self.sensors = sensors
        self._wanted = np.array(wanted, dtype=float)
        chosen = [COMPONENTS.index(name) for name in components]
        self.selection = np.zeros((len(chosen), 6))
        self.selection[np.arange(len(chosen)), chosen] = 1.0
        scale = np.where(np.array(chosen) < 3, 1.0, LEVER_M)
        matrix = sensors.sensitivity(self._wanted) @ self.selection.T
        left, singular, right = np.linalg.svd(matrix / scale, full_matrices=False)
        if len(singular) < len(chosen) or singular[-1] < LEAST_SINGULAR:
            weak = components[int(np.argmax(np.abs(right[-1])))] if len(singular) == len(chosen) else components[-1]
            raise ConfigError(
                f"distance sensors: {len(matrix)} sensors do not determine component '{weak}'; leave it out or add one"
            )
        self._solve = self.selection.T @ ((right.T / singular @ left.T) / scale[:, None])
        self._demanded = sensors.readings(self._wanted)

    @property
    def demanded_m(self) -> Floats:
        """Return the demanded distances (n,) [m]."""
        return self._demanded.copy()

    def error(self, readings_m: ArrayLike) -> Floats:
        """Return the displacement (6,) `[m; rad]` that nulls the selected components, axes of gripper 1; else zero."""
        return -self._solve @ (np.asarray(readings_m, dtype=float) - self._demanded)

    def error_in_base(self, readings_m: ArrayLike, slave_command: ArrayLike) -> Floats:
        """Return the displacement (6,) in axes of the slave's base, near a slave command (4, 4)."""
        turn = np.asarray(slave_command, dtype=float)[:3, :3] @ self._wanted[:3, :3].T
        error = self.error(readings_m)
        return np.concatenate([turn @ error[:3], turn @ error[3:]])
