"""Cells of nature: the same from the same seed, statics against pinocchio, conditions that do what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from benchmarks.nature.effect import rows_of
from benchmarks.nature.gear_friction import Friction
from benchmarks.nature.levels import CONDITIONS
from benchmarks.nature.measuring import equilibrium, quiet, reported_nm
from benchmarks.nature.nature_cell import KINDS, draw_cell, draw_effect_cell, drawn_kind
from benchmarks.nature.strength import halves
from sim.urdf import SimBody, write_chain


def test_a_seed_gives_the_same_cell_and_the_same_rows():
    first, second = draw_cell(3, "all"), draw_cell(3, "all")
    assert first.stated.urdf == second.stated.urdf
    one, outliers = first.measure(first.visits)
    other, again = second.measure(second.visits)
    assert outliers == again
    assert all(np.array_equal(one[name], other[name], equal_nan=one[name].dtype.kind == "f") for name in one)
    assert not np.array_equal(one["tau_nm"], first.measure(first.visits, 1)[0]["tau_nm"])
    assert draw_cell(4, "all").stated.urdf != first.stated.urdf


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_gravity_is_that_of_the_true_links_and_the_tool(seed):
    cell = draw_cell(seed, "cad")
    arm, rows = cell.arm, rows_of(cell.visits)
    firm = replace(arm, backlash_rad=np.zeros(6))
    tau, q = equilibrium(firm, rows, (), np.zeros_like(rows.q_rad))
    assert np.allclose(q, rows.q_rad)
    links = arm.links.reshape(6, 4)
    bodies = tuple(SimBody(m, h / m, 10.0 * m * np.eye(3)) for m, h in zip(links[:, 0], links[:, 1:], strict=True))
    model = pinocchio.buildModelFromXML(write_chain(replace(arm.chain, bodies=bodies)))
    tool = pinocchio.Inertia(arm.tool.mass_kg, arm.tool.com_m, np.eye(3))
    for loaded in (False, True):
        if loaded:
            model.appendBodyToJoint(6, tool, pinocchio.SE3.Identity())
        data = model.createData()
        for row in np.flatnonzero(rows.loaded == loaded)[:6]:
            expected = pinocchio.computeGeneralizedGravity(model, data, rows.q_rad[row]) * (9.80665 / 9.81)
            assert tau[row] == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


def _lossless(friction: Friction, declared: np.ndarray) -> Friction:
    """Gears without bias, warm from the start, that lose what is declared and the plain band."""
    return replace(
        friction,
        bias_share=np.zeros(6),
        warm_share=np.zeros((2, 6)),
        driving=np.ones(6),
        driven=np.ones(6),
        declared_efficiency=declared,
    )


def test_without_nuisances_the_half_sums_are_gravity():
    cell = draw_cell(5, "base")
    friction = _lossless(cell.arm.friction, np.ones(6))
    arm = replace(cell.arm, friction=friction, gain=np.zeros(6), cogging_nm=np.zeros((6, 4)), backlash_rad=np.zeros(6))
    rows = rows_of(cell.visits)
    seen, tau = reported_nm(arm, rows, (), quiet(arm, rows))
    both = halves(seen, np.ones(6))
    assert both.half_sum_nm == pytest.approx(tau[0::2], abs=1e-9)
    band = friction.band_nm(tau, rows.time_s) * friction.mean_left
    assert both.half_difference_nm == pytest.approx(band[0::2], rel=1e-9)


def test_the_declared_efficiency_takes_each_side_back_behind_the_gear():
    cell = next(c for c in (draw_cell(s, "base") for s in range(20)) if (c.arm.friction.declared_efficiency < 1).all())
    friction = _lossless(cell.arm.friction, cell.arm.friction.declared_efficiency)
    arm = replace(cell.arm, friction=friction, gain=np.zeros(6), cogging_nm=np.zeros((6, 4)))
    rows = rows_of(cell.visits)
    seen, tau = reported_nm(arm, rows, (), quiet(arm, rows))
    assert halves(seen, friction.declared_efficiency).half_sum_nm == pytest.approx((tau[0::2] + tau[1::2]) / 2)


def test_stops_scatter_as_the_floor_says():
    friction = draw_cell(7, "bias").arm.friction
    left, scatter = friction.stops(40000, np.random.default_rng(1))
    band = friction.coulomb_nm
    half_sum = band * (left[:, 0] - left[:, 1] + scatter[:, 0] + scatter[:, 1]) / 2.0
    assert half_sum.std(axis=0) == pytest.approx(friction.half_sum_std_nm(band, band), rel=0.03)
    assert left.mean(axis=(0, 1)) == pytest.approx(friction.mean_left, rel=0.01)


@pytest.mark.slow
def test_links_and_gains_are_drawn_with_what_is_stated():
    cells = [draw_cell(seed, condition) for condition in ("base", "cad") for seed in range(80)]
    links, gains = [], []
    for cell in cells:
        cad = np.concatenate([[b.mass_kg, *(b.mass_kg * b.com_m)] for b in cell.arm.chain.bodies if b])
        links.append((cell.arm.links - cad) / cell.arm.links_std)
        gains.append(cell.arm.gain / cell.arm.gain_std)
    assert np.std(links) == pytest.approx(1.0, abs=0.05)
    assert np.std(gains) == pytest.approx(1.0, abs=0.08)


def test_every_kind_is_drawn_in_its_share():
    drawn = [drawn_kind(seed) for seed in range(1000)]
    for kind, share in KINDS.items():
        # four standard deviations of a share of 1000
        assert np.mean([k == kind for _, k in drawn]) == pytest.approx(share, abs=4 * np.sqrt(share / 1000))
    assert {condition for condition, _ in drawn} == set(CONDITIONS)
    assert np.mean([condition == "all" for condition, _ in drawn]) == pytest.approx(0.5, abs=0.07)
    assert [draw_effect_cell(seed).kind for seed in range(4)] == [kind for _, kind in drawn[:4]]
