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


def ranges(rig: Rig, first: Array, second: Array) -> Array:
    """Distances (m, n) [m] at true fingertips (m, 4, 4) of both arms in the world."""
    origin = np.einsum("mij,nj->mni", second[:, :3, :3], rig.origin) + second[:, None, :3, 3]
    beam = np.einsum("mij,nj->mni", second[:, :3, :3], rig.beam)
    point = np.einsum("mij,nj->mni", first[:, :3, :3], rig.point) + first[:, None, :3, 3]
    normal = np.einsum("mij,nj->mni", first[:, :3, :3], rig.normal)
    return np.sum((point - origin) * normal, axis=2) / np.sum(beam * normal, axis=2)
