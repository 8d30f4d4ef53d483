"""Drawn arms measured until their load is known well enough, straight from the physics: do the intervals still hold?

A rule that stops when the interval is narrow stops more often where the noise happens to look small. Every cell is
also measured at ten poses that were chosen beforehand, as the interval of a run without a rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind.drawn_arm import draw_arm
from gateway.acquire.until_goal import Goal, best_first, half_widths, judge
from gateway.data.table import Table, concatenate
from gateway.estimate.estimate import Estimate
from gateway.estimate.expected_information import Sought, Stock, take_stock
from gateway.estimate.joint import estimate_joint
from gateway.identify.knowledge import Knowledge
from gateway.identify.outliers import without_outliers
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import robot_from_urdf
from gateway.model.visits import Visits, pair_visits
from sim.draw import DrawnArm, choose_poses
from sim.offline import PlannedVisit, measure
from sim.plant import Plant
from tests.support.rigs.tables import simulated_table

LABEL = "tool"
BARE_POSES = 14
CANDIDATES = 200
PERIOD_S, MOST_SAMPLES = 0.01, 100
SPEED_RAD_S, RAMP_S, SIDES_S = 0.5, 0.6, 3.0
STEP_S = 25.0
APART_RAD = 0.3
GAIN_STD = (0.0, 0.02)


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """One cell: errors (4,) over their standard deviations of both runs, and how the rule ended."""

    stopped: np.ndarray
    fixed: np.ndarray
    reached: bool
    poses: int
    samples: int


class Cell:
    """An arm with a load, gains and biases drawn from the priors, and the time that runs."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([seed, 77])
        arm: DrawnArm = draw_arm(self.rng)
        gain_std = GAIN_STD[seed % len(GAIN_STD)]
        gain = 1.0 + gain_std * self.rng.standard_normal(6)
        bias = 0.1 * arm.plant.coulomb_nm * self.rng.standard_normal(6)
        self.arm, self.now_s = arm, 0.0
        self.plant: Plant = replace(arm.plant, torque_constant_scale=1.0 / gain, friction_bias_nm=bias)
        self.robot = robot_from_urdf(arm.urdf, "drawn")
        self.options = Knowledge(link_std=0.05, gain_std=(gain_std,) * 6, efficiency=tuple(arm.efficiency.tolist()))
        self.goal = Goal(
            mass_share=float(np.exp(self.rng.uniform(np.log(0.004), np.log(0.04)))),
            com_m=float(np.exp(self.rng.uniform(np.log(0.001), np.log(0.006)))),
        )
        self.poses = choose_poses(arm.chain, arm.floor_nm, arm.prior_std, BARE_POSES, self.rng)

    def table(self, q_rad: np.ndarray, load: str, first: int, samples: int) -> Table:
        """Poses (n, 6) measured one after another."""
        visits = []
        for number, q in enumerate(q_rad, start=first):
            visits.append(PlannedVisit(number, load, self.now_s, q))
            self.now_s += STEP_S
        protocol = replace(self.arm.protocol, samples=samples)
        return simulated_table(measure(self.arm.chain, self.plant, visits, self.arm.loads, protocol, self.rng))

    def visits(self, parts: list[Table]) -> tuple[Visits, np.ndarray]:
        """Sound visits, and the standard deviation of a sample by axis."""
        table = concatenate(parts)
        visits = pair_visits(table, self.options.efficiency)
        sound, _ = without_outliers(visits, self.robot, self.options.gravity_m_s2)
        return sound, np.nanmedian(table.tau_std_nm, axis=0)

    def error(self, load: object) -> np.ndarray:
        """Errors (4,) of mass and centre of gravity over their standard deviations."""
        truth = self.arm.loads[LABEL]
        off = np.append(load.mass_kg - truth.mass_kg, load.com_m - truth.com_m)
        return off / np.append(load.mass_std_kg, load.com_std_m)


def run(seed: int) -> Outcome:
    """Both runs of one cell."""
    cell = Cell(seed)
    bare = cell.table(cell.poses, "none", 1, MOST_SAMPLES)
    fixed = _estimate(cell, [bare, cell.table(cell.poses, LABEL, 1, MOST_SAMPLES)])
    stock, reached, poses, samples = _until(cell, bare)
    assert stock.load is not None
    return Outcome(
        stopped=cell.error(stock.load),
        fixed=cell.error(fixed.loads[0]),
        reached=reached,
        poses=poses,
        samples=samples,
    )


def _estimate(cell: Cell, parts: list[Table]) -> Estimate:
    return estimate_joint(cell.visits(parts)[0], cell.robot, cell.options)


def _until(cell: Cell, bare: Table) -> tuple[Stock, bool, int, int]:
    """The load pose by pose, until the rule says stop."""
    chain = cell.arm.chain
    q_rad = cell.rng.uniform(0.95 * chain.lower_rad, 0.95 * chain.upper_rad, (CANDIDATES, 6))
    regressor = gravity_regressor(cell.robot, q_rad)
    guess = np.array([2.0 * cell.arm.loads[LABEL].mass_kg, 0.0, 0.0, 0.0])
    parts, taken, at, samples = [bare], [], cell.poses[-1], MOST_SAMPLES
    while True:
        visits, noise_nm = cell.visits(parts)
        stock = take_stock(visits, cell.robot, cell.options, Sought(LABEL, guess, noise_nm))
        mass_kg = float(stock.information.moment[0])
        half, goal = half_widths(stock.load), cell.goal.half_widths(mass_kg)
        verdict = judge(stock.information, half, goal, len(taken), regressor, MOST_SAMPLES)
        if verdict.done:
            return stock, bool(verdict.reached.all()), len(taken), samples
        seconds = np.abs(q_rad - at).max(axis=1) / SPEED_RAD_S + RAMP_S + SIDES_S
        near = np.abs(q_rad[:, None] - q_rad[taken][None]).max(axis=2, initial=0.0) < APART_RAD
        rows, samples = best_first(
            stock.information, verdict, regressor, np.where(near.any(axis=1), np.inf, seconds), PERIOD_S, MOST_SAMPLES
        )
        row = int(rows[0])
        taken.append(row)
        at = q_rad[row]
        parts.append(cell.table(at[None], LABEL, 100 + len(taken), samples))
