"""The model that effects are tried against: columns and priors against formulas, fits against those of an estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.diagnose.moving.null_model import MovingNoise, null_model
from gateway.diagnose.moving.penalised_fit import MovingProblem, fit
from gateway.identify.knowledge import Knowledge
from gateway.identify.links import PER_LINK_MOVING, link_prior
from gateway.identify.motion.problem import Contrasts, MotionProblem, settle
from gateway.model.motion import prepare
from tests.data.moving_arm import GRAVITY, several
from tests.gateway.diagnose.moving.conftest import random_rows

TRUST = 0.07


def rows(load, seed):
    return random_rows(seed, 300, load, load, [40.0, 90.0, 60.0, 9.0, 6.0, 3.0])


def built(robot, labels, trust=TRUST, known=None):
    table = concatenate([rows(label, seed) for seed, label in enumerate(labels)])
    motion = prepare(table, None, robot, GRAVITY)
    return motion, null_model(motion, trust, Knowledge(known=known or {}))


def torque_scale(motion) -> np.ndarray:
    return np.sqrt((motion.tau_nm**2).mean(axis=0))


def test_links_carry_the_prior_of_the_robot_model(robot):
    """As bodies: a heavier link has the centre of gravity of its drawing, with the uncertainty of the drawing."""
    motion, null = built(robot, ["none"])
    mean, std = link_prior(robot, TRUST, PER_LINK_MOVING)
    links, prior = null.columns.links, null.columns.prior
    assert null.columns.design[:, :, links] == pytest.approx(motion.rigid)
    covariance = np.linalg.inv(prior.precision[np.ix_(links, links)])
    assert covariance @ prior.pull[links] == pytest.approx(mean, abs=1e-9)
    assert np.sqrt(np.diag(covariance))[::10] == pytest.approx(std[::10])
    heavier = np.outer([1.0, *(mean[1:4] / mean[0])], [1.0, *(mean[1:4] / mean[0])]) * std[0] ** 2
    expected = heavier + np.diag([0.0, *std[1:4] ** 2])
    assert covariance[:4, :4] == pytest.approx(expected)


def test_trust_is_the_width_of_the_prior_of_the_links_alone(robot):
    _, null = built(robot, ["none", "tool"])
    _, other = built(robot, ["none", "tool"], trust=0.2)
    assert null.trusting(0.2).columns.prior.precision == pytest.approx(other.columns.prior.precision)
    assert null.trusting(0.2).columns.prior.pull == pytest.approx(other.columns.prior.pull)


def test_friction_columns_are_sign_speed_acceleration_and_one(robot):
    motion, null = built(robot, ["none"])
    for axis in range(6):
        where = null.friction[axis]
        own = [motion.sign[:, axis], motion.qd_rad_s[:, axis], motion.qdd_rad_s2[:, axis], np.ones(len(motion))]
        assert null.columns.design[:, axis, where] == pytest.approx(np.column_stack(own))
        others = np.delete(null.columns.design[:, :, where], axis, axis=1)
        assert not others.any()
        assert np.isinf(null.columns.prior.std[where]).all()


def dry(seed_by_run, dry_nm, load="none"):
    """Runs in which friction is all torque."""
    parts = [rows(load, seed) for seed in seed_by_run]
    named = [replace(part, run=np.array([str(k)] * len(part))) for k, part in enumerate(parts)]
    table = concatenate(named)
    return replace(table, tau_nm=dry_nm * np.sign(table.qd_rad_s))


DRY_NM = np.array([40.0, 30.0, 20.0, 10.0, 5.0, 2.0])


@pytest.mark.parametrize(("load", "held"), [("none", False), ("tool", True)])
def test_an_offset_is_a_share_of_friction_where_it_could_be_the_gravity_of_a_load(robot, load, held):
    motion = prepare(dry([1], DRY_NM, load), None, robot, GRAVITY)
    null = null_model(motion, TRUST, Knowledge())
    std = null.columns.prior.std[null.friction[:, 3]]
    assert std == (pytest.approx(0.03 * DRY_NM, rel=0.05) if held else pytest.approx(np.full(6, np.inf)))


def test_load_is_free_in_mass_and_as_wide_as_its_torque_allows_in_inertia(robot):
    motion, null = built(robot, ["none", "tool"])
    part = null.columns.loads["tool"] + np.arange(10)
    here = motion.load == "tool"
    assert null.columns.design[here][:, :, part] == pytest.approx(motion.rigid[here][:, :, 50:])
    assert not null.columns.design[~here][:, :, part].any()
    heaviest_kg = torque_scale(motion).max() / 9.80665
    assert null.columns.prior.std[part] == pytest.approx([np.inf] * 4 + [heaviest_kg * 0.2**2] * 6)


def test_known_load_is_torque_that_is_known(robot):
    motion, null = built(robot, ["none", "tool"], known={"tool": (8.0, 0.1, 0.0, 0.2)})
    assert not null.columns.loads
    # m, m c, and the inertia of a point about the flange
    body = np.array([8.0, 0.8, 0.0, 1.6, 8 * 0.04, 0.0, -8 * 0.02, 8 * 0.05, 0.0, 8 * 0.01])
    expected = (motion.rigid[:, :, 50:] @ body) * (motion.load == "tool")[:, None]
    assert null.columns.known_nm == pytest.approx(expected)


def test_without_cad_and_bare_rows_the_first_load_lumps_with_link_6(robot):
    assert list(built(robot, ["a", "b"], trust=None)[1].columns.loads) == ["b"]
    assert list(built(robot, ["none", "a"], trust=None)[1].columns.loads) == ["a"]
    assert list(built(robot, ["a", "b"])[1].columns.loads) == ["a", "b"]


def test_a_load_of_given_rows_alone_has_no_columns(robot):
    """Held rows are never fitted: what they carry has to be known."""
    prepared = prepare(rows("none", 1), rows("tool", 2), robot, GRAVITY)
    assert not null_model(prepared, TRUST, Knowledge()).columns.loads
    fitted = prepare(rows("tool", 1), rows("none", 2), robot, GRAVITY)
    assert list(null_model(fitted, TRUST, Knowledge()).columns.loads) == ["tool"]


def test_without_cad_a_link_may_be_as_heavy_as_the_strongest_axis_holds_at_half_the_reach(robot):
    motion, null = built(robot, ["none"], trust=None)
    reach = np.linalg.norm(robot.placement[1:, :3, 3], axis=1)
    heaviest = torque_scale(motion).max() / (9.80665 * 0.5 * reach.sum())
    length = np.maximum(np.append(reach, 0.0), 0.15 * reach.sum())
    power = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    std = (heaviest * length[:, None] ** power).ravel()
    links = null.columns.links
    covariance = np.linalg.inv(null.columns.prior.precision[np.ix_(links, links)])
    # the torque that links of this size give, whichever parameters are counted
    rows, own = motion.rigid[::30].reshape(-1, 60), null.columns.design[::30][:, :, links].reshape(-1, len(links))
    assert own @ covariance @ own.T == pytest.approx((rows * std**2) @ rows.T, rel=1e-6, abs=1e-6)
    assert not null.columns.prior.pull[links].any()
    assert own == pytest.approx(rows @ null.columns.to_links, abs=1e-8), "the links of a fit give the fitted torque"


def test_friction_of_each_run_is_held_to_its_scatter(robot):
    table = dry([1, 2], DRY_NM)
    motion = prepare(table, None, robot, GRAVITY)
    columns = null_model(motion, TRUST, Knowledge()).columns
    for axis in range(6):
        for number in range(2):
            index = columns.names.index(f"run_coulomb_{number + 1}[J{axis + 1}]")
            expected = np.where(motion.run == number, motion.sign[:, axis], 0.0)
            assert np.array_equal(columns.design[:, axis, index], expected)
            assert not np.delete(columns.design[:, :, index], axis, axis=1).any()
            assert columns.prior.std[index] == pytest.approx(0.1 * DRY_NM[axis], rel=0.05)
    alone = prepare(table.take(table.run == "0"), None, robot, GRAVITY)
    names = null_model(alone, TRUST, Knowledge()).columns.names
    assert not [name for name in names if name.startswith("run_coulomb")], "the friction of one run is that of all"


@pytest.mark.parametrize("trust", [TRUST, None])
@pytest.mark.parametrize("known", [{}, {"a": (3.0, 0.02, -0.01, 0.08)}])
def test_a_fit_of_the_search_is_that_of_an_estimate_with_the_same_columns(trust, known):
    """Two methods for one minimum: normal equations of summed products, and an orthogonal reduction of the rows."""
    loads = {"none": None, "a": (3.0, 0.02, -0.01, 0.08), "b": (8.0, 0.05, 0.0, 0.12)}
    table, robot = several(3, loads, load_friction=(0.25, 0.1))
    motion = prepare(table, None, robot, GRAVITY)
    null = null_model(motion, trust, Knowledge(known=known))
    noise = MovingNoise(np.linspace(0.5, 3.0, 6), np.full(6, 0.25))
    everything = np.ones(len(motion), dtype=bool)
    found = fit(MovingProblem(motion, null, noise, ()), (), everything, ~everything)
    problem = MotionProblem.of(null.columns, table, motion.judged, Contrasts())
    settled = settle(problem, 1.0 / noise.weight)
    assert any(found.at_limit(index) for index in null.usual), "limits are part of the model"
    judged = motion.judged
    assert found.modelled.total_nm[judged] == pytest.approx(settled.here.model_nm[judged], abs=0.02)
    labels = list(null.columns.loads.values())
    assert found.value[labels] == pytest.approx(settled.solution.value[labels], rel=1e-4)
    std, expected = (np.sqrt(np.diag(each)) for each in (found.spread, settled.free.covariance))
    assert std[labels] == pytest.approx(expected[labels], rel=1e-3)
