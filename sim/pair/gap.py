"""Distance sensors between two hands that do not touch: at the positions of the cell file, with true readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.cellfile import pose_of
from sim.measuring import FakeMeasuringDevice, MeasuringSite
from sim.pair.two_arms import TwoArms
from sim.pair.unit import PairUnit

Array = NDArray[np.float64]

#: What the sensors can measure, as a multiple of the largest distance the cell allows.
REACH = 1.5
NOISE_SEED, NOISE_M = 0xD157, 5e-6


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Sensors (n, 3): origin and beam in their hand; planes (n, 3): point and normal in the other hand. In metres."""

    origin: Array
    beam: Array
    point: Array
    normal: Array


def ranges(rig: Rig, first: Array, second: Array) -> Array:
    """Distances (m, n) [m] at true fingertips (m, 4, 4) in the world: of the other arm, and of the one with sensors."""
    origin = np.einsum("mij,nj->mni", second[:, :3, :3], rig.origin) + second[:, None, :3, 3]
    beam = np.einsum("mij,nj->mni", second[:, :3, :3], rig.beam)
    point = np.einsum("mij,nj->mni", first[:, :3, :3], rig.point) + first[:, None, :3, 3]
    normal = np.einsum("mij,nj->mni", first[:, :3, :3], rig.normal)
    return np.sum((point - origin) * normal, axis=2) / np.sum(beam * normal, axis=2)


class GapSensors:
    """All sensors of one device.

    Parameters
    ----------
    pair : table of the cell file
    world : both arms
    seed : of the noise
    """

    def __init__(self, pair: Mapping[str, Any], world: TwoArms, seed: int) -> None:
        self._world, self._random = world, np.random.default_rng([NOISE_SEED, seed])
        grasps = [pose_of(pair, f"{role}_grasp") for role in ("master", "slave")]
        #: Each hand in the other one: what a sensor on the master, on the slave looks at.
        one_in_two = np.linalg.inv(grasps[1]) @ grasps[0]
        self._wanted = (np.linalg.inv(one_in_two), one_in_two)
        channels = pair["distance"]["channel"]
        self._count = len(channels)
        self._rigs: list[tuple[int, list[int], Rig]] = []
        for carrier, role in enumerate(("master", "slave")):
            numbers = [n for n, one in enumerate(channels) if one.get("on", "slave") == role]
            if numbers:
                self._rigs.append((carrier, numbers, self._rig(carrier, [channels[n] for n in numbers])))

    def _rig(self, carrier: int, channels: list[Mapping[str, Any]]) -> Rig:
        origin = np.array([one["at_m"] for one in channels], dtype=float)
        beam = np.array([one["beam"] for one in channels], dtype=float)
        beam /= np.linalg.norm(beam, axis=1, keepdims=True)
        gap = np.array([[one["gap_m"]] for one in channels], dtype=float)
        carrier_in_other = np.linalg.inv(self._wanted[carrier])
        rotation, shift = carrier_in_other[:3, :3], carrier_in_other[:3, 3]
        return Rig(origin, beam, (origin + gap * beam) @ rotation.T + shift, -beam @ rotation.T)

    def true_m(self) -> Array:
        """Distances (n,) [m] at this instant."""
        tips = self._world.part.at(self._world.q).tips
        result = np.empty(self._count)
        for carrier, numbers, rig in self._rigs:
            result[numbers] = ranges(rig, tips[1 - carrier][None], tips[carrier][None])[0]
        return result

    def measured_m(self) -> list[float]:
        """The same with noise."""
        return (self.true_m() + self._random.normal(0.0, NOISE_M, self._count)).tolist()


def add_sensors(pair: Mapping[str, Any], unit: PairUnit, sensors: GapSensors) -> None:
    """Put the measuring device of a cell on the bus of an arm."""
    table = pair["distance"]
    channels = table["channel"]
    status = table.get("status_object")
    site = MeasuringSite(
        node_id=int(table["node_id"]),
        index=int(table["object"]),
        type=str(table["type"]),
        status_index=None if status is None else int(status),
        subindices=tuple(int(one["subindex"]) for one in channels),
        lsb_m=float(table["lsb_m"]),
        range_m=(0.0, REACH * float(table["range_m"][1])),
    )
    unit.instruments.append(FakeMeasuringDevice(site, sensors.measured_m, unit.put))
