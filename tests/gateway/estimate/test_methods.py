"""What each estimator of rest rows does beyond the common checks."""

from dataclasses import replace

import numpy as np
import pytest

from gateway.data.rows import concatenate
from gateway.data.table import read_csv
from gateway.errors import DataUnusable, InputError
from gateway.estimate import Coefficient, estimate, run
from gateway.identify.knowledge import Knowledge
from gateway.model.robot import with_flange
from gateway.result.result import from_json, to_json

TOOL = (8.0, 0.12, -0.03, 0.05)


def without_load(table, label):
    return table.take(table.load != label)


# ---------------------------------------------------------------- difference


def test_difference_leaves_out_poses_without_a_reference_and_says_so(arm, poses, measured):
    table = measured(arm, poses, {"none": None, "tool": TOOL})
    table = table.take(~((table.load == "none") & (table.pose == 4)))
    found = estimate(table, arm.robot, Knowledge(link_std=np.inf), "difference")
    np.testing.assert_allclose(found.loads[0].mass_kg, TOOL[0], rtol=1e-6)
    assert any("poses 4 " in finding.what for finding in found.findings)


def test_difference_needs_common_poses_and_a_known_load(arm, poses, measured):
    loaded = measured(arm, poses[:6], {"tool": TOOL})
    with pytest.raises(DataUnusable, match="a known load"):
        estimate(loaded, arm.robot, Knowledge(link_std=np.inf), "difference")
    bare = measured(arm, poses[6:], {"none": None})
    apart = replace(bare, pose=bare.pose + 100)
    from gateway.data.rows import concatenate

    with pytest.raises(DataUnusable, match="shares no pose"):
        estimate(concatenate([loaded, apart]), arm.robot, Knowledge(link_std=np.inf), "difference")
    with pytest.raises(DataUnusable, match="nothing to estimate"):
        estimate(bare, arm.robot, Knowledge(link_std=np.inf), "difference")


def test_difference_of_one_sided_visits_keeps_what_friction_scatters(arm, poses, measured):
    """From one side the band cancels; the scatter does not, and the intervals say so."""
    table = measured(arm, poses, {"none": None, "tool": TOOL}, np.random.default_rng(3), left=0.2, sides=(1,))
    load = estimate(table, arm.robot, Knowledge(link_std=np.inf), "difference").loads[0]
    assert abs(load.mass_kg - TOOL[0]) < 3 * load.mass_std_kg
    assert 0.05 < load.mass_std_kg < 2.0


# ---------------------------------------------------------------- coefficient


@pytest.mark.data
def test_column_b_alone_is_refused_too(measured_data):
    table = without_load(qh165(measured_data), "a")
    result = run(table, None, Knowledge(link_std=np.inf), "coefficient", coefficient=COEFFICIENT)
    assert result.failed
    (load,) = from_json(to_json(result)).loads
    assert load.label == "b"
    assert "5 of 10 motor torques exceed the rated 23.875 Nm" in load.refused
    assert [finding.where for finding in result.findings if finding.severity == "fail"] == ["load b"]


def qh165(measured_data):
    return read_csv(measured_data / "qh165" / "table2.csv", None)


COEFFICIENT = Coefficient(2, "x_k2_m", 210, 0.8, 23.875)


@pytest.mark.data
def test_the_mass_of_column_a_is_reported_to_be_as_right_as_a_lever_that_was_computed_from_it(measured_data):
    """`k = 168 dtau_a / (9.81 * 21 kg)` in every row, also beyond the 2.50 m that the arm reaches from axis 2."""
    table = qh165(measured_data)
    result = run(table, None, Knowledge(link_std=np.inf), "coefficient", coefficient=COEFFICIENT)
    motor, lever = table.motor_torque_nm[:, 1], table.extra["x_k2_m"]
    load, bare = (table.load == name for name in ("a", "none"))
    assert list(table.pose[load]) == list(table.pose[bare])
    back = (motor[load] - motor[bare]) * 168 / (9.81 * 21)
    np.testing.assert_allclose(lever[load], back, atol=0.01)
    assert (np.abs(lever[load]) > 2.50).sum() == 3
    (message,) = [each.what for each in result.findings if "lever" in each.what and each.severity == "info"]
    assert message == "the uncertainty of the mass does not include errors of the lever in column x_k2_m"


@pytest.mark.data
def test_column_b_does_not_come_near_its_stated_mass(measured_data):
    options = Knowledge(link_std=np.inf, known={"b": (70.0, 0.0, 0.0, 0.0)})
    result = run(qh165(measured_data), None, options, "coefficient", coefficient=COEFFICIENT)
    load = {item.label: item for item in result.loads}
    assert "no pose comes near the stated 70 kg" in load["b"].refused
    assert load["a"].refused is None


def lever_table(table_of, motor_by_load, lever, **columns):
    """Axis 2 motor torque per pose; the other axes are not measured."""
    labels = [label for label, motor in motor_by_load.items() for _ in motor]
    poses = [k for motor in motor_by_load.values() for k in range(len(motor))]
    motor = np.full((len(labels), 6), np.nan)
    motor[:, 1] = np.concatenate([np.asarray(m, dtype=float) for m in motor_by_load.values()])
    extra = {"x_k": np.tile(lever, len(motor_by_load))}
    blank = np.full((len(labels), 6), np.nan)
    return table_of(labels, poses, np.zeros((len(labels), 6)), blank, motor=motor, extra=extra, **columns)


def test_coefficient_by_hand(table_of):
    """m = N eta dtau / (g k): 100 * 0.5 * 1.961330 / (9.80665 * 1) = 10 kg."""
    how = Coefficient(2, "x_k", 100, 0.5)
    table = lever_table(table_of, {"none": [1.0, 2.0], "tool": [1.0 + 1.96133, 2.0 - 3.92266]}, [1.0, -2.0])
    found = estimate(table, None, Knowledge(link_std=np.inf), "coefficient", coefficient=how)
    np.testing.assert_allclose(list(found.loads[0].per_pose_mass_kg.values()), 10.0, rtol=1e-9)


def test_coefficient_takes_each_side_through_the_gear(table_of):
    """Behind eta = 0.5, driving 1.2 Nm and driven back 0.5 Nm are (0.6 + 1.0) / 2; bare, 0.8 and 0.4: 0.6."""
    how = Coefficient(2, "x_k", 100, 0.5)
    labels, poses = ["none", "none", "tool", "tool"], [0, 0, 0, 0]
    motor, direction = np.full((4, 6), np.nan), np.zeros((4, 6))
    motor[:, 1], direction[:, 1] = [0.8, 0.4, 1.2, 0.5], [1, -1, 1, -1]
    blank = np.full((4, 6), np.nan)
    table = table_of(
        labels, poses, np.zeros((4, 6)), blank, motor=motor, direction=direction, extra={"x_k": np.ones(4)}
    )
    found = estimate(table, None, Knowledge(link_std=np.inf), "coefficient", coefficient=how)
    assert found.loads[0].mass_kg == pytest.approx(100.0 * (0.8 - 0.6) / 9.80665)


def test_moving_rows_beside_rest_rows_are_left_out_and_said(arm, poses, measured):
    table = measured(arm, poses, {"none": None, "tool": TOOL})
    alone = estimate(table, arm.robot, Knowledge(link_std=np.inf), "joint")
    assert not [finding for finding in alone.findings if finding.where == "moving rows"]
    moving = replace(table.take(np.arange(3)), moving=np.ones(3, dtype=bool), run=np.array(["m"] * 3))
    mixed = estimate(concatenate([table, moving]), arm.robot, Knowledge(link_std=np.inf), "joint")
    assert mixed.loads[0].mass_kg == pytest.approx(alone.loads[0].mass_kg)
    said = [finding.what for finding in mixed.findings if finding.where == "moving rows"]
    assert said == ["3 moving rows were left out beside the rest rows"]


def test_coefficient_with_a_known_first_load_and_a_repeated_visit(table_of):
    how = Coefficient(2, "x_k", 100, 0.5)
    table = lever_table(table_of, {"first": [1.0, 1.0], "tool": [2.96133, 2.96133]}, [1.0, 1.0])
    options = Knowledge(link_std=np.inf, known={"first": (5.0, 0.0, 0.0, 0.0)})
    assert estimate(table, None, options, "coefficient", coefficient=how).loads[0].mass_kg == pytest.approx(15.0)


@pytest.mark.parametrize(
    ("how", "known", "error", "says"),
    [
        (None, {}, InputError, "--lever"),
        (Coefficient(2, "x_k", gear_efficiency=0.5), {}, InputError, "--gear-ratio"),
        (Coefficient(2, "x_other", 100, 0.5), {}, InputError, "x_other"),
        (Coefficient(3, "x_k", 100, 0.5), {}, DataUnusable, "J3"),
        (Coefficient(2, "x_k", 100, 0.5), {"x": (1.0, 0.0, 0.0, 0.0)}, InputError, "--known x"),
    ],
)
def test_coefficient_refusals(table_of, how, known, error, says):
    table = lever_table(table_of, {"none": [1.0, 2.0], "tool": [3.0, 4.0]}, [1.0, 1.0])
    with pytest.raises(error, match=says):
        estimate(table, None, Knowledge(known=known), "coefficient", coefficient=how)


def test_coefficient_without_reference(table_of):
    table = lever_table(table_of, {"tool": [3.0, 4.0]}, [1.0, 1.0])
    with pytest.raises(DataUnusable, match="none"):
        estimate(table, None, Knowledge(link_std=np.inf), "coefficient", coefficient=Coefficient(2, "x_k", 100, 0.5))


# ---------------------------------------------------------------- posture


def test_posture_against_a_stored_bare_identification(arm, poses, measured):
    """Other postures than the bare ones, through the result file."""
    rng = np.random.default_rng(4)
    stored = run(measured(arm, poses, {"none": None}, rng, left=0.05), arm.robot, Knowledge(link_std=np.inf))
    assert stored.bare is not None
    assert stored.loads == ()
    bare = from_json(to_json(stored)).bare
    other = np.random.default_rng(5).uniform(-1.5, 1.5, (10, 6))
    table = measured(arm, other, {"tool": TOOL}, rng, left=0.05)
    for method in ("posture", "joint"):
        load = estimate(table, arm.robot, Knowledge(link_std=np.inf, bare=bare), method).loads[0]
        std = np.concatenate([[load.mass_std_kg], load.com_std_m])
        assert (np.abs(np.concatenate([[load.mass_kg], load.com_m]) - TOOL) < 3.5 * std).all()
        assert load.mass_std_kg < 0.5


def test_posture_without_anything_known_of_the_bare_arm_says_what_lumps(arm, poses, measured):
    table = measured(arm, poses, {"tool": TOOL})
    with pytest.raises(DataUnusable, match=r"_6.*--bare"):
        estimate(table, arm.robot, Knowledge(link_std=np.inf), "posture")
    joint = run(table, arm.robot, Knowledge(link_std=np.inf))
    assert np.isnan(joint.loads[0].mass_kg)
    assert joint.loads[0].unidentifiable == ("mass_kg", "com_x_m", "com_y_m", "com_z_m", "inertia_kg_m2")
    assert any("cannot be separated from link 6" in finding.what for finding in joint.findings)
    exact = estimate(table, arm.robot, Knowledge(link_std=0.0), "posture").loads[0]
    assert exact.mass_kg == pytest.approx(TOOL[0], rel=1e-4)


def test_posture_notices_a_dress_pack_that_came_with_the_load(arm, poses, measured):
    stored = run(
        measured(arm, poses, {"none": None}, np.random.default_rng(6), left=0.01), arm.robot, Knowledge(link_std=np.inf)
    )
    dressed = type(arm)(text=arm.text.replace('<mass value="15"/>', '<mass value="25"/>'))
    table = measured(dressed, poses, {"tool": TOOL}, np.random.default_rng(7), left=0.01)
    found = estimate(table, arm.robot, Knowledge(link_std=np.inf, bare=stored.bare), "posture")
    assert any("more than a load has changed" in finding.what for finding in found.findings)
    clean = estimate(measured(arm, poses, {"tool": TOOL}, np.random.default_rng(8), left=0.01),
                     arm.robot, Knowledge(link_std=np.inf, bare=stored.bare), "posture")  # fmt: skip
    assert not any("more than a load" in finding.what for finding in clean.findings)


def test_a_stored_bare_arm_by_other_base_parameters_gives_the_same_load(arm, poses, measured):
    """Which columns stand for a dependent set differs from computer to computer; what they determine does not."""
    rng = np.random.default_rng(4)
    bare = run(measured(arm, poses, {"none": None}, rng, left=0.05), arm.robot, Knowledge(link_std=np.inf)).bare
    rank, count = len(bare.value), len(bare.gain_covariance)
    mixed = np.eye(count)
    mixed[:rank, :rank] += 0.3 * np.random.default_rng(1).standard_normal((rank, rank))
    turn = mixed[:rank, :rank]
    other = replace(
        bare,
        value=tuple(turn @ bare.value),
        covariance=tuple(map(tuple, turn @ np.array(bare.covariance) @ turn.T)),
        combination=tuple(map(tuple, turn @ np.array(bare.combination))),
        gain_covariance=tuple(map(tuple, mixed @ np.array(bare.gain_covariance) @ mixed.T)),
    )
    table = measured(arm, np.random.default_rng(5).uniform(-1.5, 1.5, (10, 6)), {"tool": TOOL}, rng, left=0.05)
    found = [estimate(table, arm.robot, Knowledge(link_std=np.inf, bare=each), "posture") for each in (bare, other)]
    first, second = (each.loads[0] for each in found)
    np.testing.assert_allclose(second.mass_kg, first.mass_kg, rtol=1e-6)
    np.testing.assert_allclose(second.com_m, first.com_m, rtol=1e-5)
    assert [each.what for each in found[0].findings] == [each.what for each in found[1].findings]


def test_a_bare_identification_of_another_mounting_is_refused(arm, poses, measured):
    stored = run(measured(arm, poses, {"none": None}), arm.robot, Knowledge(link_std=np.inf))
    table = measured(arm, poses, {"tool": TOOL})
    with pytest.raises(InputError, match="--bare"):
        estimate(
            table, arm.robot, Knowledge(link_std=np.inf, bare=stored.bare, gravity_m_s2=(9.80665, 0.0, 0.0)), "posture"
        )


def test_bare_base_parameters_are_those_of_the_arm(arm, poses, measured):
    stored = run(measured(arm, poses, {"none": None}), arm.robot, Knowledge(link_std=np.inf))
    robot = arm.robot
    phi = np.concatenate([[m, *(m * c)] for m, c in zip(robot.mass_kg, robot.com_m, strict=True)])
    np.testing.assert_allclose(stored.bare.value, np.asarray(stored.bare.combination) @ phi, rtol=5e-3, atol=1e-5)
    assert len(stored.bare.value) == 10


# ---------------------------------------------------------------- joint


def test_a_prior_narrows_a_load_without_bare_run(arm, poses, measured):
    table = measured(arm, poses, {"tool": TOOL}, np.random.default_rng(1), left=0.02)
    wide, narrow = (estimate(table, arm.robot, Knowledge(link_std=std)).loads[0].mass_std_kg for std in (0.1, 0.01))
    assert narrow < 0.3 * wide
    assert abs(estimate(table, arm.robot, Knowledge(link_std=0.1)).loads[0].mass_kg - TOOL[0]) < 3 * wide


def test_a_common_bias_of_friction_is_taken_off(arm, poses, measured):
    """Half the band as a constant torque: with links known it would otherwise go into the load."""
    table = measured(arm, poses, {"tool": TOOL}, np.random.default_rng(1), left=0.05, bias=0.5)
    load = estimate(table, arm.robot, Knowledge(link_std=0.0)).loads[0]
    std = np.concatenate([[load.mass_std_kg], load.com_std_m])
    assert (np.abs(np.concatenate([[load.mass_kg], load.com_m]) - TOOL) < 3.5 * std).all()


def test_one_sided_rows_from_mixed_sides_find_the_friction(arm, poses, measured, band_nm):
    table = measured(arm, poses, {"none": None, "tool": TOOL}, np.random.default_rng(1), left=0.05)
    keep = (table.direction[:, 0] > 0) == (table.pose % 2 == 0)
    found = estimate(table.take(keep), arm.robot, Knowledge(link_std=np.inf))
    friction = {name: value for name, value in zip(found.names, found.value, strict=True) if "friction" in name}
    np.testing.assert_allclose(list(friction.values()), band_nm, rtol=0.15)
    load = found.loads[0]
    assert abs(load.mass_kg - TOOL[0]) < 3.5 * load.mass_std_kg
    said = run(table.take(keep), arm.robot, Knowledge(link_std=np.inf)).findings
    assert any("one side only" in finding.what for finding in said)


def test_contradicting_rows_are_refused_and_the_others_given(arm, poses, measured):
    rng = np.random.default_rng(2)
    table = measured(arm, poses, {"none": None, "a": TOOL, "b": (20.0, 0.1, 0.0, 0.1)}, rng, left=0.02)
    bare = measured(arm, poses, {"none": None}).tau_nm
    tau = table.tau_nm.copy()
    wrong = np.flatnonzero((table.load == "b") & (table.pose >= 6))
    clean = np.concatenate([bare[2 * k : 2 * k + 2] for k in range(12)])
    tau[wrong] = 2 * clean[wrong - np.flatnonzero(table.load == "b")[0]] - tau[wrong]  # the load's part upside down
    result = run(replace(table, tau_nm=tau), arm.robot, Knowledge(link_std=np.inf))
    load = {item.label: item for item in result.loads}
    assert load["b"].refused is not None
    assert "contradict" in load["b"].refused
    assert load["a"].refused is None
    assert abs(load["a"].mass_kg - TOOL[0]) < 4 * load["a"].mass_std_kg
    assert result.failed
    difference = run(replace(table, tau_nm=tau), arm.robot, Knowledge(link_std=np.inf), "difference")
    assert next(item for item in difference.loads if item.label == "b").refused is not None


def test_a_weak_load_under_strong_friction_is_not_refused(arm, poses, measured):
    table = measured(arm, poses, {"none": None, "tool": (0.5, 0.0, 0.0, 0.05)}, np.random.default_rng(3), left=0.3)
    load = run(table, arm.robot, Knowledge(link_std=np.inf)).loads[0]
    assert load.refused is None
    assert abs(load.mass_kg - 0.5) < 3.5 * load.mass_std_kg


def test_the_next_pose_does_help(arm, poses, measured):
    rng = np.random.default_rng(4)
    first = measured(arm, poses[:3], {"none": None, "tool": TOOL}, rng, left=0.1)
    found = run(first, arm.robot, Knowledge(link_std=np.inf))
    advice = found.next[0]
    assert 0 < advice.reduction < 1
    more = np.vstack([poses[:3], advice.poses_rad])
    again = run(measured(arm, more, {"none": None, "tool": TOOL}, rng, left=0.1), arm.robot, Knowledge(link_std=np.inf))
    assert again.loads[0].mass_std_kg < found.loads[0].mass_std_kg


def test_per_pose_masses_scatter_about_the_mass(arm, poses, measured):
    table = measured(arm, poses, {"none": None, "tool": TOOL}, np.random.default_rng(4), left=0.02)
    load = estimate(table, arm.robot, Knowledge(link_std=np.inf)).loads[0]
    assert len(load.per_pose_mass_kg) > 5
    assert np.median(list(load.per_pose_mass_kg.values())) == pytest.approx(TOOL[0], rel=0.05)


# ---------------------------------------------------------------- hand-over


def test_flange_frame(arm, poses, measured):
    table = measured(arm, poses, {"none": None, "tool": TOOL})
    robot = with_flange(arm.robot, (0.1, 0.0, 0.0), (0.0, np.pi / 2, 0.0))
    load = run(table, robot, Knowledge(link_std=np.inf)).loads[0]
    # flange z along link_6 x: (x - 0.1) becomes z, z becomes -x
    np.testing.assert_allclose(load.com_flange_m, [-0.05, -0.03, 0.02], atol=1e-5)
    assert run(table, arm.robot, Knowledge(link_std=np.inf)).loads[0].com_flange_m is None


def test_an_impossible_body_is_refused_or_reported_and_not_clamped(arm, poses, measured):
    table = measured(arm, poses, {"none": None, "tool": (3.0, 0.1, 0.0, 0.0), "far": (2.0, 5.0, 0.0, 0.0)})
    tau = table.tau_nm.copy()
    tau[table.load == "tool"] = 2 * tau[table.load == "none"] - tau[table.load == "tool"]  # pulls upwards
    table = replace(table, tau_nm=tau)
    result = run(table, arm.robot, Knowledge(link_std=np.inf))
    load = {item.label: item for item in result.loads}
    assert np.isnan(load["tool"].mass_kg)
    assert "a negative mass of -3 kg" in load["tool"].refused
    said = {finding.where: finding.what for finding in result.findings}
    assert "a negative mass of -3 kg" in said["load tool"]
    assert "5.00 m" in said["load far"]
