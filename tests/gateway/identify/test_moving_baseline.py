"""The model to beat in motion: its columns and priors against formulas that are written here."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.data.rows import MOVING, concatenate
from gateway.identify.links import PER_LINK_MOVING, link_prior
from gateway.identify.moving_baseline import FREE, INERTIA_RADIUS_M, SIZE, TIGHT_OFFSET, baseline, free_labels
from gateway.model.motion import prepare
from gateway.model.robot import robot_from_urdf
from tests.support.rigs.tables import make_table

URDF = (Path(__file__).parents[3] / "examples" / "small" / "robot.urdf").read_text()
GRAVITY = np.array([0.0, 0.0, -9.80665])
TRUST = 0.07


def rows(load: str, seed: int, n: int = 300):
    """Sums of sines with random torques, of another size on every axis."""
    generator = np.random.default_rng(seed)
    time = np.arange(n) / 20.0
    omega, phase = generator.uniform(0.5, 2.0, (2, 6)), generator.uniform(0, 6, (2, 6))
    angle = omega[:, None] * time[:, None] + phase[:, None]
    q, qd, qdd = (
        np.sin(angle).sum(0),
        (omega[:, None] * np.cos(angle)).sum(0),
        -(omega[:, None] ** 2 * np.sin(angle)).sum(0),
    )
    tau = generator.normal(size=(n, 6)) * [40.0, 90.0, 60.0, 9.0, 6.0, 3.0]
    return make_table([load] * n, np.full(n, MOVING), q, tau, run=[load] * n, time=time, qd=qd, qdd=qdd)


@pytest.fixture(scope="module")
def robot():
    return robot_from_urdf(URDF, "robot.urdf")


def built(robot, labels, trust=TRUST, known=None):
    table = concatenate([rows(label, seed) for seed, label in enumerate(labels)])
    motion = prepare(table, None, robot, GRAVITY)
    return motion, baseline(motion, trust, known or {})


def torque_scale(motion) -> np.ndarray:
    return np.sqrt((motion.tau_nm**2).mean(axis=0))


def test_links_carry_the_prior_of_the_robot_model(robot):
    motion, base = built(robot, ["none"])
    mean, std = link_prior(robot, TRUST, PER_LINK_MOVING)
    links = np.arange(base.friction.min())
    seen = np.flatnonzero(base.body[:, links].any(axis=1))
    assert base.mean[links] == pytest.approx(mean[seen])
    assert base.precision[links] == pytest.approx(std[seen] ** -2.0)
    assert base.columns[:, :, links] == pytest.approx(motion.rigid[:, :, seen])


def test_friction_columns_are_sign_speed_acceleration_and_one_nearly_free(robot):
    motion, base = built(robot, ["none"])
    scale = torque_scale(motion)
    for axis in range(6):
        where = base.friction[axis]
        own = [motion.sign[:, axis], motion.qd_rad_s[:, axis], motion.qdd_rad_s2[:, axis], np.ones(len(motion))]
        assert base.columns[:, axis, where] == pytest.approx(np.column_stack(own))
        others = np.delete(base.columns[:, :, where], axis, axis=1)
        assert not others.any()
        # under its prior alone each may give 1 / (FREE x 100) times the torque of its axis
        usual = np.sqrt(np.mean(np.square(own), axis=1)) / np.sqrt(base.precision[where])
        assert usual == pytest.approx(scale[axis] / (FREE * 1e2))


def test_offset_is_tight_only_where_no_bare_rows_tell_it_from_gravity(robot):
    motion, loaded = built(robot, ["tool"])
    scale = torque_scale(motion)
    offsets = 1.0 / np.sqrt(loaded.precision[loaded.friction[:, 3]])
    assert offsets[1:5] == pytest.approx(TIGHT_OFFSET * scale[1:5])
    assert offsets[0] > 100.0 * scale[0]  # gravity does not turn the first, vertical axis
    _, with_bare = built(robot, ["none", "tool"])
    assert (1.0 / np.sqrt(with_bare.precision[with_bare.friction[:, 3]]) > 100.0 * scale).all()


def test_load_is_free_in_mass_and_as_wide_as_its_torque_allows_in_inertia(robot):
    motion, base = built(robot, ["none", "tool"])
    part = base.loads["tool"]
    here = motion.load == "tool"
    assert base.columns[here][:, :, part] == pytest.approx(motion.rigid[here][:, :, 50:])
    assert not base.columns[~here][:, :, part].any()
    heaviest_kg = torque_scale(motion).max() / 9.80665
    assert base.precision[part][4:] == pytest.approx((heaviest_kg * INERTIA_RADIUS_M**2) ** -2.0)
    assert not base.mean[part].any()
    columns = base.columns[:, :, part][:, :, :4] / torque_scale(motion)[:, None]
    relative = np.sqrt((columns**2).mean(axis=0)).max(axis=0)
    assert base.precision[part][:4] == pytest.approx((FREE * 1e2 * relative) ** 2)


def test_known_load_is_held_where_it_was_weighed(robot):
    _, base = built(robot, ["none", "tool"], known={"tool": (8.0, np.array([0.1, 0.0, 0.2]))})
    part = base.loads["tool"]
    assert base.mean[part][:4] == pytest.approx([8.0, 0.8, 0.0, 1.6])
    assert 1.0 / np.sqrt(base.precision[part][:4]) == pytest.approx(8e-4)


def test_without_cad_and_bare_rows_the_first_load_lumps_with_link_6(robot):
    assert list(built(robot, ["a", "b"], trust=None)[1].loads) == ["b"]
    assert list(built(robot, ["none", "a"], trust=None)[1].loads) == ["a"]
    assert list(built(robot, ["a", "b"])[1].loads) == ["a", "b"]


def test_a_load_of_given_rows_alone_has_columns_only_where_it_was_weighed(robot):
    """Held rows are never fitted: what they carry has to be known."""
    motion = prepare(rows("none", 1), rows("tool", 2), robot, GRAVITY)
    assert free_labels(motion, TRUST, {}) == []
    assert free_labels(motion, TRUST, {"tool": (8.0, np.zeros(3))}) == ["tool"]
    assert free_labels(prepare(rows("tool", 1), rows("none", 2), robot, GRAVITY), TRUST, {}) == ["tool"]


def test_without_cad_a_link_may_be_as_heavy_as_the_strongest_axis_holds_at_half_the_reach(robot):
    motion, base = built(robot, ["none"], trust=None)
    reach = np.linalg.norm(robot.placement[1:, :3, 3], axis=1)
    heaviest = SIZE * torque_scale(motion).max() / (9.80665 * 0.5 * reach.sum())
    seen = np.flatnonzero(base.body[:, : base.friction.min()].any(axis=1))
    std = 1.0 / np.sqrt(base.precision[: len(seen)])
    length = np.maximum(np.append(reach, 0.0), 0.15 * reach.sum())
    power = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    assert std == pytest.approx(heaviest * length[seen // 10] ** power[seen % 10])
    assert not base.mean[: len(seen)].any()


def test_friction_of_each_run_is_held_to_its_scatter(robot):
    dry_nm = np.array([40.0, 30.0, 20.0, 10.0, 5.0, 2.0])
    parts = [rows("none", seed) for seed in (1, 2)]
    table = concatenate(
        [replace(part, run=np.array([name] * len(part))) for name, part in zip("ab", parts, strict=True)]
    )
    table = replace(table, tau_nm=dry_nm * np.sign(table.qd_rad_s))
    motion = prepare(table, None, robot, GRAVITY)
    base = baseline(motion, TRUST, {})
    for axis in range(6):
        for number in range(2):
            column = base.columns[:, :, base.level[axis, number]]
            expected = np.where(motion.run == number, motion.sign[:, axis], 0.0)
            assert np.array_equal(column[:, axis], expected)
            assert not np.delete(column, axis, axis=1).any()
    assert base.precision[base.level] ** -0.5 == pytest.approx(0.1 * dry_nm[:, None] * np.ones(2), rel=0.05)
    alone = prepare(table.take(table.run == "a"), None, robot, GRAVITY)
    assert baseline(alone, TRUST, {}).level.shape == (6, 0), "the friction of one run is that of all"
