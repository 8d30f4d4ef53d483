"""Mechanisms: each against a formula of its own, and all as strong as they are said to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.nature.effect import play, rows_of
from benchmarks.nature.measuring import equilibrium
from benchmarks.nature.nature_cell import NAMED, draw_cell
from benchmarks.nature.springs import draw_linkage
from benchmarks.nature.strength import absorbing, added, strength, strengths_beside
from benchmarks.nature.unmodelled import UNMODELLED, pulled
from benchmarks.nature.wiring import WIRING
from sim.offline import gravity_columns, link_frames


@pytest.fixture(scope="module")
def cell():
    return draw_cell(11, "base")


@pytest.mark.parametrize("name", [*NAMED, *UNMODELLED])
def test_nothing_comes_of_size_nothing_and_something_of_the_largest(cell, name):
    rows = rows_of(cell.visits)
    build, (least, most) = (NAMED | UNMODELLED)[name](cell.arm, rows, np.random.default_rng(5))
    nothing, much = added(cell.arm, rows, build(0.0)), added(cell.arm, rows, build(most))
    # the play behind the encoder is met in two steps where nothing winds up, in six where something may
    for half in (nothing.half_sum_nm, nothing.half_difference_nm):
        assert np.abs(half / cell.arm.floor_nm).max() < 1e-3
    assert max(np.abs(much.half_sum_nm / cell.arm.floor_nm).max(), np.abs(much.half_difference_nm).max()) > 0.5
    assert least < most
    assert build(most).mechanism == name


def test_play_follows_with_dead_travel():
    # up by 2, back by 0.5: within the dead travel of 2 x 0.3 it stays, beyond it follows
    corners = np.array([[0.0, 2.0], [1.5, 1.5], [1.0, 1.0]])
    assert play(corners, 0.3) == pytest.approx([1.7, 1.7, 1.3])


def test_a_strut_pulls_by_the_change_of_its_length(cell):
    strut = draw_linkage(cell.arm, np.random.default_rng(0))
    q = np.linspace(-1.4, 1.4, 9)
    slope = (strut.length_m(q + 1e-6) - strut.length_m(q - 1e-6)) / 2e-6
    assert strut.lever_m(q) == pytest.approx(slope, abs=1e-8)


def test_a_force_on_the_wrist_turns_the_joints_as_virtual_work_says(cell):
    q, force = cell.visits[0].q_rad[None], np.array([[1.0, -2.0, 0.5]])
    torque = pulled(cell.arm, q, force)[0]
    for axis in range(6):
        step = np.zeros(6)
        step[axis] = 1e-6
        tips = [link_frames(cell.arm.chain, q + s * step)[0, 5, :3, 3] for s in (1, -1)]
        assert torque[axis] == pytest.approx((tips[0] - tips[1]) @ force[0] / 2e-6, abs=1e-6)


def test_a_gear_that_winds_up_is_in_equilibrium(cell):
    arm = replace(cell.arm, backlash_rad=np.zeros(6))
    rows = rows_of(cell.visits)
    build, (_, most) = NAMED["stiffening_gear"](arm, rows, np.random.default_rng(2))
    effect = build(most)
    tau, q = equilibrium(arm, rows, (effect,), np.zeros_like(rows.q_rad))
    axis = effect.joints[0] - 1
    assert np.abs(q - rows.q_rad)[:, axis].max() > 1e-3
    assert q - rows.q_rad == pytest.approx(effect.on_angle(rows, tau), abs=1e-5)
    columns = gravity_columns(arm.chain, q, arm.gravity_m_s2)
    expected = columns @ arm.links + rows.loaded[:, None] * (columns[:, :, 20:] @ arm.load)
    assert tau == pytest.approx(expected)


def test_what_links_load_or_nuisances_take_over_has_no_strength(cell):
    arm, rows = cell.arm, rows_of(cell.visits)
    taken = absorbing(arm, cell.visits)
    q, loaded = rows.q_rad[0::2], rows.loaded[0::2]
    heavier = gravity_columns(arm.chain, q, arm.gravity_m_s2)[:, :, 20] * loaded[:, None]
    assert np.abs(taken.left(1e3 * heavier)).max() < 1e-6
    # a bias of one standard deviation is mostly taken over, one of thirty is not
    bias = np.zeros_like(q)
    bias[:, 4] = arm.friction.bias_std * arm.friction.coulomb_nm[4]
    rms = np.sqrt(np.mean((bias[:, 4] / arm.floor_nm[4]) ** 2))
    assert np.sqrt(np.mean(taken.left(bias)[:, 4] ** 2)) < rms


def test_an_effect_beside_another_of_the_same_curve_cannot_be_distinguished(cell):
    # gears without losses: an offset shows in the half-sums alone
    ones = np.ones(6)
    friction = replace(cell.arm.friction, driving=ones, driven=ones, declared_efficiency=ones)
    arm, rows = replace(cell.arm, friction=friction), rows_of(cell.visits)
    size = 20.0 * arm.floor_nm.max()
    first = NAMED["offset_sensor"](arm, rows, np.random.default_rng(8))[0](size)
    other = NAMED["strong_ripple"](arm, rows, np.random.default_rng(9))[0](size)
    alone = strength(arm, rows, first, absorbing(arm, cell.visits))
    twin, ripple = (strengths_beside(arm, cell.visits, rows, (first, more))[0] for more in (first, other))
    assert twin < 1e-6 * alone
    assert 0.5 * alone < ripple < 1.01 * alone


@pytest.mark.parametrize("name", sorted(WIRING))
def test_wiring_changes_the_table_and_only_that(cell, name):
    rows = rows_of(cell.visits)
    effect = WIRING[name](cell.arm, rows, np.random.default_rng(6))[0](1.0)
    columns, _ = cell.measure(cell.visits)
    wired = effect.wired(columns)
    axes = [joint - 1 for joint in effect.joints]
    others = [axis for axis in range(6) if axis not in axes]
    assert np.array_equal(wired["tau_nm"][:, others], columns["tau_nm"][:, others])
    if name == "exchanged_cables":
        assert np.array_equal(wired["tau_nm"][:, axes], columns["tau_nm"][:, axes[::-1]])
        assert np.array_equal(wired["q_rad"][:, axes], columns["q_rad"][:, axes[::-1]])
    else:
        factor = wired["tau_nm"][:, axes] / columns["tau_nm"][:, axes]
        assert np.ptp(factor) < 1e-12
        assert abs(factor[0, 0]) == pytest.approx(1.0) or factor[0, 0] ** 2 in (pytest.approx(2), pytest.approx(0.5))
    assert strength(cell.arm, rows, effect, absorbing(cell.arm, cell.visits)) == np.inf
