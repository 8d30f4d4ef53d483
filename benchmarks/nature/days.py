"""Repeated measurements of one load over three days: cold and warm motors, remounted loads, other poses.

The flux of a magnet falls reversibly with its temperature, by 0.04 % (SmCo) or 0.11 % (NdFeB) per kelvin, so a warm
motor draws more current for a torque. The stated constants hold at 25 deg C. Copper losses heat a motor: the rise in
steady state is that at rated torque times (torque / rated torque)^2, reached with one time constant. While a load is
mounted the brakes hold and the motors cool. On a morning they have the temperature of the hall.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.nature.effect import SIDE_S, Mechanism, TableRows
from benchmarks.nature.measuring import measure
from benchmarks.nature.nature_cell import CHANGE_S, VISIT_S, NatureCell
from sim.offline import PlannedVisit
from sim.plant import Payload

Array = NDArray[np.float64]

DAYS, DAY_S = 3, 8 * 3600.0
STATED_AT_C = 25.0
#: Loss of flux per kelvin of the magnet materials of servo motors, and how much the motors of an arm differ.
FLUX_PER_K, FLUX_SPREAD = (0.0004, 0.0011), 0.1
#: Rise of the magnets at rated torque [K] (windings of class F: 100 K), and its time constant [s].
RISE_K, RISE_S = (40.0, 70.0), (1200.0, 3600.0)
#: Temperature of the hall on a morning [deg C], and how much it rises over a day [K].
MORNING_C, WARMER_K = (18.0, 24.0), (0.0, 4.0)
#: Pause between two measurements of one day, the brakes hold [s].
PAUSE_S = (300.0, 1800.0)
#: Standard deviation of the place where a load is mounted again, along each axis [m].
REMOUNTED_M = 0.0002
POSES = (10, 15)


@dataclass(frozen=True, slots=True)
class LoadMeasurement:
    """One measurement: rows as `sim.offline.measure` gives them, the mounted load, and the day from 1."""

    columns: dict[str, NDArray[Any]]
    tool: Payload
    day: int


@dataclass(slots=True)
class DayMotors:
    """Temperature of the motors over one day.

    Attributes
    ----------
    per_k : (6,) growth of the current per kelvin
    rise_k, rise_s : (6,) rise at rated torque, and its time constant
    rated_nm : (6,)
    morning_c, warmer_k : temperature of the hall, and its rise over the day
    above_k, now_s : (6,) state: temperature above the hall, and its time
    """

    per_k: Array
    rise_k: Array
    rise_s: Array
    rated_nm: Array
    morning_c: float
    warmer_k: float
    above_k: Array = field(default_factory=lambda: np.zeros(6))
    now_s: float = 0.0

    def read(self, rows: TableRows, torque_nm: Array) -> Array:
        """Return reported torques (n, 6) [Nm] of rows in the order of time, and warm up along them."""
        out = np.empty_like(torque_nm)
        for row, (time_s, torque) in enumerate(zip(rows.time_s, torque_nm, strict=True)):
            braked_s = max(time_s - self.now_s - (VISIT_S - SIDE_S), 0.0)
            self._approach(0.0 * torque, braked_s)
            self._approach(self.rise_k * (torque / self.rated_nm) ** 2, time_s - self.now_s - braked_s)
            self.now_s = time_s
            motor_c = self.morning_c + self.warmer_k * time_s / DAY_S + self.above_k
            out[row] = torque * (1.0 + self.per_k * (motor_c - STATED_AT_C))
        return out

    def _approach(self, final_k: Array, seconds: float) -> None:
        self.above_k = final_k + (self.above_k - final_k) * np.exp(-seconds / self.rise_s)


def sessions(cell: NatureCell, count: int) -> Iterator[LoadMeasurement]:
    """Yield `count` measurements of the cell's load over three days, in their order."""
    rng = np.random.default_rng([cell.seed, 53])
    per_k = rng.choice(FLUX_PER_K) * (1.0 + FLUX_SPREAD * rng.uniform(-1.0, 1.0, 6))
    rise_k, rise_s = rng.uniform(*RISE_K, 6), rng.uniform(*RISE_S, 6)
    for day, streams in enumerate(np.array_split(np.arange(count), DAYS), start=1):
        motors = DayMotors(per_k, rise_k, rise_s, cell.arm.rated_nm, rng.uniform(*MORNING_C), rng.uniform(*WARMER_K))
        effects = (*cell.effects, Mechanism("warm_motors", (), 0.0, on_reading=motors.read))
        start_s = float(rng.uniform(0.0, 300.0))
        for stream in streams:
            tool = replace(cell.arm.tool, com_m=cell.arm.tool.com_m + REMOUNTED_M * rng.standard_normal(3))
            visits = _visits(cell.poses(int(rng.integers(*POSES)), 100 + int(stream)), start_s)
            columns, _ = measure(replace(cell.arm, tool=tool), visits, effects, rng)
            yield LoadMeasurement(columns, tool, day)
            start_s = visits[-1].time_s + VISIT_S + float(rng.uniform(*PAUSE_S))


def _visits(poses: Array, start_s: float) -> list[PlannedVisit]:
    """Plan all poses without the load, then all with it."""
    loaded_s = start_s + VISIT_S * len(poses) + CHANGE_S
    return [
        PlannedVisit(pose, load, first_s + VISIT_S * pose, q)
        for load, first_s in (("none", start_s), ("tool", loaded_s))
        for pose, q in enumerate(poses)
    ]
