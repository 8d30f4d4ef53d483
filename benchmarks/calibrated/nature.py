"""Readings of arms that are drawn from the priors that the product states, with torques by pinocchio.

With g the error of a torque constant, u the change of an axis's gain in this occasion, d what differs at one place::

    reading = (1 + g + u) (torque + offset + d) + side (coulomb + loss |torque|) + viscous qd + rotor qdd + noise

An occasion is one recording under one load. Every number below is a statement of
`docs/explanation/nuisance-parameters.md`; none is imported from the product.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]

from benchmarks.conflict.arm import AXES, GRAVITY_M_S2, Floats, RatedArm, draw_arm
from gateway.data.rows import MOVING, Table
from tests.support.rigs.tables import make_table

#: Standard deviation of the change of gain between occasions: of an axis alone, and of all axes together.
CHANGE_AXIS, CHANGE_COMMON = 0.004, 0.003
#: Share of the variance of the torque constants that all axes have in common.
COMMON_SHARE = 0.5
#: Offset of the half-sums over the friction band; loss of a gear over its torque: mean, standard deviation; its uneven
#: share.
OFFSET_SHARE, LOSS, LOSS_STD, UNEVEN = 0.10, 0.05, 0.05, 0.10
#: Scatter of one approach over the friction band; repeatability of an angle.
VISIT_SCATTER, ANGLE_STD_RAD = 0.02, 1e-4
#: Speed below which Coulomb friction is not developed; samples of one period and their interval; noise of a sample over
#: the friction band.
SLOW_RAD_S, SAMPLES, STEP_S, SAMPLE_NOISE = 0.02, 600, 0.02, 0.1
#: Seconds of a visit, and between two occasions.
VISIT_S, OCCASION_S = 30.0, 1200.0


@dataclass(slots=True)
class CalibratedArm:
    """One arm, its load, its constants and its friction; `rng` draws what differs between readings.

    Attributes
    ----------
    arm : links as they are and as the URDF states them
    load : (4,) mass [kg] and centre [m] in the last link, or (k, 4) of several bodies
    gain : (6,) error of the torque constants
    gravity_nm, band_nm, viscous_nm_s_rad, rotor_kg_m2, offset_nm, loss : (6,), the first as root mean square
    """

    rng: np.random.Generator
    arm: RatedArm
    load: Floats
    gain: Floats
    gravity_nm: Floats
    band_nm: Floats
    viscous_nm_s_rad: Floats
    rotor_kg_m2: Floats
    offset_nm: Floats
    loss: Floats


def draw(seed: int, gain_std: float) -> CalibratedArm:
    """Draw an arm, its load and its nuisance parameters from their priors.

    Parameters
    ----------
    seed : int
    gain_std : float
        Relative standard deviation of the torque constants, as it is stated to the estimator.
    """
    rng = np.random.default_rng([seed, 13])
    arm = draw_arm(rng)
    reach = 0.45 * arm.rated_kg**0.34
    load = np.array([arm.rated_kg * rng.uniform(0.3, 1.0), *(0.09 * reach * rng.standard_normal(3))])
    model = _model(arm.geometry.urdf(arm.true), load)
    data = model.createData()
    sample = rng.uniform(-0.9, 0.9, (50, AXES)) * arm.geometry.limit_rad
    size = np.sqrt(np.mean([pinocchio.computeGeneralizedGravity(model, data, q) ** 2 for q in sample], axis=0))
    size[0] = 0.4 * size[1]
    band = np.maximum(size, 0.05 * size[1]) * rng.uniform(0.05, 0.15, AXES)
    loss = np.maximum(LOSS + LOSS_STD * rng.standard_normal(AXES), 0.0)
    # A gear with one efficiency leaves loss^2 / 2 of the torque in the half-sum, even losses leave nothing.
    uneven = UNEVEN * loss * rng.standard_normal(AXES) + rng.integers(0, 2) * loss**2 / 2.0
    common, single = rng.standard_normal(), rng.standard_normal(AXES)
    return CalibratedArm(
        rng=rng,
        arm=arm,
        load=load,
        gain=gain_std * (np.sqrt(COMMON_SHARE) * common + np.sqrt(1.0 - COMMON_SHARE) * single) + uneven,
        gravity_nm=size,
        band_nm=band,
        viscous_nm_s_rad=band * rng.uniform(0.2, 1.0, AXES),
        rotor_kg_m2=band * rng.uniform(0.01, 0.05, AXES),
        offset_nm=OFFSET_SHARE * band * rng.standard_normal(AXES),
        loss=loss,
    )


def poses(cell: CalibratedArm, count: int) -> Floats:
    """Rest poses (count, 6) [rad] over the workspace."""
    return cell.rng.uniform(-0.9, 0.9, (count, AXES)) * cell.arm.geometry.limit_rad


def place_torques(cell: CalibratedArm, count: int, repeats: int) -> Floats:
    """Torque (count, 6) [Nm] that the model lacks at each pose, the same at every visit.

    Its scale is that of a half-sum where poses are repeated, as the stated model has it; without repeats it is one
    number with the scatter of the visits.
    """
    scale = VISIT_SCATTER / np.sqrt(2.0) if repeats > 1 else 0.0
    return scale * cell.band_nm * cell.rng.standard_normal((count, AXES))


def missing_torque(cell: CalibratedArm, kind: str, q_rad: Floats) -> Floats:
    """Torque (n, 6) [Nm] at poses (n, 6), the same under every load, that no model of the product has.

    Parameters
    ----------
    cell : CalibratedArm
    kind : str
        "" = none. "cogging": ripple of 15 % of the band on every axis. "cables": a smooth torque of about one band on
        J4 and J5. "spring": on J2, in phase with a link. "unnamed": sin(2 q2) on J2 and steps on J3.
    q_rad : array of shape (n, 6)
    """
    torque, rng, band = np.zeros_like(q_rad), cell.rng, cell.band_nm
    if kind == "cogging":
        periods = 2 * np.array([101, 121, 101, 81, 81, 101])
        torque = 0.15 * np.sqrt(2.0) * band * np.sin(periods * q_rad + rng.uniform(0.0, 2.0 * np.pi, AXES))
    elif kind == "cables":
        size, phase = rng.standard_normal((3, 2)), rng.uniform(0.0, 2.0 * np.pi, (2, 2))
        angle = q_rad[:, 3:5]
        waves = size[1] * np.sin(angle + phase[0]) + size[2] * np.cos(angle + phase[1])
        torque[:, 3:5] = 0.7 * band[3:5] * (size[0] * angle / 2.0 + waves)
    elif kind == "spring":
        torque[:, 1] = rng.choice([-1.0, 1.0]) * 0.36 * cell.gravity_nm[1] * np.cos(q_rad[:, 1])
    elif kind == "unnamed":
        torque[:, 1] = 2.5 * band[1] * np.sin(2.0 * q_rad[:, 1] + 0.6)
        torque[:, 2] = 1.5 * band[2] * np.sign(np.sin(3.0 * q_rad[:, 2]))
    return torque


def at_rest(
    cell: CalibratedArm,
    q_rad: Floats,
    load: str,
    run: str,
    start_s: float,
    gain: Floats,
    place_nm: Floats,
    repeats: int,
) -> list[dict]:
    """Rows of the visits of all poses in one occasion, each from both directions.

    Parameters
    ----------
    cell : CalibratedArm
    q_rad : array of shape (n, 6)
    load, run : str
        Label of the load (`none` for the unloaded arm) and name of the recording.
    start_s : float
    gain : array of shape (6,)
        Of this occasion (`occasion_gain`).
    place_nm : array of shape (n, 6)
        Of `place_torques`.
    repeats : int
        Visits of every pose.
    """
    model = _model(cell.arm.geometry.urdf(cell.arm.true), None if load == "none" else cell.load)
    data, rows, time_s = model.createData(), [], start_s
    for number in np.tile(np.arange(len(q_rad)), repeats):
        true_rad = q_rad[number] + ANGLE_STD_RAD * cell.rng.standard_normal(AXES)
        torque = pinocchio.computeGeneralizedGravity(model, data, true_rad)
        for side in (1.0, -1.0):
            friction = side * (cell.band_nm + cell.loss * np.abs(torque))
            scatter = VISIT_SCATTER * cell.band_nm * cell.rng.standard_normal(AXES)
            rows.append(
                {
                    "load": load,
                    "run": run,
                    "pose": int(number),
                    "time": time_s,
                    "q": q_rad[number],
                    "qd": np.zeros(AXES),
                    "qdd": np.zeros(AXES),
                    "direction": np.full(AXES, int(side)),
                    "tau": (1.0 + gain) * (torque + cell.offset_nm + place_nm[number]) + friction + scatter,
                    "period": -1.0,
                    "phase": np.nan,
                }
            )
            time_s += VISIT_S / 2.0
    return rows


def in_motion(
    cell: CalibratedArm, motion: tuple[Floats, Floats, Floats], load: str, run: str, start_s: float, gain: Floats
) -> list[dict]:
    """Rows of three periods of an excitation trajectory in one occasion; arguments as of `at_rest`."""
    model = _model(cell.arm.geometry.urdf(cell.arm.true), None if load == "none" else cell.load)
    data, rows = model.createData(), []
    torque = np.array([pinocchio.rnea(model, data, *state) for state in zip(*motion, strict=True)])
    q, qd, qdd = motion
    friction = np.tanh(qd / SLOW_RAD_S) * (cell.band_nm + cell.loss * np.abs(torque))
    friction += cell.viscous_nm_s_rad * qd + cell.rotor_kg_m2 * qdd
    for period in range(3):
        tau = (1.0 + gain) * (torque + cell.offset_nm) + friction
        tau = tau + SAMPLE_NOISE * cell.band_nm * cell.rng.standard_normal(tau.shape)
        for k in range(SAMPLES):
            time_s = start_s + (period * SAMPLES + k) * STEP_S
            rows.append(
                {
                    "load": load,
                    "run": run,
                    "pose": MOVING,
                    "time": time_s,
                    "q": q[k],
                    "qd": qd[k],
                    "qdd": qdd[k],
                    "direction": np.sign(qd[k]).astype(int),
                    "tau": tau[k],
                    "period": float(period),
                    "phase": k * STEP_S,
                }
            )
    return rows


def occasion_gain(cell: CalibratedArm) -> Floats:
    """Error (6,) of the gain of every axis in one occasion: that of the constant and the change of this occasion."""
    return cell.gain + CHANGE_AXIS * cell.rng.standard_normal(AXES) + CHANGE_COMMON * cell.rng.standard_normal()


def excitation(cell: CalibratedArm) -> tuple[Floats, Floats, Floats]:
    """Angle, speed and acceleration (SAMPLES, 6) of a Fourier series of six harmonics."""
    t = np.arange(SAMPLES) * STEP_S
    base = 2.0 * np.pi / (SAMPLES * STEP_S)
    span = 0.3 * cell.arm.geometry.limit_rad * np.array([0.6, 0.8, 0.8, 0.8, 0.8, 0.8])
    q = np.tile(0.2 * cell.rng.uniform(-1.0, 1.0, AXES), (SAMPLES, 1))
    qd, qdd = np.zeros_like(q), np.zeros_like(q)
    for k in range(1, 7):
        for wave, derivative, sign in ((np.sin, np.cos, 1.0), (np.cos, np.sin, -1.0)):
            size = cell.rng.uniform(-1.0, 1.0, AXES) * span / k
            q += size * wave(k * base * t)[:, None]
            qd += sign * size * k * base * derivative(k * base * t)[:, None]
            qdd -= size * (k * base) ** 2 * wave(k * base * t)[:, None]
    return q, qd, qdd


def as_table(rows: list[dict]) -> Table:
    """The table that these rows are in a file."""
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    moving = columns["pose"] == MOVING
    extra = {}
    if moving.any():
        extra = {
            "x_excitation": moving.astype(float),
            "x_period": columns["period"],
            "x_phase_s": columns["phase"],
        }
    names = ("run", "time", "qd", "qdd", "direction")
    return make_table(
        columns["load"],
        columns["pose"],
        columns["q"],
        columns["tau"],
        extra=extra,
        **{name: columns[name] for name in names},
    )


def stated_urdf(cell: CalibratedArm) -> str:
    """URDF with the links as they are stated."""
    return cell.arm.geometry.urdf(cell.arm.stated)


def _model(urdf: str, load: Floats | None):
    model = pinocchio.buildModelFromXML(urdf)
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY_M_S2])
    for body in () if load is None else np.atleast_2d(load):
        inertia = body[0] * (0.3 * np.linalg.norm(body[1:]) + 0.02) ** 2 * np.eye(3)
        model.inertias[AXES] = model.inertias[AXES] + pinocchio.Inertia(float(body[0]), body[1:], inertia)
    return model
