"""Every main effect of moving runs is found on torque made by an independent dynamics library, and nothing else is.

The torque is pinocchio's inverse dynamics plus friction, rotor inertia, one effect and noise that is correlated over
0.1 s. The links of the true arm differ by 3 % from the robot model, as drawings do.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.rigs.tables import make_table
from gateway.data.rows import MOVING
from gateway.diagnose.motion import MovingDefaults, diagnose_motion
from gateway.model.robot import robot_from_urdf

URDF = (Path(__file__).parents[3] / "examples" / "small" / "robot.urdf").read_text()
GRAVITY = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class World:
    """What the arm really does; neutral by default. Effects on torque scale with `scale` of their axis."""

    load_friction: dict = field(default_factory=dict)  # axis -> share of the transmitted torque
    stribeck: dict = field(default_factory=dict)  # axis -> (size over scale, speed over top speed)
    coupling: tuple | None = None  # (i, j, c)
    spring: tuple | None = None  # (amplitude over the largest scale, phase)
    cable: dict = field(default_factory=dict)  # axis -> stiffness over scale
    tilt: tuple = (0.0, 0.0)
    ripple: dict = field(default_factory=dict)  # axis -> (size over scale, per revolution)
    gain: dict = field(default_factory=dict)  # axis -> reported over true
    swap: tuple | None = None
    strange: dict = field(default_factory=dict)  # axis -> size of a torque over scale that hangs on joint 1
    payload: tuple | None = None  # mass, x, y, z


def trajectory(generator, robot, duration_s, rate_hz):
    """Sums of sines within the limits: q, qd, qdd of shape (n, 6)."""
    time = np.arange(0.0, duration_s, 1.0 / rate_hz)
    q, qd, qdd = np.zeros((3, len(time), 6))
    low, high = np.maximum(robot.lower_rad, -2.2), np.minimum(robot.upper_rad, 2.2)
    for axis in range(6):
        for harmonic in range(1, 6):
            omega = 2 * np.pi * harmonic / duration_s * generator.uniform(0.8, 1.5)
            size, phase = generator.normal() / harmonic, generator.uniform(0.0, 2 * np.pi)
            q[:, axis] += size * np.sin(omega * time + phase)
            qd[:, axis] += size * omega * np.cos(omega * time + phase)
            qdd[:, axis] -= size * omega**2 * np.sin(omega * time + phase)
        factor = min(0.45 * (high[axis] - low[axis]) / np.ptp(q[:, axis]), 1.5 / np.abs(qd[:, axis]).max())
        middle = 0.5 * (q[:, axis].max() + q[:, axis].min())
        q[:, axis] = (q[:, axis] - middle) * factor + 0.5 * (low[axis] + high[axis])
        qd[:, axis] *= factor
        qdd[:, axis] *= factor
    return time, q, qd, qdd


def true_arm(generator, world, cad_error):
    """Pinocchio model with the arm's true inertials, load and gravity."""
    model = pinocchio.buildModelFromXML(URDF)
    for i in range(1, 7):
        body, factor = model.inertias[i], 1.0 + cad_error * generator.normal()
        length = max(np.linalg.norm(body.lever), 0.1)
        lever = body.lever + cad_error * length * generator.normal(size=3)
        model.inertias[i] = pinocchio.Inertia(body.mass * factor, lever, body.inertia * factor)
    if world.payload is not None:
        mass, *com = world.payload
        model.inertias[6] = model.inertias[6] + pinocchio.Inertia(mass, np.array(com), np.eye(3) * mass * 0.01)
    model.gravity.linear = Rotation.from_rotvec([*world.tilt, 0.0]).inv().apply(GRAVITY)
    return model


def coloured(generator, shape, rate_hz):
    """Noise of unit variance with a correlation time of 0.1 s."""
    keep = np.exp(-10.0 / rate_hz)
    white, out = generator.normal(size=shape), np.zeros(shape)
    for row in range(1, len(out)):
        out[row] = keep * out[row - 1] + np.sqrt(1.0 - keep**2) * white[row]
    return out


def measured(seed, world, duration_s=24.0, rate_hz=25.0, noise=0.02, cad_error=0.03):
    """Table of one moving run, the robot model, and the scale of each axis's torque (6,)."""
    generator = np.random.default_rng(seed)
    robot = robot_from_urdf(URDF, "robot.urdf")
    model = true_arm(generator, world, cad_error)
    time, q, qd, qdd = trajectory(generator, robot, duration_s, rate_hz)
    data = model.createData()
    rigid = np.array([pinocchio.rnea(model, data, *rows) for rows in zip(q, qd, qdd, strict=True)])
    scale = np.sqrt((rigid**2).mean(axis=0))
    scale = np.maximum(scale, 0.05 * scale.max())
    top = np.abs(qd).max(axis=0)
    coulomb, viscous = 0.15 * scale, 0.1 * scale / top
    rotor = 0.05 * scale / np.abs(qdd).max(axis=0)
    own = np.sign(qd) * coulomb + viscous * qd + rotor * qdd
    if world.coupling is not None:
        i, j, c = world.coupling
        speed = qd[:, j] + c * qd[:, i]
        motor = np.sign(speed) * coulomb[j] + viscous[j] * speed + rotor[j] * (qdd[:, j] + c * qdd[:, i])
        own[:, j] = motor
        own[:, i] += c * motor
    tau = rigid + own + disturbance(world, q, qd, rigid, scale)
    for axis, factor in world.gain.items():
        tau[:, axis] *= factor
    if world.swap is not None:
        tau[:, list(world.swap)] = tau[:, list(world.swap[::-1])]
    tau += noise * scale * (coloured(generator, tau.shape, rate_hz) + 0.2 * generator.normal(size=tau.shape))
    label, still = "none" if world.payload is None else "a", np.full(len(time), MOVING)
    return make_table([label] * len(time), still, q, tau, time=time, qd=qd, qdd=qdd), robot, scale


def disturbance(world, q, qd, rigid, scale):
    """Torque (n, 6) of the effects that add to an axis."""
    out = np.zeros_like(rigid)
    top = np.abs(qd).max(axis=0)
    for axis, share in world.load_friction.items():
        out[:, axis] += share * np.abs(rigid[:, axis]) * np.sign(qd[:, axis])
    for axis, (size, part) in world.stribeck.items():
        decay = np.exp(-np.abs(qd[:, axis]) / (part * top[axis]))
        out[:, axis] += size * scale[axis] * np.sign(qd[:, axis]) * decay
    if world.spring is not None:
        out[:, 1] += world.spring[0] * scale.max() * np.sin(q[:, 1] - world.spring[1])
    for axis, stiffness in world.cable.items():
        out[:, axis] += stiffness * scale[axis] * q[:, axis]
    for axis, (size, waves) in world.ripple.items():
        out[:, axis] += size * scale[axis] * np.sin(waves * q[:, axis] + 0.3)
    for axis, size in world.strange.items():
        out[:, axis] += size * scale[axis] * np.sin(2.0 * q[:, 0] + 1.0)
    return out


IGNORE = MovingDefaults(inertials="ignore")
FOUND = [
    ("load_dependent_friction", (2,), World(load_friction={1: 0.08}), IGNORE, {"coefficient": (0.08, 0.01)}),
    ("velocity_friction", (3,), World(stribeck={2: (0.15, 0.15)}), IGNORE, {}),
    ("axis_coupling", (5, 6), World(coupling=(4, 5, 1.0)), IGNORE, {"coefficient": (1.0, 0.05)}),
    ("axis_coupling", (2, 3), World(coupling=(1, 2, 1.0)), IGNORE, {"coefficient": (1.0, 0.1)}),
    ("balancer_spring", (2,), World(spring=(0.8, 0.1)), MovingDefaults(), {"phase_rad": (0.1, 0.1)}),
    ("cable_torque", (5,), World(cable={4: 0.15}), IGNORE, {}),
    ("base_tilt", (), World(tilt=(0.03, 0.02)), IGNORE, {"tilt_x_rad": (0.03, 0.005), "tilt_y_rad": (0.02, 0.005)}),
    ("torque_ripple", (2,), World(ripple={1: (0.08, 40.0)}), IGNORE, {"per_revolution": (40.0, 0.5)}),
]


@pytest.mark.parametrize(("name", "joints", "world", "options", "truth"), FOUND, ids=lambda value: str(value)[:24])
def test_the_effect_is_found_alone_with_its_parameters(name, joints, world, options, truth):
    table, robot, _ = measured(1, world)
    result = diagnose_motion(table, robot, options)
    assert [(effect.name, effect.joints) for effect in result.effects] == [(name, joints)]
    effect = result.effects[0]
    for key, (value, tolerance) in truth.items():
        assert effect.parameters[key] == pytest.approx(value, abs=tolerance)
    assert result.verdict == "improved"
    assert effect.evidence.holdout_rms_ratio < 0.75
    assert effect.evidence.p_value < 1e-3
    assert effect.evidence.odds > 10


def test_residual_falls_to_the_noise_that_was_put_in():
    table, robot, scale = measured(2, World(load_friction={1: 0.08}, coupling=(4, 5, 1.0)))
    result = diagnose_motion(table, robot, IGNORE)
    assert {effect.name for effect in result.effects} == {"load_dependent_friction", "axis_coupling"}
    noise = 0.02 * np.sqrt(1.04) * scale
    assert np.all(np.array(result.after.holdout_rms_nm) < 1.8 * noise)
    assert result.before.holdout_rms_nm[4] > 4 * noise[4]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("inertials", [None, "ignore", "prior:0.05"])
def test_nothing_is_claimed_on_a_clean_run(seed, inertials):
    table, robot, _ = measured(seed, World(), duration_s=20.0)
    result = diagnose_motion(table, robot, MovingDefaults(inertials=inertials))
    assert result.effects == ()
    assert result.verdict == "none_needed"
    assert np.isnan(result.noise_floor_nm).all()
    assert result.rejected


def test_a_torque_outside_the_library_is_not_given_a_name_of_the_library():
    table, robot, _ = measured(3, World(strange={2: 0.3}))
    result = diagnose_motion(table, robot, IGNORE)
    assert result.effects == ()
    assert result.verdict == "unexplained"
    assert any(finding.where == "J3" for finding in result.findings)


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


def test_load_is_estimated_through_a_missing_balancer():
    payload = (6.0, 0.03, -0.02, 0.12)
    table, robot, _ = measured(5, World(spring=(0.8, 0.1), payload=payload), duration_s=30.0)
    result = diagnose_motion(table, robot, MovingDefaults())
    assert [effect.name for effect in result.effects] == ["balancer_spring"]
    load = result.loads[0]
    assert load.label == "a"
    assert load == result.after.loads[0]
    assert load.mass_kg == pytest.approx(payload[0], abs=3.0 * load.mass_std_kg)
    assert load.com_m == pytest.approx(payload[1:], abs=0.03)
    assert load.mass_std_kg < 1.5


def test_without_bare_rows_and_cad_the_load_is_unknown_and_said_so():
    table, robot, _ = measured(6, World(payload=(6.0, 0.0, 0.0, 0.1)))
    load = diagnose_motion(table, robot, IGNORE).loads[0]
    assert np.isnan(load.mass_kg)
    assert "mass_kg" in load.unidentifiable


def test_given_holdout_is_judged_and_never_fitted():
    table, robot, _ = measured(7, World(load_friction={1: 0.08}), duration_s=36.0)
    first, last = table.take(table.time_s < 24.0), table.take(table.time_s >= 24.5)
    result = diagnose_motion(first, robot, MovingDefaults(inertials="ignore", holdout=last))
    assert result.holdout_kind == "given"
    assert [effect.name for effect in result.effects] == ["load_dependent_friction"]
    last.tau_nm[:, 1] += 1e3
    spoilt = diagnose_motion(first, robot, MovingDefaults(inertials="ignore", holdout=last))
    assert spoilt.effects == ()
    assert spoilt.before.holdout_rms_nm[1] > 900
    assert spoilt.before.rms_nm == pytest.approx(result.before.rms_nm, rel=0.1)


def test_only_and_without_limit_what_is_tried():
    table, robot, _ = measured(1, World(load_friction={1: 0.08}))
    without = diagnose_motion(
        table, robot, MovingDefaults(inertials="ignore", without=frozenset({"load_dependent_friction"}))
    )
    assert "load_dependent_friction" not in {effect.name for effect in without.effects}
    only = diagnose_motion(table, robot, MovingDefaults(inertials="ignore", only=frozenset({"cable_torque"})))
    assert only.effects == ()
    assert {item.name for item in only.rejected} == {"cable_torque"}


def test_too_short_a_run_is_undecided_and_says_what_to_measure():
    table, robot, _ = measured(1, World(), duration_s=1.5)
    result = diagnose_motion(table, robot, IGNORE)
    assert result.verdict == "undecided"
    assert result.effects == ()
    assert result.next


def test_what_the_report_draws_of_a_moving_run():
    table, robot, _ = measured(1, World(load_friction={1: 0.08}))
    result = diagnose_motion(table, robot, IGNORE)
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
    assert np.sqrt(np.mean((np.array(curve.points_y) - 0.08 * x) ** 2)) < 0.5 * np.abs(y).max()


def test_a_clean_moving_run_draws_no_curve():
    table, robot, _ = measured(0, World())
    assert not diagnose_motion(table, robot, IGNORE).data.curves


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
        # friction stands in the torque that is read, not in the torque of the links
        assert effect.parameters["compliance_rad_nm"] == pytest.approx(compliance, rel=0.2)
        assert effect.evidence.holdout_rms_ratio < 0.7
        assert result.verdict == "improved"


def test_a_scale_that_is_not_certain_is_no_failing_finding():
    table, robot, _ = measured(1, World(gain={4: 2.0**-0.5}))
    result = diagnose_motion(table, robot, IGNORE)
    assert result.verdict == "undecided"
    assert (5,) in [effect.joints for effect in result.effects]
    assert not [finding for finding in result.findings if finding.severity == "fail"]
    assert result.next
