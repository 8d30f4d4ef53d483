"""Moving runs made by an independent dynamics library, with an effect that no estimator is given.

The torque is pinocchio's inverse dynamics plus friction, rotor inertia, one effect and noise that is correlated over
0.1 s. The links of the true arm differ by 3 % from the robot model, as drawings do.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]
from scipy.spatial.transform import Rotation

from gateway.data.rows import MOVING, concatenate
from gateway.model.robot import robot_from_urdf
from tests.data.arms import torque_of
from tests.support.rigs.tables import make_table

URDF = (Path(__file__).parents[2] / "examples" / "small" / "robot.urdf").read_text()
GRAVITY = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class World:
    """What the arm really does; neutral by default. Effects on torque scale with `scale` of their axis."""

    load_friction: dict = field(default_factory=dict)  # axis -> share of the transmitted torque
    stribeck: dict = field(default_factory=dict)  # axis -> (size over scale, speed over top speed)
    coupling: tuple | None = None  # (i, j, c)
    spring: tuple | None = None  # (amplitude over the largest scale, phase)
    coil: tuple | None = None  # stiffness [N/m], lever, anchor, free length [m], shortest at q2 = 0
    cable: dict = field(default_factory=dict)  # axis -> stiffness over scale
    tilt: tuple = (0.0, 0.0)
    ripple: dict = field(default_factory=dict)  # axis -> (size over scale, per revolution)
    gain: dict = field(default_factory=dict)  # axis -> reported over true
    swap: tuple | None = None
    strange: dict = field(default_factory=dict)  # axis -> size of a torque over scale that depends on joint 1
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


def as_period(table, torque_nm, excitation, number, period_s):
    """Rows of the first period of an excitation as those of a later one, with this torque (n, 6) and its marks."""
    count, phase_s = np.ones(len(table)), table.time_s - table.time_s[0]
    marks = {"x_excitation": excitation * count, "x_period": float(number) * count, "x_phase_s": phase_s}
    return replace(table, time_s=table.time_s + number * period_s, tau_nm=torque_nm, extra=marks)


def several(seed, loads, world=None, gain_std=0.03, load_friction=(0.05, 0.02), duration_s=10.0, noise=0.02):
    """Runs of one arm, by their load ((mass, x, y, z), None = bare), with nuisance parameters; and the robot model.

    Gains are off by `gain_std`, every axis loses a share of its torque: (mean, standard deviation).
    """
    generator = np.random.default_rng(seed)
    gain = dict(enumerate(1.0 + gain_std * generator.normal(size=6)))
    lost = dict(enumerate(np.maximum(load_friction[0] + load_friction[1] * generator.normal(size=6), 0.0)))
    world = replace(World() if world is None else world, gain=gain, load_friction=lost)
    tables, scale, robot = [], None, None
    for number, (label, load) in enumerate(loads.items()):
        table, robot, scale = measured(
            [seed, number], replace(world, payload=load), duration_s, noise=noise, arm_seed=seed, scale=scale
        )
        name = "none" if load is None else label
        count = len(table.time_s)
        tables.append(replace(table, load=np.array([name] * count), run=np.array([str(number)] * count)))
    return concatenate(tables), robot


def measured(seed, world, duration_s=24.0, rate_hz=25.0, noise=0.02, cad_error=0.03, arm_seed=None, scale=None):
    """Table of one moving run, the robot model, and the scale of each axis's torque (6,).

    Runs of one `arm_seed` are of one arm, whose friction goes by `scale`.
    """
    generator = np.random.default_rng(seed)
    robot = robot_from_urdf(URDF, "robot.urdf")
    model = true_arm(generator if arm_seed is None else np.random.default_rng(arm_seed), world, cad_error)
    time, q, qd, qdd = trajectory(generator, robot, duration_s, rate_hz)
    rigid = torque_of(model, q, qd, qdd)
    if scale is None:
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
    if world.coil is not None:
        stiffness, lever, anchor, free = world.coil
        length = np.sqrt(lever**2 + anchor**2 - 2.0 * lever * anchor * np.cos(q[:, 1]))
        out[:, 1] += stiffness * (length - free) * lever * anchor * np.sin(q[:, 1]) / length
    for axis, stiffness in world.cable.items():
        out[:, axis] += stiffness * scale[axis] * q[:, axis]
    for axis, (size, waves) in world.ripple.items():
        out[:, axis] += size * scale[axis] * np.sin(waves * q[:, axis] + 0.3)
    for axis, size in world.strange.items():
        out[:, axis] += size * scale[axis] * np.sin(2.0 * q[:, 0] + 1.0)
    return out
