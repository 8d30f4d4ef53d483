"""Outlier rest visits: found where a test has put them, nothing else thrown out, whatever the arm itself does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from benchmarks.blind.drawn_arm import LOADED_S, POSES, VISIT_S, draw_arm
from gateway.estimate import estimate
from gateway.identify.knowledge import Knowledge
from gateway.identify.outliers import Outliers, find_outliers
from gateway.model.regressor import gravity_regressor
from gateway.model.robot import robot_from_urdf
from gateway.model.visits import pair_visits
from sim.blind import scaled
from sim.draw import choose_poses
from sim.draw_effects import MAKERS, OFF_MAKERS
from sim.effects import apply_effects
from sim.offline import PlannedVisit, measure, point_jacobian
from tests.support.rigs.tables import simulated_table

FROM_BELOW = slice(0, None, 2)
#: What is added to the torque from below and from above, in the size of the disturbance.
KINDS = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, -1.0))
#: An arm without losses in its gears.
LOSSLESS = 1


@dataclass
class Measured:
    """A simulated arm, its measured columns, and where the test has made them outliers."""

    seed: int
    effect: str | None = None
    loads: tuple[str, ...] = ("none", "tool")
    strength: float = 10.0

    def __post_init__(self):
        rng = np.random.default_rng([self.seed, 5])
        self.arm = draw_arm(rng)
        poses = choose_poses(self.arm.chain, self.arm.floor_nm, self.arm.prior_std, POSES, rng)
        self.visits = [
            PlannedVisit(k, load, LOADED_S * place + VISIT_S * k, q)
            for place, load in enumerate(self.loads)
            for k, q in enumerate(poses)
        ]
        plant = self.arm.plant
        if self.effect is not None:
            maker = (MAKERS | OFF_MAKERS)[self.effect]
            built, _ = scaled(self.arm, self.visits, maker, self.strength, rng)
            plant = apply_effects(plant, [built], point_jacobian(self.arm.chain))
        self.columns = measure(self.arm.chain, plant, self.visits, self.arm.loads, self.arm.protocol, rng)
        self.robot = robot_from_urdf(self.arm.urdf, "drawn")
        self.outliers: set[tuple[int, int]] = set()

    def disturb(self, count: int, rng: np.random.Generator, sizes: tuple[float, float] = (4.0, 10.0)) -> None:
        """Outlier torques at `count` visits, by so many friction bands: one axis, or all at once."""
        visits = rng.choice(len(self.visits), count, replace=False)
        for visit in visits:
            for axis in [int(rng.integers(6))] if rng.random() < 0.7 else range(6):
                self.push(int(visit), axis, KINDS[rng.integers(4)], rng.uniform(*sizes) * rng.choice([-1.0, 1.0]))

    def push(self, visit: int, axis: int, kind: tuple[float, float], bands: float) -> None:
        """Outlier torque at one visit and axis."""
        if kind[0] == -kind[1]:
            bands = abs(bands)
        for side in (0, 1):
            self.columns["tau_nm"][2 * visit + side, axis] += kind[side] * bands * self.arm.plant.coulomb_nm[axis]
        self.outliers.add((visit, axis))

    @property
    def table(self):
        return simulated_table(self.columns)

    def found(self) -> Outliers:
        visits = pair_visits(self.table, self.arm.efficiency)
        return find_outliers(visits, self.robot, (0.0, 0.0, -9.80665))


def entries(outliers: Outliers) -> set[tuple[int, int]]:
    return set(map(tuple, np.argwhere(outliers.mask).tolist()))


@pytest.mark.slow
@pytest.mark.parametrize("loads", [("none", "tool"), ("none",)])
def test_outlier_visits_are_found_and_sound_ones_kept(loads):
    there = found = wrong = sound = 0
    for seed in range(10):
        measured = Measured(seed, loads=loads)
        measured.disturb(1, np.random.default_rng([seed, 6]))
        said = entries(measured.found())
        there, found = there + len(measured.outliers), found + len(said & measured.outliers)
        wrong, sound = wrong + len(said - measured.outliers), sound + 6 * len(measured.visits) - len(measured.outliers)
    assert found >= 0.95 * there
    assert wrong <= 0.01 * sound


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    ["balancer_spring", "cable_torque", "torque_ripple", "joint_zero_offset", "base_tilt", "axis_coupling",
     "payload_shift", "end_stop_buffer", "bungee", "sign_reversed"],
)  # fmt: skip
def test_effects_of_the_arm_itself_are_not_outliers(effect):
    wrong = sound = 0
    for seed in range(100, 101):
        measured = Measured(seed, effect, strength=20.0)
        wrong += len(entries(measured.found()))
        sound += 6 * len(measured.visits)
    assert wrong <= 0.01 * sound


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["balancer_spring", "cable_torque", "torque_ripple"])
def test_outlier_visits_are_found_beside_an_effect(effect):
    there = found = 0
    for seed in range(120, 122):
        measured = Measured(seed, effect)
        measured.disturb(1, np.random.default_rng([seed, 6]))
        there, found = there + len(measured.outliers), found + len(entries(measured.found()) & measured.outliers)
    assert found >= 0.95 * there


@pytest.mark.slow
def test_the_answer_moves_less_than_half_a_standard_deviation():
    moved = []
    for seed in range(6):
        measured = Measured(seed)
        options = Knowledge(link_std=0.05, efficiency=tuple(measured.arm.efficiency))
        before = estimate(measured.table, measured.robot, options).loads[0]
        measured.disturb(1, np.random.default_rng([seed, 8]))
        found = estimate(measured.table, measured.robot, options)
        after = found.loads[0]
        assert {(rejected.pose, rejected.joint - 1, rejected.load) for rejected in found.set_aside} == {
            (measured.visits[visit].pose, axis, measured.visits[visit].load) for visit, axis in measured.outliers
        }
        moved.append(abs(after.mass_kg - before.mass_kg) / before.mass_std_kg)
        moved += (np.abs(after.com_m - before.com_m) / before.com_std_m).tolist()
    assert np.quantile(moved, 0.9) < 0.5


def test_a_table_of_outlier_visits_alone_keeps_them_all_and_says_so():
    for seed in range(5):
        measured = Measured(seed)
        measured.disturb(len(measured.visits), np.random.default_rng(seed))
        rng = np.random.default_rng([seed, 9])
        for visit in range(len(measured.visits)):
            for axis in range(6):
                measured.push(visit, axis, KINDS[rng.integers(3)], rng.uniform(4, 10) * rng.choice([-1, 1]))
        found = measured.found()
        assert not found.entries
        assert "disagree by more than the friction band" in found.findings[-1].what


def test_more_than_a_tenth_of_an_axis_is_no_accident():
    measured = Measured(3)
    for visit in range(0, 24, 5):
        measured.push(visit, 2, (1.0, 1.0), 6.0)
    found = measured.found()
    assert not found.entries
    (finding,) = found.findings
    assert (finding.severity, finding.where) == ("warn", "J3")
    assert finding.what.startswith("5 visits deviate from the others")


def test_visits_in_a_row_are_a_change_and_not_an_accident():
    measured = Measured(4)
    for visit in (21, 22, 23):
        measured.push(visit, 1, (1.0, 1.0), 6.0)
    found = measured.found()
    assert not found.entries
    (finding,) = found.findings
    assert finding.where == "J2"
    assert finding.what.startswith("3 visits")


@pytest.mark.parametrize(
    ("kind", "reason", "bands"),
    [((1.0, 1.0), "cable or a touch", 6.0), ((1.0, -1.0), "brake", 6.0), ((0.0, 1.0), "one approach direction", 6.0)],
)
def test_an_entry_says_by_how_many_bands_and_in_what(kind, reason, bands):
    measured = Measured(LOSSLESS)
    measured.push(15, 4, kind, bands)
    found = measured.found()
    assert entries(found) == {(15, 4)}
    assert reason in found.entries[0].reason
    # the band as seen is a fifth smaller than that in motion, what has settled
    assert found.entries[0].bands == pytest.approx(bands, rel=0.4)
    assert (found.entries[0].load, found.entries[0].pose, found.entries[0].joint) == ("tool", 3, 5)
    assert "pose 3 under tool, J5 by" in found.findings[0].what


@pytest.mark.slow
def test_one_sided_visits_are_judged_by_their_own_scatter():
    there = found = wrong = 0
    for seed in range(20):
        measured = Measured(seed)
        rng = np.random.default_rng([seed, 10])
        visit, axis = int(rng.integers(24)), int(rng.integers(6))
        measured.push(visit, axis, (1.0, 1.0), rng.choice([-1.0, 1.0]) * 6.0)
        measured.columns = {name: values[FROM_BELOW] for name, values in measured.columns.items()}
        said = entries(measured.found())
        there, found, wrong = there + 1, found + len(said & measured.outliers), wrong + len(said - measured.outliers)
    assert found >= 0.95 * there
    assert wrong <= 0.01 * 20 * 144


def test_a_table_without_noise_holds_no_outlier():
    measured = Measured(1)
    visits = [PlannedVisit(v.pose, v.load, v.time_s, v.q_rad) for v in measured.visits]
    tau = gravity_regressor(measured.robot, np.array([v.q_rad for v in visits]), (0, 0, -9.80665)) @ np.ones(24)
    measured.columns["tau_nm"] = np.repeat(tau, 2, axis=0)
    assert not measured.found().entries
