"""Distance sensors on gripper 2 that look at planes of a part in gripper 1: rays cut with planes, by true poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NOISE_M = 5e-6


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Sensors (n, 3): origin and beam in gripper 2; planes (n, 3): point and normal in gripper 1. Lengths in m."""

    origin: Array
    beam: Array
    point: Array
    normal: Array


def six_sensors(e1_t_e2: Array, gap_m: float) -> Rig:
    """Beams along z (3), x (2) and y (1) of gripper 2, each a gap [m] from its plane at a relation (4, 4)."""
    origin = np.array(
        [
            [0.06, 0.0, 0.0],
            [-0.04, 0.05, 0.0],
            [-0.04, -0.05, 0.0],
            [0.0, 0.06, 0.02],
            [0.0, -0.06, 0.02],
            [0.05, 0.0, 0.03],
        ]
    )
    beam = np.array([[0.0, 0.0, 1.0]] * 3 + [[1.0, 0.0, 0.0]] * 2 + [[0.0, 1.0, 0.0]])
    turn = e1_t_e2[:3, :3]
    hit = (origin + gap_m * beam) @ turn.T + e1_t_e2[:3, 3]
    return Rig(origin, beam, hit, -beam @ turn.T)


def ranges(rig: Rig, first: Array, second: Array) -> Array:
    """Distances (m, n) [m] at true fingertips (m, 4, 4) of both arms in the world."""
    origin = np.einsum("mij,nj->mni", second[:, :3, :3], rig.origin) + second[:, None, :3, 3]
    beam = np.einsum("mij,nj->mni", second[:, :3, :3], rig.beam)
    point = np.einsum("mij,nj->mni", first[:, :3, :3], rig.point) + first[:, None, :3, 3]
    normal = np.einsum("mij,nj->mni", first[:, :3, :3], rig.normal)
    return np.sum((point - origin) * normal, axis=2) / np.sum(beam * normal, axis=2)
