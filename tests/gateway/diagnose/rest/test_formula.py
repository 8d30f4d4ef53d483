"""Candidate formula for a mechanism that is in no library; the true forms are those of `sim.effects`."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from benchmarks.blind.nature import first_diagnosis
from benchmarks.nature.nature_cell import draw_effect_cell
from gateway.diagnose import close_loop, diagnose
from gateway.diagnose.rest.formula import _least_gain
from gateway.model.effects.torque_offset import TorqueOffset
from gateway.model.formula import AngleWave, Buffer, Knee, pieces
from gateway.model.kinematics import link_frames
from gateway.model.unnamed import BentGain, Pull, UnevenBand, UnevenGain
from gateway.report.render import render
from gateway.report.view import formula_text
from gateway.result.result import from_json, to_json
from tests.data.resting_arm import Bench, effect

#: Effects whose names a mechanism outside the library could get.
NEAREST = frozenset({"balancer_spring", "cable_torque", "link_mass", "torque_constant_scale"})
#: Mechanism, and the coefficient of each product of its closed form (what the modelled motor torque lacks).
CLOSED_FORMS = [
    (
        effect("linkage_spring", [3], stiffness_nm=120.0, phase_rad=0.4),
        {"cos(2*q2 + 2*q3)": 120.0 * math.sin(0.4), "sin(2*q2 + 2*q3)": 120.0 * math.cos(0.4)},
    ),
    (
        effect("hardening_cable", [3], amplitude_nm=60.0, phase_rad=0.5),
        {"cos(3*q3)": 60.0 * math.cos(0.5), "sin(3*q3)": -60.0 * math.sin(0.5)},
    ),
    (
        effect("eccentric_gear", [2], coefficient=0.1, phase_rad=0.3),
        {"u*cos(q2)": 0.1 * math.cos(0.3), "u*sin(q2)": -0.1 * math.sin(0.3)},
    ),
    (effect("saturating_motor", [2], coefficient=0.15, reference_nm=800.0), {"u*abs(u)": 0.15 / 800.0}),
    (
        effect("world_hose", [4], force_n=[60.0, -20.0, 30.0]),
        {f"force_{axis} on the origin of link 4": f for axis, f in zip("xy", (60.0, -20.0), strict=True)},
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("hidden", "closed"), CLOSED_FORMS, ids=lambda value: value.get("name", ""))
def test_a_mechanism_without_a_name_gets_its_closed_form_and_no_name(hidden, closed):
    bench = Bench(3, [hidden])
    result = diagnose(bench.both(), bench.robot, bench.options, only=NEAREST)
    assert result.verdict == "unexplained"
    assert result.effects == ()
    formula = result.formula
    assert formula is not None
    found = {piece.expression: piece for piece in formula.pieces}
    assert found.keys() >= closed.keys()
    for expression, value in closed.items():
        assert abs(found[expression].coefficient - value) < 5.0 * found[expression].std + 0.1 * abs(value)
    assert formula.holdout_rms_ratio < 0.3
    assert formula.p_value < 1e-6
    tool = bench.arm.loads["tool"]
    assert abs(formula.after.loads[0].mass_kg - tool.mass_kg) < 4.0 * formula.after.loads[0].mass_std_kg
    assert from_json(to_json(result)).formula == formula
    page = render(result)
    assert "Candidate formula" in page
    assert all(expression in page for expression in closed)
    assert "names no cause" in formula_text(formula)


@pytest.mark.slow
def test_a_hose_is_found_where_it_is_anchored():
    tips_m = link_frames(Bench(4, []).robot, Bench(4, []).poses)[:, 5, :3, 3]
    hook_m = np.array([0.3, 0.5, 1.4]) * np.linalg.norm(tips_m, axis=1).max()
    free_m = float(np.median(np.linalg.norm(tips_m - hook_m, axis=1)))
    hidden = effect("bungee", [6], hook_m=hook_m.tolist(), stiffness_n_m=400.0, free_length_m=free_m)
    bench = Bench(4, [hidden])
    formula = diagnose(bench.both(), bench.robot, bench.options, only=NEAREST).formula
    assert formula is not None
    (piece,) = formula.pieces
    *anchor_m, link, length_m = (float(each) for each in re.findall(r"-?\d+(?:\.\d+)?", piece.expression))
    assert link == 6
    np.testing.assert_allclose(anchor_m, hook_m, atol=0.05)
    assert length_m == pytest.approx(free_m, abs=0.05)
    assert piece.coefficient == pytest.approx(400.0, rel=0.05)
    assert formula.runner_up is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "mechanism", "words", "names"),
    [
        (2170, "tether", "hose from", ("cable_torque", "torque_offset")),
        (2378, "half_full_tank", "of the load by tanh", ("payload_shift", "torque_constant_scale")),
        # without the formula the library names both, and nothing is left
        (306, "end_stop", "(q5", ("cable_torque", "torque_offset")),
        (856, "end_stop", "(q2", ("balancer_spring", "link_mass")),
    ],
)
def test_a_formula_that_explains_more_takes_the_place_of_names(seed, mechanism, words, names):
    cell = draw_effect_cell(seed)
    assert [each.mechanism for each in cell.effects] == [mechanism]
    result = first_diagnosis(cell, *names)
    assert (result.verdict, result.effects) == ("unexplained", ())
    assert result.formula is not None
    assert all(words in piece.expression for piece in result.formula.pieces)


@pytest.mark.slow
def test_the_knee_of_a_saturated_current_is_fitted_at_any_torque():
    """The arm has joint torques above 1000 Nm; the knee is between the start values of the dictionary."""
    cell = draw_effect_cell(1411)
    assert [(each.mechanism, each.joints) for each in cell.effects] == [("saturated_current", (2,))]
    result = first_diagnosis(cell, "torque_constant_scale", "load_dependent_friction")
    assert (result.verdict, result.effects) == ("unexplained", ())
    assert result.formula is not None
    (piece,) = result.formula.pieces
    assert piece.expression.startswith("max(abs(u)")
    assert piece.expression.endswith("*sign(u)")
    assert abs(piece.coefficient + cell.effects[0].size) < 3.0 * piece.std


@pytest.mark.slow
def test_fresh_poses_test_the_formula_and_further_poses_are_asked_for():
    bench = Bench(4, [effect("end_stop_buffer", [3], stiffness_nm_rad2=300.0, angle_rad=0.2)])
    options = bench.options
    result, table = close_loop(bench.both(), bench.robot, options, bench.more, bench.poses[:4] + 0.2, only=NEAREST)
    assert len(table) > len(bench.both())
    assert result.formula is not None
    assert result.holdout_kind == "fresh"
    assert result.formula.holdout_rms_ratio < 0.3
    assert all("max(q3" in piece.expression for piece in result.formula.pieces)


def test_an_expression_means_what_the_term_computes():
    q_rad = np.random.default_rng(1).uniform(-2.0, 2.0, (50, 6))
    names = {f"q{joint}": q_rad[:, joint - 1] for joint in range(1, 7)}
    names |= {"cos": np.cos, "sin": np.sin, "max": np.maximum}  # type: ignore[dict-item]
    for term in (
        AngleWave(2, (0, 2, -2, 0, 0, 0)),
        AngleWave(0, (0, -1, 1, 0, 0, 0)),
        AngleWave(4, (0, 0, 0, 0, 3, 0)),
        Buffer(2, 0.25, 1, 2),
        Buffer(3, -0.5, -1, 1),
        Buffer(1, 0.3, -1, 2),
    ):
        columns = term.shape(q_rad, np.zeros(0))
        for piece, column in zip(pieces(term), columns.T, strict=True):
            assert piece.sign == -1.0
            np.testing.assert_allclose(eval(piece.expression, {"__builtins__": {}}, names), column, atol=1e-12)


def test_only_the_law_of_one_mechanism_takes_names():
    stop, deeper, other_side = Buffer(2, 0.25, 1, 2), Buffer(2, 0.5, 1, 1), Buffer(2, -0.25, -1, 1)
    assert _least_gain([Knee(1, 0.5, 100.0)]) == 0.0
    assert _least_gain([stop]) == _least_gain([stop, deeper]) == pytest.approx(math.log(400.0))
    for none in ([], [stop, other_side], [AngleWave(2, (0, 0, 1, 0, 0, 0))], [stop, UnevenGain(2)]):
        assert _least_gain(none) == math.inf


@pytest.mark.parametrize("term", [UnevenGain(1), BentGain(1, 200.0), UnevenBand(1, 1), Pull(3)])
def test_every_parameter_has_a_product(term):
    assert len(pieces(term)) == len(term.linear)


def test_a_term_without_a_product_is_refused():
    with pytest.raises(TypeError, match="cannot be part of a formula"):
        pieces(TorqueOffset(0))
