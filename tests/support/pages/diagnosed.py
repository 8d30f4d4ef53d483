"""Rare results: a formula for what is in no library, and a pair of effects that further poses decide."""

from __future__ import annotations

from functools import cache

import numpy as np

from gateway.diagnose import close_loop
from gateway.result.result import Result
from tests.data.resting_arm import Bench, effect


@cache
def with_formula() -> Result:
    """A linkage spring, which is in no library: its closed form is 120 sin(2 q2 + 2 q3 + 0.4) Nm on axis 3."""
    bench = Bench(3, [effect("linkage_spring", [3], stiffness_nm=120.0, phase_rad=0.4)])
    return close_loop(bench.both(), bench.robot, bench.options, bench.more, bench.poses[:4] + 0.2)[0]


@cache
def decided() -> Result:
    """A cable on axis 5, measured at five poses within 9 deg of that axis: an offset explains them as well."""
    stiffness, neutral, half_rad = 3.2, -0.4, 0.08
    bench = Bench(27, [effect("cable_torque", [5], stiffness_nm_rad=stiffness, neutral_rad=neutral)], poses=5)
    bench.poses[:, 4] = bench.poses[0, 4] + np.linspace(-half_rad, half_rad, 5)
    choice = np.random.default_rng(27).uniform(-1.5, 1.5, (150, 6))
    validation_rad = bench.poses[:3] + 0.3
    return close_loop(bench.both(), bench.robot, bench.options, bench.more, validation_rad, pose_choice=choice)[0]
