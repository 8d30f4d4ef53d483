"""One arm and one load offline: drawn, moved bare and loaded, estimated, held against what is there."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.moving.excitations import random_series
from benchmarks.moving.oracle import oracle_std
from benchmarks.moving.scores import drawn_truth, score
from benchmarks.nature.levels import levels_of
from benchmarks.nature.moving_arm import MovingArm, StatedMoving, draw_moving_arm
from benchmarks.nature.moving_cell import PeriodicMotion, measure_moving
from benchmarks.nature.moving_effects import MovingEffect
from gateway.data.rows import MOVING, Table, concatenate
from gateway.errors import GatewayError
from gateway.estimate import run
from gateway.excite.excitation import Series, fingerprint
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import robot_from_urdf
from tests.support.rigs.tables import make_table

Floats = NDArray[np.float64]

STREAM = 77
PERIOD_S, PERIODS, RATE_HZ = 10.0, 3, 100.0
#: Harmonics that are looked for in the position.
STATED_HARMONICS = 10
#: Standard deviations of a gain that all axes have in common, and of each axis's own, where gains are known as ratios.
COMMON_GAIN, OWN_GAIN = 0.02, 0.01
#: Tiers by what is known of the torque constants.
TIERS = ("known", "stated", "ratios")


@dataclass(frozen=True, slots=True)
class MovingCell:
    """One arm with its runs, as it is and as its owner states it; `gain_std` None = the owner states nothing.

    `effect` is a mechanism that is not stated."""

    seed: int
    tier: str
    arm: MovingArm
    stated: StatedMoving
    gain_std: tuple[float, ...] | None
    series: Series
    rate_hz: float
    start_s: dict[str, float]
    effect: MovingEffect | None = None

    @property
    def motion(self) -> PeriodicMotion:
        """The motion of both runs."""
        return PeriodicMotion(
            self.series.at, self.series.period_s, self.series.periods, self.rate_hz, STATED_HARMONICS,
            fingerprint(self.series),
        )  # fmt: skip

    @property
    def link_std(self) -> float:
        """Relative standard deviation of the links."""
        return self.stated.link_std

    @property
    def knowledge(self) -> Knowledge:
        """What the owner states."""
        return Knowledge(
            link_std=self.link_std,
            gain_std=self.gain_std,
            efficiency=tuple(self.stated.efficiency.tolist()),
        )

    def table(self) -> Table:
        """Rows of the bare and of the loaded run."""
        return concatenate([self.run(label) for label in self.start_s])

    def run(self, label: str) -> Table:
        """Rows of one of both runs."""
        rng = np.random.default_rng([self.seed, STREAM, 1 + list(self.start_s).index(label)])
        return moving_table(measure_moving(self.arm, self.motion, label, self.start_s[label], rng, self.effect))


def moving_table(columns: dict[str, NDArray[Any]]) -> Table:
    """The columns of `benchmarks.nature.moving_cell`: rows of moving runs."""
    return make_table(
        columns["load"],
        np.full(len(columns["load"]), MOVING),
        columns["q_rad"],
        columns["tau_nm"],
        file="moving",
        run=columns["run"],
        time=columns["time_s"],
        qd=columns["qd_rad_s"],
        qdd=columns["qdd_rad_s2"],
        extra={name: values for name, values in columns.items() if name.startswith("x_")},
    )


def draw_cell(
    seed: int, tier: str, condition: str = "base", periods: int = PERIODS, rate_hz: float = RATE_HZ
) -> MovingCell:
    """Cell of a seed in a tier.

    Raises
    ------
    ValueError
        No such tier.
    """
    if tier not in TIERS:
        raise ValueError(f"tier {tier}: one of {', '.join(TIERS)}")
    rng = np.random.default_rng([seed, STREAM])
    arm, stated = draw_moving_arm(levels_of(condition), rng)
    series = random_series(arm, PERIOD_S, periods, rng)
    begin = float(rng.uniform(1800.0, 5400.0))
    start_s = {"none": begin, "tool": begin + float(rng.uniform(120.0, 480.0)) + periods * PERIOD_S}
    arm, gain_std = _gains(arm, tier, rng)
    return MovingCell(seed, tier, arm, stated, gain_std, series, rate_hz, start_s)


def _gains(arm: MovingArm, tier: str, rng: np.random.Generator) -> tuple[MovingArm, tuple[float, ...] | None]:
    """The arm with the gains of a tier, and what is stated of them."""
    axes = len(arm.gain)
    if tier == "known":
        return replace(arm, gain=np.zeros(axes), gain_std=np.zeros(axes)), (0.0,) * axes
    if tier == "stated":
        return arm, tuple(arm.gain_std.tolist())
    gain = COMMON_GAIN * rng.standard_normal() + OWN_GAIN * rng.standard_normal(axes)
    return replace(arm, gain=gain, gain_std=np.full(axes, float(np.hypot(COMMON_GAIN, OWN_GAIN)))), None


def run_cell(task: tuple[int, str]) -> dict:
    """Score of a cell: seed and tier."""
    cell = draw_cell(*task)
    table, robot = cell.table(), robot_from_urdf(cell.stated.urdf, f"seed {cell.seed}")
    begin, refused, result = time.process_time(), "", None
    try:
        result = run(table, robot, cell.knowledge)
    except GatewayError as error:
        refused = str(error)
    taken_s = time.process_time() - begin
    return {
        "seed": cell.seed,
        "tier": cell.tier,
        "refused": refused,
        "time_s": taken_s,
        **score(drawn_truth(cell.arm, cell.motion, cell.start_s, oracle_std(cell)), result),
    }
