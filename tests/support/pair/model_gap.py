"""Numpy tier of the distance sensors: a gap that is kept along the path without touching."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.pair.controller import PairController
from gateway.pair.distance import COMPONENTS, DistanceEstimator, DistanceSensors
from gateway.pair.embodiments import EMBODIMENTS
from gateway.pair.relation import slave_command
from gateway.pair.transform_function import constant_function, sampled
from sim.pair.errors import PairErrors, draw
from sim.pair.kinetostatic import KinetostaticPair
from sim.pair.ranges import NOISE_M, Rig, ranges, six_sensors
from tests.support.pair.model_rig import BASES, FIXED, Track, calibration, joints_of, track

Array = NDArray[np.float64]
GAP_M = 0.005
ROW = EMBODIMENTS["E5"]
STILL = replace(ROW, corrects="none", learning=None)
CYCLES = 4
#: Distances pass no filter.
LOOP_TIME_S = 0.024
SPEED = 1.5


@dataclass(frozen=True, slots=True)
class GapFigures:
    """Largest error of any demanded gap [m] along the path: without correction, and per cycle with learning."""

    seed: int
    sensors: int
    without_m: float
    cycles_m: tuple[float, ...]


def gaps(seeds: Sequence[int], components: Sequence[str] = COMPONENTS, speed: float = SPEED) -> list[GapFigures]:
    """Run the pair with distance sensors, all seeds.

    Parameters
    ----------
    seeds : sequence of int
    components : which displacements are measured and corrected; fewer take fewer sensors
    speed : speed setting
    """
    on, rig = track(speed), sensors_for(components)
    errors = [draw(seed, BASES) for seed in seeds]
    fixed = sampled(constant_function(FIXED), on.path.s_m[on.path.uniform(ROW.points)])
    known = replace(calibration(), loop_time_s=LOOP_TIME_S)
    still = [PairController(STILL, on.path, known, fixed) for _ in seeds]
    yielding = [PairController(ROW, on.path, known, fixed) for _ in seeds]
    without = _cycle(on, errors, still, rig, components, 0)
    each = [_cycle(on, errors, yielding, rig, components, cycle) for cycle in range(1, CYCLES + 1)]
    return [
        GapFigures(seed, len(rig.origin), float(without[i]), tuple(float(cycle[i]) for cycle in each))
        for i, seed in enumerate(seeds)
    ]


def sensors_for(components: Sequence[str]) -> Rig:
    """All six sensors, or the three that look along z for what these determine."""
    rig = six_sensors(FIXED, GAP_M)
    count = 6 if set(components) - {"z", "rx", "ry"} else 3
    return Rig(rig.origin[:count], rig.beam[:count], rig.point[:count], rig.normal[:count])


def _cycle(
    on: Track,
    errors: Sequence[PairErrors],
    controllers: Sequence[PairController],
    rig: Rig,
    components: Sequence[str],
    cycle: int,
) -> Array:
    """Largest gap error (n,) [m] of one cycle."""
    estimator = DistanceEstimator(DistanceSensors(rig.origin, rig.beam, rig.point, rig.normal), FIXED, components)
    plant = KinetostaticPair(on.constants, errors, [on.stiffness(item) for item in errors])
    noise = np.random.default_rng([errors[0].seed, cycle, 0xD1]).normal(
        0.0, NOISE_M, (len(on.path), 1, len(rig.origin))
    )
    for controller in controllers:
        controller.start_cycle()
    first = on.path.commands[0]
    start = [(first, slave_command(BASES[0], first, BASES[1], item.function.at(0.0))) for item in controllers]
    q = joints_of(on, start, np.broadcast_to(on.constants.q_rad[0], (len(errors), 2, 6)))
    plant.place(q)
    silent = np.zeros((2, 6))
    before = seen = ranges(rig, *plant.tips())
    worst = np.zeros(len(errors))
    for m in range(len(on.path)):
        slave = slave_command(BASES[0], on.path.commands[m], BASES[1], FIXED)
        commands = [
            item.step(m, None, estimator.error_in_base(before[row], slave)) for row, item in enumerate(controllers)
        ]
        q = joints_of(on, commands, q + on.constants.q_rad[m] - on.constants.q_rad[max(m - 1, 0)])
        plant.step(m, q, silent)
        true = ranges(rig, *plant.tips())
        worst = np.maximum(worst, np.abs(true - estimator.demanded_m).max(axis=1))
        before, seen = seen, true + noise[m]
    for controller in controllers:
        controller.end_cycle(complete=True)
    return worst
