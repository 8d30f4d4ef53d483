"""What every axis needs in the worst case, against gravity and inertia matrix of pinocchio."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from gateway.cell.config import SourcedNumber
from gateway.feedforward.identified import AxisConstants, Known
from gateway.model.arm_model import arm_robot, robot_text
from gateway.motion.drive_limits import needed_torque_nm
from gateway.motion.workspace import workspace_of
from tests.data.arms import carrying, peer_of

DECEL = np.array([3.0, 2.0, 4.0, 6.0, 8.0, 10.0])


@pytest.fixture(scope="module", params=["small", "large"])
def cell(request, small_cell, large_cell):
    return {"small": small_cell, "large": large_cell}[request.param]


@pytest.fixture
def arm(small_cell):
    return small_cell.cell.arm[0]


def loaded_model(cell, mass_kg: float, com_m) -> pinocchio.Model:
    """The arm with a solid cube of 3000 kg/m3 on its last link."""
    arm, side = cell.cell.arm[0], (mass_kg / 3000.0) ** (1 / 3)
    model, _ = peer_of(robot_text(cell, arm), tuple(arm.gravity_m_s2))
    return carrying(model, mass_kg, com_m, mass_kg * side**2 / 6 * np.eye(3))


def worst(cell, workspace, mass_kg: float, com_m) -> tuple[np.ndarray, np.ndarray]:
    """Largest gravity torque and largest share of the inertia matrix times the decelerations, of random postures."""
    model = loaded_model(cell, mass_kg, com_m)
    data = model.createData()
    gravity, stopping = np.zeros(6), np.zeros(6)
    for q in np.random.default_rng(8).uniform(workspace.lower_rad, workspace.upper_rad, (6000, 6)):
        gravity = np.maximum(gravity, np.abs(pinocchio.rnea(model, data, q, np.zeros(6), np.zeros(6))))
        upper = np.triu(pinocchio.crba(model, data, q))
        stopping = np.maximum(stopping, np.abs(upper + np.triu(upper, 1).T) @ DECEL)
    return gravity, stopping


def test_need_is_gravity_friction_and_stop_with_the_reserve(cell):
    arm = cell.cell.arm[0]
    workspace = workspace_of(arm, arm_robot(cell, arm))
    gravity, stopping = worst(cell, workspace, arm.rated_load_kg.value, arm.rated_load_com_m)
    rotor = np.array([axis.rotor_inertia_kg_m2.value for axis in arm.axis])
    sampled = 1.3 * (gravity / workspace.efficiency + 0.013 * workspace.torque_nm + stopping + rotor * DECEL)
    share = needed_torque_nm(workspace, arm, DECEL) / sampled
    assert ((share >= 0.999) & (share <= 1.05)).all()


def test_given_friction_counts_as_it_is(arm, workspace):
    rough = tuple(axis.model_copy(update={"coulomb_nm": SourcedNumber(value=50.0, source="x")}) for axis in arm.axis)
    needed_nm = needed_torque_nm(workspace, arm.model_copy(update={"axis": rough}), DECEL)
    assert needed_nm - needed_torque_nm(workspace, arm, DECEL) == pytest.approx(
        1.3 * (50.0 - 0.013 * workspace.torque_nm)
    )


@pytest.mark.slow
def test_the_heavier_of_both_loads_counts(small_cell, arm):
    heavy = arm.model_copy(update={"max_load_kg": 20.0, "max_load_com_m": (0.0, 0.0, 0.12)})
    robot = arm_robot(small_cell, arm)
    both = needed_torque_nm(workspace_of(heavy, robot), heavy, DECEL)
    assert both[1] > 1.2 * needed_torque_nm(workspace_of(arm, robot), arm, DECEL)[1]
    alone = heavy.model_copy(update={"rated_load_kg": None})
    assert needed_torque_nm(workspace_of(alone, robot), alone, DECEL) == pytest.approx(both, rel=1e-9)


def test_a_stop_costs_in_proportion(arm, workspace):
    none, once, twice = (needed_torque_nm(workspace, arm, factor * DECEL) for factor in (0, 1, 2))
    assert twice - once == pytest.approx(once - none, rel=1e-9)
    assert (once > none).all()


@pytest.mark.parametrize("missing", ["rated_load_kg", "inertials", "rotor"])
def test_what_is_not_known_gives_no_figure(small_cell, missing, arm):
    axes = (arm.axis[0].model_copy(update={"rotor_inertia_kg_m2": None}), *arm.axis[1:])
    changed = {"rated_load_kg": None, "inertials": "ignore", "rotor": axes}
    arm = arm.model_copy(update={"axis" if missing == "rotor" else missing: changed[missing]})
    workspace = workspace_of(arm, arm_robot(small_cell, arm))
    assert needed_torque_nm(workspace, arm, DECEL) is None


def test_a_link_without_inertia_gives_no_figure(arm, workspace):
    inertia = workspace.robot.inertia_kg_m2.copy()
    inertia[4] = np.nan
    unknown = replace(workspace, robot=replace(workspace.robot, inertia_kg_m2=inertia))
    assert needed_torque_nm(unknown, arm, DECEL) is None


def test_identified_rotors_and_friction_count_before_what_is_typed(arm, workspace):
    rotor = np.array([axis.rotor_inertia_kg_m2.value for axis in arm.axis])
    typed = needed_torque_nm(workspace, arm, DECEL)
    known = tuple(
        AxisConstants(
            rotor_kg_m2=Known(1.2 * axis.rotor_inertia_kg_m2.value, "identified", identified=True),
            coulomb_nm=Known(5.0, "identified", identified=True),
            breakaway_nm=7.0,
            stribeck_rad_s=0.01,
        )
        for axis in arm.axis
    )
    identified = needed_torque_nm(workspace, arm, DECEL, known)
    assert identified - typed == pytest.approx(1.3 * (0.2 * rotor * DECEL + 7.0 - 0.013 * workspace.torque_nm))
