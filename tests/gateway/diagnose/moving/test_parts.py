"""Parts of the diagnosis of moving runs against closed forms and against fits done in full."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.diagnose.held_out_residuals import Held
from gateway.diagnose.moving.diagnosis import diagnose_motion
from gateway.diagnose.moving.moving_rows import blocks
from gateway.diagnose.moving.null_model import MovingNoise, null_model
from gateway.diagnose.moving.penalised_fit import MovingProblem, fit
from gateway.diagnose.moving.trial import candidates, judge, put_on_trial, state_of, suggested
from gateway.errors import DataUnusable, InputError
from gateway.identify.knowledge import Knowledge
from gateway.identify.links import link_values
from gateway.model.base import moving_base
from gateway.model.effect import nowhere
from gateway.model.effects import LIBRARY
from gateway.model.effects.axis_coupling import MotorCoupling
from gateway.model.effects.balancer_spring import CoilBalancer, HarmonicBalancer
from gateway.model.effects.cable_torque import HarmonicCable
from gateway.model.effects.torque_constant_scale import TorqueConstantScale
from gateway.model.effects.velocity_friction import Stribeck
from gateway.model.motion import prepare, smooth_sign
from tests.data.arms import peer_of, torque_of
from tests.data.moving_arm import GRAVITY, URDF
from tests.gateway.diagnose.moving.conftest import random_rows


def problem_of(robot, table, trust=None, count=4):
    """Gains and load frictions held at 0: with them the model is not linear."""
    motion = prepare(table, None, robot, GRAVITY)
    null = null_model(motion, trust, Knowledge())
    null = null.held(null.usual, 0.0)
    return MovingProblem(motion, null, MovingNoise(np.ones(6), np.ones(6)), blocks(motion, count))


@pytest.mark.parametrize(
    "term",
    [
        Stribeck(2, 0.6),
        MotorCoupling(4, 5, 0.7),
        HarmonicCable(4),
        HarmonicBalancer(),
        CoilBalancer(largest_nm=1.0),
    ],
    ids=lambda term: type(term).__name__,
)
def test_a_trial_gives_what_the_full_refit_gives(robot, term):
    problem = problem_of(robot, random_rows(), trust=0.05)
    state = state_of(problem, ())
    trial = put_on_trial(problem, state.fits, state.full, term)
    assert trial is not None
    refit = state_of(problem, (term,))
    assert trial.value == pytest.approx(refit.full.value[-term.count :], rel=1e-4, abs=1e-8)
    assert trial.held.residual_nm == pytest.approx(refit.held.residual_nm, abs=1e-5)


def test_no_column_contains_the_measured_torque(robot):
    problem = problem_of(robot, random_rows(load="a"), trust=0.05)
    state = state_of(problem, ())
    other = replace(problem.motion, tau_nm=problem.motion.tau_nm + 17.0)
    pool = candidates(problem, state.full, frozenset(LIBRARY)) + suggested(problem, state.full, frozenset(LIBRARY))
    shown = {name for name, effect in LIBRARY.items() if effect.in_motion is not nowhere}
    assert {term.name for term in pool} == shown - {"thermal_drift"}, "too short a run to drift"
    for term in pool:
        columns = term.columns(problem.motion, state.full.modelled)
        assert columns.shape == (len(problem.motion), len(term.enters(6)), term.count)
        assert np.array_equal(columns, term.columns(other, state.full.modelled))


def test_blocks_hold_out_every_row_once_and_keep_a_gap(robot):
    motion = prepare(concatenate([random_rows(0, run="1"), random_rows(1, run="2")]), None, robot, GRAVITY)
    splits = blocks(motion, 6)
    assert np.sum([test for _, test in splits], axis=0).tolist() == [1] * len(motion)
    for train, test in splits:
        assert not (train & test).any()
        run = motion.run[test][0]
        near, mine = train & (motion.run == run), test & (motion.run == run)
        assert np.abs(motion.time_s[near][:, None] - motion.time_s[mine]).min() > 0.29
        assert set(motion.run[test]) == {0, 1}, "a part of every run"
        assert set(motion.run[train]) == {0, 1}


def test_what_one_block_alone_shows_proves_no_effect(robot):
    """Closed form: the residual of one axis halves in every block, or is gone in one and as large in the others."""
    problem, axis = problem_of(robot, random_rows(11, n=600), trust=0.05, count=6), 2
    state, term = state_of(problem, ()), HarmonicCable(axis)
    before = Held(np.random.default_rng(11).choice([-1.0, 1.0], problem.motion.tau_nm.shape), problem.motion.judged)
    factor = {"all": np.full(len(problem.motion), 0.5), "one": np.where(problem.splits[0][1], 0.0, 1.0)}
    for where, share in factor.items():
        residual = before.residual_nm.copy()
        residual[:, axis] *= share
        after = Held(residual, before.counted)
        found = judge(problem, state.fits, term, before, after, (np.ones(1), np.eye(1), -50.0, 7.0))
        log = np.log(before.square[axis] / after.square[axis])
        assert found.gain - 7.0 == pytest.approx(0.5 * before.counted[:, axis].sum() * log, rel=0.2)
        left = 5.0 / 6.0 if where == "all" else 0.0
        assert found.sure - 7.0 == pytest.approx(left * (found.gain - 7.0), rel=0.05, abs=1e-9)


def test_body_columns_with_the_drawn_values_give_the_torque_of_the_drawing(robot):
    motion = prepare(random_rows(3, n=40), None, robot, GRAVITY)
    expected = torque_of(peer_of(URDF)[0], motion.q_rad, motion.qd_rad_s, motion.qdd_rad_s2)
    assert motion.rigid @ link_values(robot).ravel() == pytest.approx(expected, abs=1e-8)


def test_smooth_sign_is_odd_and_saturates_above_a_few_percent_of_top_speed():
    assert smooth_sign(np.array([-0.1, 0.0, 0.1]), 2.0) == pytest.approx([-1.0, 0.0, 1.0], abs=1e-3)
    assert 0.4 < smooth_sign(np.array([0.01]), 2.0)[0] < 0.6


def test_scale_of_a_reading_is_found_although_the_links_are_unknown(robot):
    problem = problem_of(robot, random_rows(5, n=600))
    generator = np.random.default_rng(5)
    chosen = moving_base(robot, tuple(GRAVITY)).indices
    truth = link_values(robot).ravel()[chosen] * (1 + 0.1 * generator.normal(size=len(chosen)))
    tau = problem.motion.rigid[:, :, chosen] @ truth
    tau[:, 2] *= 0.8
    problem = replace(
        problem, motion=replace(problem.motion, tau_nm=tau), noise=MovingNoise(np.full(6, 1e-3), np.ones(6))
    )
    everything = np.ones(len(tau), dtype=bool)
    found = fit(problem, (TorqueConstantScale(2),), everything, ~everything)
    assert found.value[-1] == pytest.approx(-0.2, abs=0.01)


def test_an_axis_that_was_not_measured_or_does_not_move_is_unknown_in_every_list(robot):
    table = random_rows(6)
    table.tau_nm[:, 0] = np.nan
    table.qd_rad_s[:, 3] = 0.0
    result = diagnose_motion(table, robot, Knowledge(link_std=np.inf), only=frozenset({"velocity_friction"}))
    for values in (result.before.rms_nm, result.after.holdout_rms_nm, result.friction_band_nm):
        assert np.isnan(values).tolist() == [True, False, False, True, False, False]
    assert {finding.where for finding in result.findings} >= {"J1", "J4"}


def test_bad_input_is_refused(robot):
    table = random_rows(7, n=200)
    with pytest.raises(InputError, match="--known b"):
        diagnose_motion(table, robot, Knowledge(known={"b": (1.0, 0.0, 0.0, 0.0)}))
    with pytest.raises(DataUnusable, match="--holdout: load b"):
        diagnose_motion(table, robot, Knowledge(), holdout=random_rows(8, n=100, run="2", load="b"))
    still = random_rows(9, n=100)
    still.qd_rad_s[:] = 0.0
    with pytest.raises(DataUnusable, match="no axis moves"):
        diagnose_motion(still, robot, Knowledge())
