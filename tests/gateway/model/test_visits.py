"""Pairing both sides of a rest visit, each through the gear by its own direction."""

import numpy as np
import pytest

from gateway.data.rows import MOVING
from gateway.model.motion import behind_gears
from gateway.model.visits import SAME_POSE_RAD, pair_visits
from tests.support.rigs.tables import make_table


def test_both_sides_become_gravity_and_band(rest_table):
    """Worked by hand: gravity 100, friction 20 behind a gear of 0.8."""
    eta = 0.8
    up, down = 120.0 / eta, 80.0 * eta  # driving, driven back
    table = rest_table(load=["none"] * 2, pose=[3, 3], direction=[1, -1], tau=[up, down], std=0.4, count=4)
    visits = pair_visits(table, np.full(6, eta))
    assert len(visits) == 1
    assert visits.two_sided.all()
    np.testing.assert_allclose(visits.sum_nm, 100.0)
    np.testing.assert_allclose(visits.difference_nm, 20.0)
    np.testing.assert_allclose(visits.sample_std_nm, 0.4 / 2 / np.sqrt(2))
    assert (visits.side == 0).all()
    assert (visits.gear_nm == 0).all()


def test_averaging_before_the_gear_would_leave_a_bias():
    eta, gravity = 0.8, 100.0
    naive = (gravity / eta + gravity * eta) / 2
    assert naive == pytest.approx(gravity * 1.025)


def test_negative_torque_is_driven_in_the_other_direction(rest_table):
    eta = 0.8
    table = rest_table(load=["a"] * 2, pose=[1, 1], direction=[1, -1], tau=[-80.0 * eta, -120.0 / eta])
    visits = pair_visits(table, eta)
    np.testing.assert_allclose(visits.sum_nm, -100.0)
    np.testing.assert_allclose(visits.difference_nm, 20.0)


def test_order_of_the_sides_does_not_matter(rest_table):
    one = pair_visits(rest_table(load=["a"] * 2, pose=[1, 1], direction=[1, -1], tau=[12.0, 8.0]))
    two = pair_visits(rest_table(load=["a"] * 2, pose=[1, 1], direction=[-1, 1], tau=[8.0, 12.0]))
    np.testing.assert_allclose(one.difference_nm, two.difference_nm)
    np.testing.assert_allclose(one.sum_nm, two.sum_nm)


def test_one_side_stays_one_sided(rest_table):
    table = rest_table(load=["a", "a", "b"], pose=[1, 2, 1], direction=[1, -1, -1], tau=[12.0, 8.0, 3.0])
    visits = pair_visits(table)
    assert len(visits) == 3
    assert not visits.two_sided.any()
    assert np.isnan(visits.difference_nm).all()
    assert visits.side[:, 0].tolist() == [1, -1, -1]


def test_unknown_side_keeps_what_the_gear_leaves_open(rest_table):
    visits = pair_visits(rest_table(load=["a"], pose=[1], direction=[0], tau=[100.0]), 0.8)
    np.testing.assert_allclose(visits.sum_nm, 100.0)
    np.testing.assert_allclose(visits.gear_nm, 100.0 * (1.25 - 0.8) / 2)


def test_repeated_visits_pair_in_the_order_of_time(rest_table):
    table = rest_table(
        load=["a"] * 4, pose=[1] * 4, direction=[1, -1, 1, -1], tau=[12.0, 8.0, 13.0, 9.0], time=[0.0, 5.0, 50.0, 55.0]
    )
    visits = pair_visits(table)
    np.testing.assert_allclose(visits.sum_nm[:, 0], [10.0, 11.0])
    np.testing.assert_allclose(visits.time_s, [2.5, 52.5])


def test_other_angles_or_runs_do_not_pair(rest_table):
    far = rest_table(load=["a"] * 2, pose=[1, 1], direction=[1, -1], tau=[12.0, 8.0], q=[[0.0] * 6, [0.1] * 6])
    assert len(pair_visits(far)) == 2
    apart = rest_table(load=["a"] * 2, pose=[1, 1], direction=[1, -1], tau=[12.0, 8.0], run=["r", "s"])
    assert len(pair_visits(apart)) == 2


def test_sides_that_friction_holds_some_milliradians_apart_are_one_visit(rest_table):
    """As near as a bare and a loaded visit have to be for the difference method, and repeats for the drift."""
    q = [[0.3] * 6, [0.3, 0.305, 0.3, 0.3, 0.3, 0.3]]
    visits = pair_visits(rest_table(load=["a"] * 2, pose=[1, 1], direction=[1, -1], tau=[12.0, 8.0], q=q))
    assert visits.two_sided.tolist() == [True]
    assert visits.q_rad[0, 1] == pytest.approx(0.3025)
    beyond = [[0.3] * 6, [0.3, 0.3 + 1.5 * SAME_POSE_RAD, 0.3, 0.3, 0.3, 0.3]]
    assert len(pair_visits(rest_table(load=["a"] * 2, pose=[1, 1], direction=[1, -1], tau=[12.0, 8.0], q=beyond))) == 2


def test_rows_of_a_fine_sweep_pair_at_the_same_angle(rest_table):
    """Joint 3 up in steps of 4 mrad, a pose number each, and down again."""
    angles = 0.2 + 0.004 * np.array([0, 1, 2, 3, 3, 2, 1, 0])
    q = np.zeros((8, 6))
    q[:, 2] = angles
    tau = np.full((8, 6), 5.0)
    tau[:, 2] = 100.0 * angles + np.repeat([3.0, -3.0], 4)
    facing = [one_moves(2, side) for side in [1] * 4 + [-1] * 4]
    visits = pair_visits(
        rest_table(load=["a"] * 8, pose=np.arange(8), direction=facing, tau=tau, q=q, time=10.0 * np.arange(8))
    )
    assert visits.two_sided.tolist() == [True] * 4
    assert visits.q_rad[:, 2] == pytest.approx(0.2 + 0.004 * np.arange(4))
    assert visits.sum_nm[:, 2] == pytest.approx(100.0 * visits.q_rad[:, 2])
    assert visits.difference_nm[:, 2] == pytest.approx(3.0)


def test_take_and_an_empty_table(rest_table):
    table = rest_table(load=["a", "b"], pose=[1, 1], direction=[1, 1], tau=[1.0, 2.0])
    visits = pair_visits(table)
    assert visits.take(visits.load == "b").sum_nm[0, 0] == 2.0
    assert len(pair_visits(table.take(np.zeros(2, dtype=bool)))) == 0


def one_moves(axis: int, side: int, others: int = 0) -> list[int]:
    """Directions of six axes of which one moved."""
    return [side if k == axis else others for k in range(6)]


@pytest.mark.parametrize("others", [0, 1])
@pytest.mark.parametrize("poses", [[3, 3], [3, 9]])
def test_a_sweep_of_one_joint_that_passes_an_angle_in_both_directions_has_both_sides_of_that_axis(
    rest_table, others, poses
):
    eta = 0.8
    up, down = 120.0 / eta, 80.0 * eta
    tau = np.full((2, 6), 30.0)
    tau[:, 2] = up, down
    facing = [one_moves(2, 1, others), one_moves(2, -1, others)]
    table = rest_table(load=["a"] * 2, pose=poses, direction=facing, tau=tau, time=[0.0, 8.0])
    visits = pair_visits(table, np.full(6, eta))
    assert visits.two_sided.tolist() == [True]
    assert visits.pose.tolist() == [3]
    assert visits.sum_nm[0, 2] == pytest.approx(100.0)
    assert visits.difference_nm[0, 2] == pytest.approx(20.0)
    assert visits.time_s[0] == pytest.approx(4.0)
    # the axes at rest have the one side that they had, or an unknown one
    still = np.delete(np.arange(6), 2)
    assert np.isnan(visits.difference_nm[0, still]).all()
    assert visits.side[0].tolist() == [0 if k == 2 else others for k in range(6)]
    assert visits.sum_nm[0, still] == pytest.approx(30.0 * (eta if others else 1.0))
    assert (visits.gear_nm[0, still] > 0).all() == (others == 0)
    assert visits.gear_nm[0, 2] == 0.0


def test_a_whole_sweep_pairs_angle_by_angle(rest_table):
    angles = np.concatenate([np.linspace(-0.5, 0.5, 6), np.linspace(0.5, -0.5, 6)])
    q = np.zeros((12, 6))
    q[:, 1] = angles
    side = np.repeat([1, -1], 6)
    tau = 50.0 * np.cos(angles) + 4.0 * side
    facing = np.where(np.arange(6) == 1, side[:, None], 0)
    visits = pair_visits(rest_table(load=["a"] * 12, pose=np.arange(12), direction=facing, tau=tau, q=q))
    assert visits.two_sided.all()
    assert visits.pose.tolist() == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(visits.q_rad[:, 1], angles[:6])
    np.testing.assert_allclose(visits.sum_nm[:, 1], 50.0 * np.cos(angles[:6]))
    np.testing.assert_allclose(visits.difference_nm[:, 1], 4.0)


def test_two_joints_that_turn_back_pair_within_a_pose_alone(rest_table):
    """Of sweeps it is one joint that passes its angle again; two at once are another way to that place."""
    facing = [[1, 1, 0, 0, 0, 0], [-1, -1, 0, 0, 0, 0]]
    same = pair_visits(rest_table(load=["a"] * 2, pose=[1, 1], direction=facing, tau=[12.0, 8.0]))
    assert same.two_sided.tolist() == [True]
    assert pair_visits(rest_table(load=["a"] * 2, pose=[1, 2], direction=facing, tau=[12.0, 8.0])).two_sided.sum() == 0


@pytest.mark.parametrize(
    "facing",
    [[one_moves(2, 1), one_moves(2, 1)], [one_moves(2, 1), one_moves(3, -1)], [one_moves(2, 1), one_moves(2, 0)]],
    ids=["the same side", "another joint", "unknown side"],
)
def test_other_directions_are_no_two_sides(rest_table, facing):
    visits = pair_visits(rest_table(load=["a"] * 2, pose=[1, 1], direction=facing, tau=[12.0, 8.0]))
    assert len(visits) == 2
    assert not visits.two_sided.any()


def test_a_sweep_under_another_load_or_beside_it_is_another(rest_table):
    facing = [one_moves(2, 1), one_moves(2, -1)]
    q = np.zeros((2, 6))
    q[1, 0] = 0.01
    for change in ({"load": ["a", "b"]}, {"run": ["r", "s"]}, {"q": q}):
        table = rest_table(**({"load": ["a"] * 2} | change), pose=[1, 2], direction=facing, tau=[12.0, 8.0])
        assert not pair_visits(table).two_sided.any()


def test_a_full_partner_goes_before_a_part(rest_table):
    facing = [[1] * 6, one_moves(5, -1, 1), [-1] * 6]
    visits = pair_visits(rest_table(load=["a"] * 3, pose=[1] * 3, direction=facing, tau=[12.0, 9.0, 8.0]))
    np.testing.assert_allclose(visits.sum_nm[:, 0], [10.0, 9.0])
    assert visits.two_sided.tolist() == [True, False]


#: Motor 6 turns with joint 5 too: gear outputs turn by `COUPLING @ q`.
COUPLING = np.eye(6)
COUPLING[5, 4] = 0.9


def reported(joint_nm: np.ndarray, facing: np.ndarray, eta: float) -> np.ndarray:
    """Loss-free joint torque (6,) of the motors that hold a joint torque while the joints move, written out.

    The power at the gear outputs is that at the joints: `f' (A q) = tau' q`, hence `f = A^-T tau`. A gear that drives
    gives `f / eta` on the motor's side, one that is driven back `f eta`.
    """
    output = np.linalg.solve(COUPLING.T, joint_nm)
    turns = COUPLING @ facing
    motor = np.array([f / eta if f * turn > 0 else f * eta for f, turn in zip(output, turns, strict=True)])
    return COUPLING.T @ motor


def test_gears_of_coupled_axes_lose_by_the_direction_of_the_motors(rest_table):
    """Joint 5 up and joint 6 down: motor 6 turns by 0.9 - 1, with joint 6; and both up: by 1.9."""
    gravity, eta = np.array([0.0, 300.0, 120.0, 8.0, 30.0, -12.0]), 0.75
    # how far joint 5 is off where each joint's torque is taken by its own direction
    for facing, off in ((np.ones(6), 0.05), (np.array([1.0, 1.0, 1.0, 1.0, 1.0, -1.0]), 0.0)):
        torque = np.array([reported(gravity, side * facing, eta) for side in (1, -1)])
        change = {"load": ["a"] * 2, "pose": [1, 1], "direction": np.array([facing, -facing]), "tau": torque}
        visits = pair_visits(rest_table(**change), np.full(6, eta), COUPLING)
        np.testing.assert_allclose(visits.sum_nm[0], gravity, atol=1e-9)
        np.testing.assert_allclose(visits.difference_nm[0], 0.0, atol=1e-9)
        joint_by_joint = pair_visits(rest_table(**change), np.full(6, eta))
        assert np.abs(joint_by_joint.sum_nm[0] - gravity)[4] >= off * gravity[4]


def test_moving_rows_of_coupled_axes_go_through_the_gears_that_turn():
    rng = np.random.default_rng(0)
    torque, speed = 50.0 * rng.normal(size=(40, 6)), rng.normal(size=(40, 6))
    read = np.array([reported(tau, qd, 0.8) for tau, qd in zip(torque, speed, strict=True)])
    table = make_table(["a"] * 40, np.full(40, MOVING), np.zeros((40, 6)), read, qd=speed)
    np.testing.assert_allclose(behind_gears(table, np.full(6, 0.8), COUPLING).tau_nm, torque, atol=1e-9)


def test_an_unmeasured_axis_hides_those_alone_that_its_motor_acts_on(rest_table):
    torque = np.full((1, 6), 10.0)
    torque[0, 2] = np.nan
    visits = pair_visits(
        rest_table(load=["a"], pose=[1], direction=np.ones((1, 6)), tau=torque), np.full(6, 0.8), COUPLING
    )
    assert np.isnan(visits.sum_nm[0]).tolist() == [False, False, True, False, False, False]
