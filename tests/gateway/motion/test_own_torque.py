"""The identified torque of an arm's own motion does not count as contact: against pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from gateway.cell.conversion import AxisConversion
from gateway.data.visit import ArmSample
from gateway.errors import LimitExceeded
from gateway.feedforward.identified import AxisConstants, Known
from gateway.model.arm_model import robot_text
from gateway.motion.watch import OwnTorque, Watch
from tests.gateway.motion.test_watch import ANSWER

PERIOD_S = 0.01
ZERO = np.zeros(6)
COULOMB, VISCOUS, ROTOR = 4.0, 3.0, 1.5


def identified_number(value):
    return Known(value, "identified, r.json", identified=True)


IDENTIFIED = AxisConstants(identified_number(ROTOR), identified_number(COULOMB), identified_number(VISCOUS))
TYPED = AxisConstants(Known(ROTOR, "datasheet"), Known(COULOMB, "datasheet"))


@pytest.fixture
def axes(small_cell):
    return AxisConversion.from_arm(small_cell.cell.arm[0])


@pytest.fixture
def own(axes, workspace):
    return OwnTorque((IDENTIFIED,) * 6, axes, workspace, PERIOD_S)


def swing(count=80, size=0.1):
    """Setpoints from rest, and their speeds and accelerations."""
    time_s, rate = PERIOD_S * np.arange(count), 2 * np.pi * 0.5
    scale = size * np.array([1.0, 0.7, -0.8, 1.2, -0.5, 0.9])
    phase = (rate * time_s)[:, None]
    return scale * (1 - np.cos(phase)), scale * rate * np.sin(phase), scale * rate**2 * np.cos(phase)


def test_rotors_links_and_friction_of_a_motion(own, small_cell, workspace):
    q, qd, qdd = swing()
    model = pinocchio.buildModelFromXML(robot_text(small_cell, small_cell.cell.arm[0]))
    model.gravity.linear = np.zeros(3)
    for row in q[:41]:
        own.take(row)
    # differences hold at the middle between setpoints: half a SYNC of delay in speed, one in acceleration
    expected = pinocchio.rnea(model, model.createData(), q[40], 0.5 * (qd[39] + qd[40]), qdd[39]) + ROTOR * qdd[39]
    assert own.inertia_nm == pytest.approx(expected, rel=0.01, abs=0.01)
    speed = 0.5 * (qd[39] + qd[40])
    assert own.friction_nm == pytest.approx(np.sign(speed) * COULOMB + VISCOUS * speed, rel=1e-3)


def test_a_coupled_axis_turns_its_friction_into_both_joints(axes, workspace):
    coupling = np.eye(6)
    coupling[5, 4] = -1.0
    coupled = OwnTorque((TYPED,) * 5 + (IDENTIFIED,), replace(axes, coupling=coupling), workspace, PERIOD_S)
    coupled.take(ZERO)
    coupled.take(np.full(6, 1e-3) * np.array([0, 0, 0, 0, 0, 1.0]))
    force = COULOMB + VISCOUS * 0.1
    assert coupled.friction_nm == pytest.approx([0, 0, 0, 0, -force, force])
    # joint 5 also turns motor 5, of which nothing was identified
    assert np.isnan(coupled.turning_nm[:5]).all()
    assert coupled.turning_nm[5] == 2 * COULOMB


def test_typed_constants_are_not_used(axes, workspace):
    typed = OwnTorque((TYPED,) * 6, axes, workspace, PERIOD_S)
    for row in swing()[0][:20]:
        typed.take(row)
    assert np.isnan(typed.turning_nm).all()
    assert not typed.friction_nm.any()
    assert not typed.inertia_nm.any()


def drive(watch, own_nm, jump_nm, count=80):
    """SYNC at which the watch stops a motion that takes `own_nm`; joint 2 jumps from row 60 on; -1 = it never does."""
    q, _, _ = swing(count)
    for k in range(count):
        torque = own_nm[k] + (np.eye(6)[1] * jump_nm if k >= 60 else 0.0)
        modelled = watch.moved_torque(q[k]) - watch.modelled_torque(q[k][None])[0]
        try:
            watch.check(ArmSample(k, k * PERIOD_S, q[k], torque, (ANSWER,) * 6), q[k], modelled)
        except LimitExceeded:
            return k
    return -1


@pytest.fixture
def own_nm(small_cell, workspace):
    """Torque of the swing without gravity."""
    q, qd, qdd = swing()
    model = pinocchio.buildModelFromXML(robot_text(small_cell, small_cell.cell.arm[0]))
    model.gravity.linear = np.zeros(3)
    data = model.createData()
    rigid = np.array([pinocchio.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)])
    return rigid + ROTOR * qdd + COULOMB * np.sign(qd) + VISCOUS * qd


def test_what_the_arm_takes_itself_is_no_contact_and_a_smaller_jump_is(axes, workspace, own_nm):
    # the gear's reversal is allowed for too: (1 / 0.85 - 0.85) of the torque, so that 0.25 lets up to 0.37 pass
    jump = 0.3 * workspace.torque_nm[1]
    quiet, touched = (OwnTorque((IDENTIFIED,) * 6, axes, workspace, PERIOD_S) for _ in range(2))
    assert drive(Watch("main", workspace, PERIOD_S, own=quiet), own_nm, 0.0) == -1
    assert drive(Watch("main", workspace, PERIOD_S, own=touched), own_nm, jump) >= 60
    assert drive(Watch("main", workspace, PERIOD_S), own_nm, jump) == -1


def test_the_watch_is_never_blunter_than_without(axes, workspace):
    rough = AxisConstants(
        identified_number(ROTOR), identified_number(float(workspace.torque_nm[1])), identified_number(VISCOUS)
    )
    own = OwnTorque((rough,) * 6, axes, workspace, PERIOD_S)
    watch = Watch("main", workspace, PERIOD_S, own=own)
    still = ArmSample(0, 0.0, ZERO, ZERO, (ANSWER,) * 6)
    for k in range(60):
        watch.check(replace(still, sync_index=k, time_s=k * PERIOD_S), ZERO, ZERO)
    over = np.eye(6)[1] * 0.4 * workspace.torque_nm[1]

    def lasting():
        for k in range(60, 64):
            watch.check(replace(still, sync_index=k, time_s=k * PERIOD_S, joint_torque_nm=over), ZERO, ZERO)

    with pytest.raises(LimitExceeded, match="joint 2: the torque has jumped"):
        lasting()
