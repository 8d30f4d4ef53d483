"""Moving runs: what is reported as held out chose nothing, and intervals know constants, losses, shapes and blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.diagnose import diagnose
from gateway.diagnose.moving.choice import problem_of
from gateway.diagnose.moving.moving_findings import edge_findings
from gateway.diagnose.moving.moving_mistakes import find_mistakes
from gateway.diagnose.moving.parameters import at_edge
from gateway.diagnose.moving.penalised_fit import fit
from gateway.identify.knowledge import Knowledge
from gateway.model.effects.load_dependent_friction import LoadDependentFriction
from gateway.model.effects.velocity_friction import FRACTIONS, Stribeck
from gateway.model.motion import prepare
from gateway.result.result import EffectResult
from tests.data.moving_arm import GRAVITY, World, measured, several

LOADS = {"none": None, "a": (2.0, 0.02, -0.01, 0.08), "b": (5.0, -0.03, 0.02, 0.1), "c": (8.0, 0.05, 0.0, 0.12)}


def problem(table, robot, trust=0.05):
    motion = prepare(table, None, robot, GRAVITY)
    return problem_of(motion, trust, Knowledge())


def parted(seed, world, at_s=18.0, **keys):
    table, robot, _ = measured(seed, world, **keys)
    return table.take(table.time_s < at_s), table.take(table.time_s >= at_s + 0.5), robot


@pytest.mark.slow
def test_rows_that_are_given_choose_no_parameter_and_no_load():
    """Two hold-outs of the same fitted rows, and none: only the figures on them differ, and no load is surer."""
    first, last, robot = parted(5, World(spring=(0.8, 0.1), payload=(6.0, 0.03, -0.02, 0.12)))
    other = replace(last, tau_nm=last.tau_nm + 0.01 * np.abs(last.tau_nm).max(axis=0) * np.sin(last.time_s)[:, None])
    only = frozenset({"balancer_spring", "cable_torque", "base_tilt"})
    good, bad, alone = (diagnose(first, robot, holdout=held, only=only) for held in (last, other, None))
    assert [effect.name for effect in good.effects] == [effect.name for effect in bad.effects] == ["balancer_spring"]
    assert good.effects[0].parameters == bad.effects[0].parameters
    assert good.effects[0].std == bad.effects[0].std
    assert repr(good.loads) == repr(bad.loads), "an inertia that is not known is not a number"
    assert good.after.rms_nm == bad.after.rms_nm
    assert good.after.holdout_rms_nm != bad.after.holdout_rms_nm
    assert good.loads[0].mass_std_kg == pytest.approx(alone.loads[0].mass_std_kg, rel=0.02)
    assert good.loads[0].com_std_m == pytest.approx(alone.loads[0].com_std_m, rel=0.02)


@pytest.mark.slow
def test_figures_come_with_an_interval_and_say_what_they_are_of():
    table, robot, _ = measured(1, World(load_friction={1: 0.25}))
    only = frozenset({"load_dependent_friction", "base_tilt"})
    result = diagnose(table, robot, Knowledge(link_std=np.inf), only=only)
    ratio = np.array(result.quality["holdout_ratio"])
    rms = np.array(result.after.holdout_rms_nm) / np.array(result.before.holdout_rms_nm)
    assert ratio[:, 0] == pytest.approx(rms)
    assert (ratio[:, 1] <= ratio[:, 0]).all()
    assert (ratio[:, 0] <= ratio[:, 2]).all()
    assert ratio[1, 2] < 1.0
    assert "no evidence for another run" in str(result.provenance["held_out"])


@pytest.mark.slow
def test_loads_mounted_in_one_run_each_are_estimated_from_both():
    """Six runs and more: held out whole, each took its load with it."""
    loads = {"none": None, "again": None} | {f"l{k}": (2.0 + k, 0.02, -0.01, 0.05 + 0.01 * k) for k in range(4)}
    table, robot = several(3, loads)
    result = diagnose(table, robot, only=frozenset({"base_tilt"}))
    found = {load.label: load for load in result.loads}
    for label, load in loads.items():
        if load is not None:
            assert found[label].mass_kg == pytest.approx(load[0], abs=3.0 * found[label].mass_std_kg)
            assert found[label].mass_std_kg < 0.04 * load[0], "other loads are no noise"
            assert sum(found[label].budget.values()) == pytest.approx(1.0)
    assert found["l3"].budget["constants"] > 0.2


@pytest.mark.slow
def test_a_run_of_a_tenth_of_the_others_is_no_hindrance():
    table, robot = several(4, LOADS)
    short = (table.run != "3") | (table.time_s < 1.0)
    result = diagnose(table.take(short), robot, only=frozenset({"base_tilt"}))
    assert result.effects == ()
    found = {load.label: load for load in result.loads}
    assert found["b"].mass_kg == pytest.approx(5.0, abs=3.0 * found["b"].mass_std_kg)
    if np.isfinite(found["c"].mass_kg):
        assert found["c"].mass_kg == pytest.approx(8.0, abs=3.0 * found["c"].mass_std_kg)
        assert found["c"].mass_std_kg > found["b"].mass_std_kg


def test_rows_of_another_arm_held_out_name_nothing_and_say_so():
    table, robot, _ = measured(1, World(), duration_s=16.0)
    other, _, _ = measured(2, World(gain={1: -1.0}), duration_s=8.0, cad_error=0.6)
    result = diagnose(table, robot, holdout=other)
    assert result.effects == ()
    assert not result.failed
    assert result.verdict == "undecided"
    assert any(finding.where == "--holdout" and "another robot" in finding.what for finding in result.findings)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_what_every_arm_has_is_no_effect(seed):
    """Gains off by 3 % and losses of 5 % on every axis."""
    table, robot = several(seed, {"none": None, "a": LOADS["a"]})
    result = diagnose(table, robot)
    assert result.effects == ()
    assert result.verdict in ("none_needed", "unexplained")
    gain = result.nuisance["gain"]
    truth = 0.03 * np.random.default_rng(seed).normal(size=6)
    assert (np.abs(np.array(gain.value) - truth) < 3.0 * np.array(gain.std)).all()


def test_no_gain_and_no_loss_goes_beyond_its_usual_range_unless_it_is_an_effect():
    """A scale of 0.75 and a loss of 0.3 stay at two standard deviations; as effects in the model they are found."""
    table, robot, _ = measured(1, World(gain={1: 0.75}, load_friction={2: 0.3}))
    plain = problem(table, robot)
    everything = ~plain.motion.held_out
    without = fit(plain, (), everything, plain.motion.held_out)
    gain, loss = plain.null.usual.reshape(2, 6)
    assert without.value[gain[1]] == pytest.approx(-2.0 * plain.null.std_of(gain[1]), abs=2e-3)
    assert without.value[loss[2]] == pytest.approx(0.15, abs=1e-6)
    assert without.at_limit(int(loss[2]))
    found = fit(plain, (LoadDependentFriction(2),), everything, plain.motion.held_out)
    assert found.value[-1] == pytest.approx(0.3, abs=0.03)


def test_a_sign_is_not_reversed_where_friction_is_right_in_a_run():
    """Friction of one axis takes power in the first run and seems to give it in the second."""
    first, robot, scale = measured([1, 0], World(), duration_s=12.0, arm_seed=1)
    second, _, _ = measured([1, 1], World(), duration_s=24.0, arm_seed=1, scale=scale)
    second = replace(second, run=np.full(len(second.time_s), "2"))
    second.tau_nm[:, 3] -= 0.4 * scale[3] * np.sign(second.qd_rad_s[:, 3])
    both = problem(concatenate([first, second]), robot)
    assert find_mistakes(both, frozenset({"sign_reversed"})) == []
    alone = diagnose(concatenate([first, second]), robot, only=frozenset({"sign_reversed"}))
    assert not alone.failed


def test_a_mistake_that_undone_is_no_better_is_no_failing_finding():
    """An axis whose friction gives power all over, its gravity and inertia read with the right sign."""
    table, robot, scale = measured(4, World())
    table.tau_nm[:, 3] -= 0.4 * scale[3] * np.sign(table.qd_rad_s[:, 3])
    result = diagnose(table, robot, only=frozenset({"sign_reversed", "axes_swapped"}))
    assert not result.failed
    assert result.effects == ()


def test_a_parameter_at_the_edge_of_its_grid_has_no_standard_deviation():
    table, robot, _ = measured(1, World(), duration_s=6.0)
    rows = problem(table, robot)
    top = float(rows.motion.speed_rad_s[2])
    for share in FRACTIONS:
        marked = at_edge(rows, [Stribeck(2, share * top)], {})
        assert bool(marked) == (share in (FRACTIONS[0], FRACTIONS[-1]))
    assert at_edge(rows, [LoadDependentFriction(2)], {"coefficient": 0.599}) == ["coefficient"]
    assert at_edge(rows, [LoadDependentFriction(2)], {"coefficient": 0.3}) == []


@pytest.mark.slow
def test_a_decay_inside_its_grid_has_a_spread_that_the_friction_shares():
    table, robot, _ = measured(1, World(stribeck={2: (0.15, 0.15)}))
    result = diagnose(table, robot, Knowledge(link_std=np.inf), only=frozenset({"velocity_friction"}))
    (effect,) = result.effects
    decay = effect.parameters["stribeck_velocity_rad_s"]
    assert effect.std["stribeck_velocity_rad_s"] > 0.1 * decay
    assert abs(decay - 0.15 * np.abs(table.qd_rad_s[:, 2]).max()) < 2.0 * effect.std["stribeck_velocity_rad_s"]


def test_an_estimate_at_the_edge_of_its_range_is_reported():
    effect = EffectResult("velocity_friction", (3,), {"stribeck_nm": 1.0}, {"stribeck_nm": float("nan")})
    (finding,) = edge_findings([effect])
    assert finding.where == "J3"
    assert "stribeck_nm" in finding.what
    assert "limit of the tried range" in finding.what
