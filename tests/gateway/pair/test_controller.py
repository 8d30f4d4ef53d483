"""The step machine on a spring between two hands that answers with delay: learning, refusals, freezing, speed."""

from __future__ import annotations

import timeit
from dataclasses import replace

import numpy as np
import pytest

from gateway.errors import ConfigError, InputError, PlanRefused
from gateway.pair.calibration import PairCalibration
from gateway.pair.controller import DEFAULT_GAINS, EMBODIMENTS, PairController
from gateway.pair.force import InternalForce
from gateway.pair.impedance import Gains
from gateway.pair.learning_update import LearningRule
from gateway.pair.path import PairPath
from gateway.pair.transform import apply_correction, correction_between, inverse, slave_command
from gateway.pair.transform_function import function_of_knots
from gateway.result.pair import CycleSummary
from tests.gateway.pair.conftest import FIXED, first_function

CHAIN = np.repeat([1.0e5, 3.0e3], 3)
DELAY = 8


@pytest.fixture(scope="module")
def bare(cell: PairCalibration) -> PairCalibration:
    return replace(cell, part_mass_kg=0.0)


class Spring:
    """Two hands and a part that is millimetres longer than the data sheet says, its length changing along the path."""

    def __init__(self, path: PairPath, cell: PairCalibration) -> None:
        self._path, self._cell = path, cell
        u = path.s_m / path.length_m
        self.off = np.stack([2e-3 * np.sin(4 * u), 1e-3 * u, -1e-3 * u, 2e-3 * u, 0 * u, 1e-3 * u], axis=1)

    def wrenches(self, m: int, master: np.ndarray, slave: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Wrench on either fingertip, base axes, and the internal force's size in the second's first three."""
        wanted = apply_correction(slave_command(self._cell.w_t_b1, master, self._cell.w_t_b2, FIXED), self.off[m])
        second = CHAIN * correction_between(wanted, slave)
        tips = [(self._cell.w_t_b1 @ master)[:3, 3], (self._cell.w_t_b2 @ slave)[:3, 3]]
        turn = self._cell.w_t_b2[:3, :3]
        force, moment = turn @ second[:3], turn @ second[3:]
        first = np.concatenate([-force, -moment - np.cross(tips[1] - tips[0], force)])
        back = self._cell.w_t_b1[:3, :3].T
        return np.concatenate([back @ first[:3], back @ first[3:]]), second

    def _stand(self, m: int, slave: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Position of the arms, which follow the path without lag and corrections one step later."""
        master = self._path.commands[m]
        ahead = slave_command(self._cell.w_t_b1, master, self._cell.w_t_b2, FIXED)
        if slave is None:
            return master, ahead
        behind = slave_command(self._cell.w_t_b1, self._path.commands[m - 1], self._cell.w_t_b2, FIXED)
        there = slave.copy()
        there[:3, 3] += (ahead - behind)[:3, 3]
        return master, there

    def cycle(self, controller: PairController, complete: bool = True) -> tuple[CycleSummary, float]:
        """One cycle; summary and the largest true force."""
        controller.start_cycle()
        deviation, largest, slave = [], 0.0, None
        for m in range(len(self._path)):
            delayed_deviation = deviation[m - DELAY] if m >= DELAY else (np.zeros(6), np.zeros(6))
            stand = self._stand(m, slave)
            master, slave = controller.step(m, *delayed_deviation, measured=stand)
            deviation.append(self.wrenches(m, master, slave))
            largest = max(largest, float(np.linalg.norm(deviation[-1][1][:3])))
        return controller.end_cycle(complete), largest


def controller_of(name: str, path: PairPath, cell: PairCalibration, **changes: object) -> PairController:
    return PairController(replace(EMBODIMENTS[name], **changes), path, cell, first_function(path))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", [name for name, row in EMBODIMENTS.items() if row.sensing == "force"])
def test_every_row_runs_on_the_same_controller(name: str, path: PairPath, bare: PairCalibration) -> None:
    row = EMBODIMENTS[name]
    # delayed hands: their position belongs to commands of that time before, as corrections do
    rule = None if row.learning is None else replace(row.learning, lead_s=LearningRule().lead_s)
    controller = controller_of(name, path, bare, learning=rule)
    spring = Spring(path, bare)
    results = [spring.cycle(controller) for _ in range(7)]
    assert all(summary.complete for summary, _ in results)
    assert any(summary.learned for summary, _ in results) == (row.learning is not None)
    if row.learning is None:
        assert results[-1][1] == results[0][1]
    else:
        assert results[-1][1] < 0.8 * results[0][1]
    if row.corrects == "none":
        assert results[0][0].correction_m == 0.0


@pytest.mark.parametrize(("corrects", "figure"), [("both", 14), ("both", 15), ("master", 15)])
def test_master_may_yield_too(corrects: str, figure: int, path: PairPath, bare: PairCalibration) -> None:
    rule = LearningRule(cycles=2, figure=figure)  # type: ignore[arg-type]
    stiff = Gains((7.2e3, 2.4e3))
    controller = controller_of("C7", path, bare, corrects=corrects, learning=rule, gains=stiff)
    spring = Spring(path, bare)
    forces = [spring.cycle(controller)[1] for _ in range(13)]
    assert forces[-1] < 0.5 * forces[0]
    assert forces[-1] < 1.2 * forces[-3]


def test_both_hands_take_half_of_the_gap(path: PairPath, bare: PairCalibration) -> None:
    push = (np.array([-10.0, 0, 0, 0, 0, 0]), np.array([-10.0, 0, 0, 0, 0, 0]))
    moved = {}
    for corrects in ("slave", "both"):
        controller = controller_of("C1i", path, bare, corrects=corrects, gains=Gains((7.2e3, 2.4e3)))
        controller.start_cycle()
        for m in range(20):
            master, slave = controller.step(m, *push)
        base = slave_command(bare.w_t_b1, path.commands[19], bare.w_t_b2, FIXED)
        moved[corrects] = (master[0, 3] - path.commands[19][0, 3], slave[0, 3] - base[0, 3])
    assert moved["slave"][0] == 0.0
    assert moved["both"][1] == pytest.approx(0.5 * moved["slave"][1])
    assert moved["both"][0] == pytest.approx(moved["both"][1])


def test_slave_yields_along_the_force_on_it(path: PairPath, bare: PairCalibration) -> None:
    controller = controller_of("C1i", path, bare)
    controller.start_cycle()
    force = np.array([3.0, -2.0, 5.0, 0.0, 0.0, 0.0])
    base = slave_command(bare.w_t_b1, path.commands[0], bare.w_t_b2, FIXED)
    _, slave = controller.step(0, None, force)
    assert np.allclose(slave[:3, 3] - base[:3, 3], force[:3] * path.dt_s / DEFAULT_GAINS.damping[0], atol=1e-15)


def test_dead_band_is_not_corrected(path: PairPath, bare: PairCalibration) -> None:
    controller = controller_of("C1i", path, bare, dead_band=(10.0, 1.0))
    controller.start_cycle()
    base = slave_command(bare.w_t_b1, path.commands[0], bare.w_t_b2, FIXED)
    _, slave = controller.step(0, None, np.array([9.0, 0, 0, 0, 0, 0.9]))
    assert np.allclose(slave, base, atol=1e-15)


def test_corrections_start_from_nothing_each_cycle(path: PairPath, bare: PairCalibration) -> None:
    controller = controller_of("C1i", path, bare)
    Spring(path, bare).cycle(controller)
    controller.start_cycle()
    base = slave_command(bare.w_t_b1, path.commands[0], bare.w_t_b2, FIXED)
    assert np.allclose(controller.step(0, np.zeros(6), np.zeros(6))[1], base, atol=1e-14)


def test_learning_never_runs_on_an_incomplete_cycle(path: PairPath, bare: PairCalibration) -> None:
    controller, spring = controller_of("C2c", path, bare), Spring(path, bare)
    summary, _ = spring.cycle(controller, complete=False)
    assert (summary.complete, summary.learned) == (False, False)
    assert "incomplete" in summary.reason
    assert controller.state().second is None
    controller.start_cycle()
    controller.step(0, np.zeros(6), np.zeros(6))
    summary = controller.end_cycle(complete=True)
    assert (summary.complete, summary.learned) == (False, False)
    assert "command 2 was not run" in summary.reason
    assert spring.cycle(controller)[0].learned


def test_cycle_without_observable_force_is_not_learned_from(path: PairPath, bare: PairCalibration) -> None:
    controller = controller_of("C2c", path, bare)
    controller.start_cycle()
    for m in range(len(path)):
        controller.step(m, None if m == 40 else np.zeros(6), None if m == 40 else np.zeros(6))
    assert "no force could be determined at command 41" in controller.end_cycle(complete=True).reason


def test_frozen_functions_stay_to_the_last_bit(path: PairPath, bare: PairCalibration) -> None:
    controller, spring = controller_of("C2c", path, bare), Spring(path, bare)
    spring.cycle(controller)
    controller.freeze()
    before = controller.function.knots
    spring.off[:, 0] += 5e-4
    summary, _ = spring.cycle(controller)
    assert summary.reason == "learning is off"
    assert np.array_equal(controller.function.knots, before)
    assert controller.state().frozen
    controller.resume()
    spring.cycle(controller)
    assert not np.array_equal(controller.function.knots, before)
    controller.reset()
    assert controller.state().in_use == "first"


def test_measured_positions_are_learned_as_they_are(path: PairPath, bare: PairCalibration) -> None:
    controller = controller_of("C2m", path, bare, learning=LearningRule(source="measured", lead_s=0.0, smooth_s=0.0))
    lag = np.array([1e-3, 0.0, 0.0, 0.0, 0.0, 2e-3])
    controller.start_cycle()
    for m in range(len(path)):
        base = slave_command(bare.w_t_b1, path.commands[m], bare.w_t_b2, FIXED)
        controller.step(m, np.zeros(6), np.zeros(6), (path.commands[m], apply_correction(base, lag)))
    assert controller.end_cycle(complete=True).learned
    commanded = slave_command(bare.w_t_b1, path.commands[0], bare.w_t_b2, controller.function.at(0.0))
    base = slave_command(bare.w_t_b1, path.commands[0], bare.w_t_b2, FIXED)
    assert np.allclose(correction_between(commanded, base), lag, atol=1e-9)
    controller.start_cycle()
    for m in range(len(path)):
        controller.step(m, np.zeros(6), np.zeros(6))
    assert controller.end_cycle(complete=True).reason == "present positions are missing"


def test_distance_error_goes_where_it_is_commanded(path: PairPath, bare: PairCalibration) -> None:
    row = replace(EMBODIMENTS["E5"], gains=Gains((0.08, 0.08)))
    controller = PairController(row, path, bare, first_function(path))
    controller.start_cycle()
    error = np.array([1e-3, -2e-3, 0.0, 1e-3, 0.0, 0.0])
    for m in range(40):
        _, slave = controller.step(m, None, error)
    base = slave_command(bare.w_t_b1, path.commands[39], bare.w_t_b2, FIXED)
    assert np.allclose(correction_between(slave, base), error * 40 * 0.004 / 0.08, atol=1e-12)


def test_gap_that_was_left_is_learned_at_the_command_that_it_belongs_to(path: PairPath, bare: PairCalibration) -> None:
    """Hands that barely yield, sensors read with half a loop time of delay, three commands: 0.3 stays after a cycle."""
    cell, delay = replace(bare, loop_time_s=0.024), 3
    row = replace(EMBODIMENTS["E5"], gains=Gains((1e9, 1e9)), learning=LearningRule(left_share=0.7, smooth_s=0.0))
    every = function_of_knots(path.s_m[:: len(path) - 1], np.tile(FIXED, (2, 1, 1)))
    knots = np.unique(path.s_m)
    controller = PairController(row, path, cell, function_of_knots(knots, every.many(knots)))
    off = np.zeros((len(path), 6))
    off[:, 0] = 1e-3 * np.sin(np.arange(len(path)) / 30.0)
    wanted = apply_correction(slave_command(cell.w_t_b1, path.commands, cell.w_t_b2, FIXED), off)
    for share in (1.0, 0.3, 0.09):
        controller.start_cycle()
        delayed_deviation = [controller.step(m, None, np.zeros(6))[1] for m in range(len(path))]
        left = correction_between(wanted, np.stack(delayed_deviation))
        assert left[delay:-delay] == pytest.approx(share * off[delay:-delay], abs=1e-5)
        controller.start_cycle()
        for m in range(len(path)):
            controller.step(m, None, left[max(m - delay, 0)])
        assert controller.end_cycle(complete=True).learned


def test_refusals(path: PairPath, bare: PairCalibration) -> None:
    with pytest.raises(ConfigError, match="limit of oscillation"):
        controller_of("C1i", path, bare, gains=Gains((2000.0, 160.0)))
    with pytest.raises(ConfigError, match="limit of oscillation"):
        controller_of("C1i", path, bare, corrects="master")
    longer = function_of_knots([0.0, 2.0 * path.length_m], np.tile(FIXED, (2, 1, 1)))
    with pytest.raises(InputError, match="another path"):
        PairController(EMBODIMENTS["C1"], path, bare, longer)
    with pytest.raises(ConfigError, match=r"fig\. 14"):
        controller_of(
            "C7", path, bare, corrects="master", learning=LearningRule(figure=14), gains=Gains((7.2e3, 2.4e3))
        )
    with pytest.raises(PlanRefused, match="start one"):
        controller_of("C1", path, bare).step(0, None, None)
    with pytest.raises(ConfigError, match="not a pose"):
        PairCalibration(2.0 * np.eye(4), np.eye(4), np.eye(4))


def test_one_command_and_one_learning_step_are_fast(path: PairPath, bare: PairCalibration) -> None:
    """A generous multiple of what they take, so that a busy machine keeps it: 1 ms of a 4 ms cycle, 5 % of a pass."""
    controller, spring = controller_of("C8", path, bare), Spring(path, bare)
    controller.start_cycle()
    deviation = np.ones(6)
    assert min(timeit.repeat(lambda: controller.step(5, deviation, deviation), number=50, repeat=10)) / 50 < 1e-3
    for _ in range(2):
        spring.cycle(controller)
    controller.start_cycle()
    for m in range(len(path)):
        controller.step(m, deviation, deviation)
    took = min(timeit.repeat(lambda: controller.end_cycle(complete=True), number=1, repeat=3))
    assert took < 0.05 * path.duration_s


def test_summary_reports_what_was_estimated(path: PairPath, bare: PairCalibration) -> None:
    controller = controller_of("C1", path, bare)
    summary, largest = Spring(path, bare).cycle(controller)
    assert summary.force_n == pytest.approx(largest, rel=0.05)
    assert summary.knots == 9
    assert summary.function == "first"
    assert summary.cycle == 1
    controller.start_cycle()
    blind = controller.end_cycle(complete=True)
    assert np.isnan(blind.force_n)
    assert blind.at_command == -1
    assert inverse(FIXED)[0, 3] == -0.4


# -- force that is known once a path is over ---------------------------------------------------------------------------


def known(path: PairPath, wrench: np.ndarray, std_n: float = 1.0) -> InternalForce:
    covariance = np.tile(np.diag(np.repeat([std_n, 0.2 * std_n], 3) ** 2), (len(path), 1, 1))
    return InternalForce(np.tile(wrench, (len(path), 1)), covariance)


def commanded(controller: PairController, path: PairPath) -> np.ndarray:
    """Commands (M, 4, 4) of the slave in a cycle without force."""
    return np.array([controller.step(m, np.zeros(6), np.zeros(6))[1] for m in range(len(path))])


def test_a_force_that_is_known_at_the_end_moves_the_next_cycle_against_it(
    path: PairPath, bare: PairCalibration
) -> None:
    """A part that pulls the slave's hand along x makes it go there, by the stated stiffness and the stated share."""
    controller = controller_of("C2c", path, bare)
    controller.start_cycle()
    before = commanded(controller, path)
    summary = controller.end_cycle(True, known(path, np.array([50.0, 0.0, 0.0, 0.0, 0.0, 0.0])))
    assert summary.learned
    assert summary.force_n == pytest.approx(50.0)
    controller.start_cycle()
    moved = (bare.w_t_b2 @ commanded(controller, path) - bare.w_t_b2 @ before)[:, 0, 3]
    wanted = 0.7 * 50.0 / bare.chain_stiffness[0, 0]
    assert moved[len(path) // 2] == pytest.approx(wanted, rel=0.05)
    assert (moved > 0.0).all()
    # what rests on a taught point and is barely estimated there stays
    assert moved[0] < moved[len(path) // 2]


def test_an_uncertain_force_is_not_learned_at_rest(path: PairPath, bare: PairCalibration) -> None:
    moved = []
    for std_n in (1.0, 80.0):
        controller = controller_of("C2c", path, bare)
        controller.start_cycle()
        before = commanded(controller, path)
        controller.end_cycle(True, known(path, np.array([50.0, 0, 0, 0, 0, 0]), std_n))
        controller.start_cycle()
        moved.append(np.linalg.norm((commanded(controller, path) - before)[0, :3, 3]))
    assert moved[1] < 0.02 * moved[0]


def test_a_cycle_begins_where_the_slave_is_and_learns_that(path: PairPath, bare: PairCalibration) -> None:
    controller = controller_of("C2c", path, bare)
    controller.start_cycle()
    plain = commanded(controller, path)
    held = plain[0].copy()
    held[:3, 3] += [1e-4, -2e-4, 3e-4]
    away = controller.beside(held)
    assert away == pytest.approx([1e-4, -2e-4, 3e-4, 0, 0, 0], abs=1e-9)
    controller.start_cycle(np.linspace(1.0, 0.0, 21)[:, None] * away)
    begun = commanded(controller, path)
    assert begun[0] == pytest.approx(held, abs=1e-9)
    assert begun[20:] == pytest.approx(plain[20:], abs=1e-12)
    controller.end_cycle(True, known(path, np.zeros(6)))
    assert np.linalg.norm(controller.beside(held)[:3]) < np.linalg.norm(away[:3])


def test_a_cycle_in_which_something_pulled_at_the_arms_is_not_learned_from(
    path: PairPath, bare: PairCalibration
) -> None:
    controller = controller_of("C2c", path, bare)
    force = known(path, np.array([50.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    controller.start_cycle()
    commanded(controller, path)
    summary = controller.end_cycle(True, replace(force, pulled=True))
    assert not summary.learned
    assert "acted on them" in summary.reason
    assert controller.function is controller.state().first
    controller.start_cycle()
    commanded(controller, path)
    assert controller.end_cycle(True, force).learned
