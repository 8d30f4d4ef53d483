"""What the report draws of a diagnosis, against the effect that was built into the simulated arm."""

from __future__ import annotations

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.diagnose import diagnose
from tests.data.resting_arm import Bench, effect

FRESH = 3
COEFFICIENT = 0.5


def diagnosed(hidden, *rivals):
    """Search of an arm for an effect and rivals, ten poses bare and loaded, three fresh ones loaded."""
    bench = Bench(4, [hidden], poses=10 + FRESH)
    first, last = bench.poses[:10], bench.poses[10:]
    seen = concatenate([bench.table(first, "none"), bench.table(first, "tool")])
    fresh, only = bench.table(last, "tool", 10), frozenset({hidden["name"], *rivals})
    result = diagnose(seen, bench.robot, bench.options, holdout=fresh, holdout_kind="fresh", only=only)
    return result, bench.plant


@pytest.fixture(scope="module")
def friction():
    return diagnosed(effect("load_dependent_friction", [3], coefficient=COEFFICIENT), "base_tilt")


def test_every_visit_is_drawn_the_fresh_ones_too(friction):
    result, _ = friction
    data, rows = result.data, result.rows
    assert len(rows.pose) == 20 + FRESH
    assert data.role == ("fit",) * 20 + ("fresh",) * FRESH
    assert np.shape(data.model_before_nm) == np.shape(rows.tau_nm) == (20 + FRESH, 6)
    assert rows.pose[-FRESH:] == (10, 11, 12)
    left = np.array(rows.tau_nm) - np.array(rows.model_nm)
    rms = np.sqrt(np.mean(left[:20] ** 2, axis=0))
    assert rms == pytest.approx(np.array(result.after.rms_nm), rel=0.8)


def test_the_curve_of_a_friction_is_its_coefficient_times_the_torque(friction):
    result, _ = friction
    (curve,) = result.data.curves
    assert (curve.name, curve.joint) == ("load_dependent_friction", 3)
    assert "half the difference" in curve.y_label
    assert curve.x_unit == "Nm"
    x, y = np.array(curve.x), np.array(curve.y)
    low, high = np.array(curve.low), np.array(curve.high)
    assert (np.diff(x) >= 0).all()
    assert (low <= y).all()
    assert (y <= high).all()
    coefficient = result.effects[0].parameters["coefficient"]
    assert y == pytest.approx(coefficient * np.abs(x), rel=0.02, abs=0.02 * y.max())
    # some of the friction built in is lost while a joint settles, none is gained
    assert 0.4 * COEFFICIENT < coefficient < COEFFICIENT
    std = result.effects[0].std["coefficient"]
    assert high - y == pytest.approx(1.96 * std * np.abs(x), rel=0.02, abs=0.02 * y.max())
    points = np.array(curve.points_y)
    assert len(points) == 20 + FRESH
    assert np.sqrt(np.mean((points - coefficient * np.abs(curve.points_x)) ** 2)) < 0.2 * y.max()


@pytest.mark.slow
def test_a_balancer_is_drawn_over_its_joint_angle():
    spring = {"stiffness_n_m": 2e4, "lever_m": 0.2, "anchor_m": 0.5, "free_length_m": 0.2}
    result, plant = diagnosed(effect("balancer_spring", [2], **spring), "cable_torque", "torque_offset")
    curve = next(item for item in result.data.curves if item.name == "balancer_spring")
    assert (curve.joint, curve.x_label, curve.x_unit) == (2, "q2", "rad")
    x, y = np.array(curve.x), np.array(curve.y)
    truth = []
    for angle in x:
        q = np.zeros(6)
        q[1] = angle
        truth.append(-plant.passive_torque(q, 0.0, np.zeros(6))[1])
    # sines of the angle and a constant may be attributed to the links: the rest of the spring is the same shape
    shapes = np.column_stack([np.ones_like(x), np.sin(x), np.cos(x)])
    rest = [values - shapes @ np.linalg.lstsq(shapes, values, rcond=None)[0] for values in (y, np.array(truth))]
    assert np.linalg.norm(rest[0] - rest[1]) < 0.3 * np.linalg.norm(rest[1])
    assert len(curve.points_x) == 20 + FRESH


@pytest.mark.slow
def test_nothing_found_draws_no_curve():
    result, _ = diagnosed(effect("base_tilt", [], tilt_x_rad=0.0, tilt_y_rad=0.0), "cable_torque")
    assert result.effects == ()
    assert not result.data.curves
    assert not result.data.model_before_nm
