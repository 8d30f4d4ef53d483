"""Every main effect of moving runs is found on torque made by an independent dynamics library, and nothing else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.diagnose.moving.diagnosis import diagnose_motion
from gateway.identify.knowledge import Knowledge
from tests.data.moving_arm import World, measured

IGNORE = Knowledge(link_std=np.inf)
LOSSES = frozenset({"load_dependent_friction", "velocity_friction", "axis_coupling"})
FOUND = [
    ("velocity_friction", (3,), World(stribeck={2: (0.15, 0.15)}), {}),
    ("axis_coupling", (5, 6), World(coupling=(4, 5, 1.0)), {"coefficient": (1.0, 0.05)}),
    ("axis_coupling", (3, 4), World(coupling=(2, 3, -1.0)), {"coefficient": (-1.0, 0.1)}),
    ("cable_torque", (5,), World(cable={4: 0.15}), {}),
    ("base_tilt", (), World(tilt=(0.03, 0.02)), {"tilt_x_rad": (0.03, 0.005), "tilt_y_rad": (0.02, 0.005)}),
    ("torque_ripple", (2,), World(ripple={1: (0.08, 40.0)}), {"per_revolution": (40.0, 0.5)}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "joints", "world", "truth"), FOUND, ids=lambda value: str(value)[:24])
def test_the_effect_is_found_alone_with_its_parameters(name, joints, world, truth):
    found_alone(diagnose_motion(*measured(1, world)[:2], IGNORE), name, joints, truth)


def found_alone(result, name, joints, truth):
    """The effect, beyond chance and on rows that chose nothing, with its parameters within their tolerances."""
    assert [(effect.name, effect.joints) for effect in result.effects] == [(name, joints)]
    effect = result.effects[0]
    for key, (value, tolerance) in truth.items():
        assert effect.parameters[key] == pytest.approx(value, abs=tolerance)
    assert result.verdict == "improved"
    assert effect.evidence.holdout_rms_ratio < 0.75
    assert effect.evidence.p_value < 1e-3
    assert effect.evidence.odds > 10


@pytest.mark.slow
def test_residual_falls_to_the_noise_that_was_put_in():
    table, robot, scale = measured(2, World(load_friction={1: 0.25}, coupling=(4, 5, 1.0)))
    result = diagnose_motion(table, robot, Knowledge(link_std=0.05), only=LOSSES)
    assert {effect.name for effect in result.effects} == {"load_dependent_friction", "axis_coupling"}
    noise = 0.02 * np.sqrt(1.04) * scale
    assert np.all(np.array(result.after.holdout_rms_nm) < 1.8 * noise)
    assert result.before.holdout_rms_nm[4] > 4 * noise[4]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1))
@pytest.mark.parametrize("link_std", [None, np.inf, 0.05])
def test_nothing_is_claimed_on_a_clean_run(seed, link_std):
    table, robot, _ = measured(seed, World(), duration_s=20.0)
    result = diagnose_motion(table, robot, Knowledge(link_std=link_std))
    assert result.effects == ()
    assert result.verdict == "none_needed"
    assert np.isnan(result.noise_floor_nm).all()
    assert result.rejected
    assert not result.data.curves


@pytest.mark.slow
def test_a_torque_outside_the_library_is_not_given_a_name_of_the_library():
    table, robot, _ = measured(3, World(strange={2: 0.3}))
    result = diagnose_motion(table, robot, IGNORE)
    assert result.effects == ()
    assert result.verdict in ("unexplained", "undecided")
    assert result.next or any(finding.where == "J3" for finding in result.findings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("world", "name", "joints"),
    [(World(gain={3: -1.0}), "sign_reversed", (4,)), (World(swap=(1, 2)), "axes_swapped", (2, 3))],
)
def test_commissioning_mistakes_fail_and_are_undone_before_the_rest_is_judged(world, name, joints):
    table, robot, _ = measured(4, world)
    result = diagnose_motion(table, robot, IGNORE)
    assert [(effect.name, effect.joints) for effect in result.effects] == [(name, joints)]
    assert result.failed
    assert np.nanmean(result.after.holdout_rms_nm) < np.nanmean(result.before.holdout_rms_nm)


@pytest.mark.slow
def test_load_is_estimated_through_a_missing_balancer():
    payload = (6.0, 0.03, -0.02, 0.12)
    table, robot, _ = measured(5, World(spring=(0.8, 0.1), payload=payload), duration_s=30.0)
    rivals = frozenset({"balancer_spring", "cable_torque", "base_tilt"})
    result = diagnose_motion(table, robot, Knowledge(), only=rivals)
    found_alone(result, "balancer_spring", (2,), {"phase_rad": (0.1, 0.1)})
    load = result.loads[0]
    assert load.label == "a"
    assert load == result.after.loads[0]
    assert load.mass_kg == pytest.approx(payload[0], abs=3.0 * load.mass_std_kg)
    assert load.com_m == pytest.approx(payload[1:], abs=0.03)
    assert load.mass_std_kg < 1.5


@pytest.mark.slow
def test_without_bare_rows_and_cad_the_load_is_unknown_and_said_so():
    table, robot, _ = measured(6, World(payload=(6.0, 0.0, 0.0, 0.1)))
    load = diagnose_motion(table, robot, IGNORE).loads[0]
    assert np.isnan(load.mass_kg)
    assert "mass_kg" in load.unidentifiable


@pytest.mark.slow
def test_given_holdout_is_judged_and_never_fitted():
    table, robot, _ = measured(7, World(load_friction={1: 0.25}), duration_s=36.0)
    first, last = table.take(table.time_s < 24.0), table.take(table.time_s >= 24.5)
    options = Knowledge(link_std=np.inf)
    result = diagnose_motion(first, robot, options, holdout=last, only=LOSSES)
    assert result.holdout_kind == "given"
    assert [effect.name for effect in result.effects] == ["load_dependent_friction"]
    last.tau_nm[:, 1] += 1e3
    spoilt = diagnose_motion(first, robot, options, holdout=last, only=LOSSES)
    assert spoilt.effects == ()
    assert ("load_dependent_friction", (2,)) in {(item.name, item.joints) for item in spoilt.rejected}
    assert any("does not predict" in finding.what for finding in spoilt.findings)
    assert spoilt.before.holdout_rms_nm[1] > 900
    assert spoilt.before.rms_nm == pytest.approx(result.before.rms_nm, rel=0.1)


@pytest.mark.slow
def test_only_and_without_limit_what_is_tried():
    table, robot, _ = measured(1, World(load_friction={1: 0.25}))
    without = diagnose_motion(table, robot, Knowledge(link_std=np.inf), without=frozenset({"load_dependent_friction"}))
    assert "load_dependent_friction" not in {effect.name for effect in without.effects}
    only = diagnose_motion(table, robot, Knowledge(link_std=np.inf), only=frozenset({"cable_torque"}))
    assert only.effects == ()
    assert {item.name for item in only.rejected} == {"cable_torque"}


def test_too_short_a_run_is_undecided_and_says_what_to_measure():
    table, robot, _ = measured(1, World(), duration_s=1.5)
    result = diagnose_motion(table, robot, IGNORE)
    assert result.verdict == "undecided"
    assert result.effects == ()
    assert result.next


@pytest.mark.slow
def test_losses_by_load_are_found_alone_and_drawn():
    table, robot, _ = measured(1, World(load_friction={1: 0.25}))
    result = diagnose_motion(table, robot, IGNORE)
    found_alone(result, "load_dependent_friction", (2,), {"coefficient": (0.25, 0.02)})
    data, rows = result.data, result.rows
    assert set(data.role) == {"fit"}
    assert np.shape(data.model_before_nm) == np.shape(rows.tau_nm)
    before, after = (
        np.sqrt(np.mean((np.array(rows.tau_nm) - np.array(model)) ** 2, axis=0))
        for model in (data.model_before_nm, rows.model_nm)
    )
    assert after[1] < 0.6 * before[1]
    (curve,) = data.curves
    assert (curve.name, curve.joint, curve.x_unit) == ("load_dependent_friction", 2, "Nm")
    x, y = np.array(curve.x), np.array(curve.y)
    assert (np.diff(x) >= 0).all()
    assert y == pytest.approx(result.effects[0].parameters["coefficient"] * x, rel=0.02, abs=0.02 * np.abs(y).max())
    assert (np.array(curve.low) <= y).all()
    assert np.sqrt(np.mean((np.array(curve.points_y) - 0.25 * x) ** 2)) < 0.5 * np.abs(y).max()


@pytest.mark.slow
@pytest.mark.parametrize(("compliance", "found"), [(2e-4, ["joint_elasticity"]), (0.0, [])])
def test_a_secondary_encoder_shows_an_elastic_joint(compliance, found):
    table, robot, scale = measured(1, World())
    q2nd = table.q_rad.copy()
    noise = np.random.default_rng(5).normal(size=len(q2nd)) * 1e-4
    # the motor is ahead of the link by what the gear winds up under the torque, and the zeros differ
    ahead = compliance * table.tau_nm[:, 1]
    q2nd[:, [0, 2, 3, 4, 5]] = np.nan
    q2nd[:, 1] += 0.002 + noise
    motor = table.q_rad.copy()
    motor[:, 1] += ahead
    result = diagnose_motion(replace(table, q_rad=motor, q2nd_rad=q2nd), robot, IGNORE)
    assert [effect.name for effect in result.effects] == found
    for effect in result.effects:
        assert effect.joints == (2,)
        # friction is in the torque that is read, not in the torque of the links
        assert effect.parameters["compliance_rad_nm"] == pytest.approx(compliance, rel=0.2)
        assert effect.evidence.holdout_rms_ratio < 0.7
        assert result.verdict == "improved"


@pytest.mark.slow
def test_a_scale_that_is_not_certain_is_no_failing_finding():
    table, robot, _ = measured(1, World(gain={4: 2.0**-0.5}))
    result = diagnose_motion(table, robot, IGNORE)
    assert result.verdict in ("undecided", "unexplained")
    assert not [finding for finding in result.findings if finding.severity == "fail"]


@pytest.mark.slow
def test_a_coupling_past_an_axis_is_found_by_the_motor_that_turns_twice():
    """Axis 2 is heavy and hides its share; the motor of axis 4 shows it."""
    table, robot, _ = measured(1, World(coupling=(1, 3, 1.0)))
    result = diagnose_motion(table, robot, IGNORE)
    assert [(effect.name, effect.joints) for effect in result.effects] == [("axis_coupling", (2, 4))]
    assert result.effects[0].parameters["coefficient"] == pytest.approx(1.0, abs=0.1)
    assert result.effects[0].evidence.holdout_rms_ratio < 0.8
    assert result.after.holdout_rms_nm[3] < 0.6 * result.before.holdout_rms_nm[3]
