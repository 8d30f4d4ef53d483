"""Recommendations after an estimate: the pose to measure next, by its Fisher information, and further axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway.identify.knowledge import Knowledge
from gateway.identify.load_estimate import CABLE, CONSTANTS, DRIFT, FRICTION, LINKS, NOISE, ZEROS, LoadEstimate
from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.model.regressor import load_regressor
from gateway.model.robot import Robot
from gateway.result.result import NextMeasurement

Floats = NDArray[np.float64]

_CANDIDATES = 400
_SEED = 7
_UNKNOWN_KG = 1e3
#: Share of the mass's variance from which on a source is worth a line of its own.
_DOMINANT_SHARE = 0.3
#: Source -> what to do against it, what it is, and the share of its variance that is assumed to remain.
_ACTIONS = {
    CONSTANTS: ("mount a load of known mass and give it as --known", "errors of the torque constants", 0.0),
    LINKS: ("mount a load of known mass, or weigh the links", "the uncertainty of the link parameters", 0.0),
    DRIFT: ("warm the arm up, then measure {load}, bare, bare, {load}", "the drift of the torque readings", 0.0),
    ZEROS: (
        "calibrate the joint zeros, or choose poses that turn the wrist",
        "the zero errors of the joints",
        0.0,
    ),
    CABLE: (
        "take hoses and cables off, or measure bare with them",
        "forces of hoses and cables that come with the load",
        0.0,
    ),
    FRICTION: ("approach every pose from both sides, bare, {load}, {load}, bare", "friction", 0.5),
    NOISE: ("another block bare, {load}, {load}, bare", "noise", 0.5),
}


def payload_information(
    robot: Robot, q_rad: ArrayLike, sigma_nm: ArrayLike, gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2
) -> Floats:
    """Return the information of each pose on [m, hx, hy, hz] of the load, if the unloaded arm is measured there too.

    The difference of loaded and unloaded torque has twice the variance of one: `L' W L / 2`. One pose has rank 3.

    Parameters
    ----------
    robot : Robot
    q_rad : array of shape (n, N)
    sigma_nm : array of shape (N,)
        Standard deviation of a half-sum; NaN or infinite = the axis is not measured.
    gravity_m_s2 : array of shape (3,)

    Returns
    -------
    array of shape (n, 4, 4)
        1/kg^2, 1/(kg kg m), 1/(kg m)^2.
    """
    sigma = np.asarray(sigma_nm, dtype=float)
    inverse = np.where(np.isfinite(sigma), 1.0 / np.where(np.isfinite(sigma), sigma, 1.0), 0.0)
    rows = load_regressor(robot, q_rad, gravity_m_s2) * inverse[:, None]
    return np.matmul(rows.transpose(0, 2, 1), rows) / 2.0


def next_pose(
    load: LoadEstimate, robot: Robot, sigma_nm: Floats, knowledge: Knowledge, pose_choice: Floats | None = None
) -> NextMeasurement | None:
    """Return the rest pose that reduces a load's uncertainty most if measured with and without it.

    The pose is D-optimal among random postures. The uncertainty from the torque constants and their drift is equal at
    every pose; that share of the variance stays.

    Parameters
    ----------
    load : LoadEstimate
    robot : Robot
        Its joint limits bound the random postures; used without `pose_choice`.
    sigma_nm : array of shape (N,)
        Noise floor per axis, NaN = not measured.
    knowledge : Knowledge
    pose_choice : array of shape (k, N), optional
        Poses that may be recommended [rad].

    Returns
    -------
    NextMeasurement or None
        None where the load is undetermined, as by one axis, no axis gives information, or there is no pose to choose.
    """
    stays = load.budget.get(CONSTANTS, 0.0) + load.budget.get(DRIFT, 0.0)
    now = _with_unknown(load, 1.0 - stays)
    q = candidates(robot) if pose_choice is None else pose_choice
    if now is None or robot.axes == 1 or not np.isfinite(sigma_nm).any() or not len(q):
        return None
    gain = payload_information(robot, q, sigma_nm, knowledge.gravity_m_s2)
    size = np.sqrt(np.diag(now))
    before = np.linalg.inv(now / np.outer(size, size))
    after = before + gain * np.outer(size, size)
    value = np.linalg.slogdet(after)[1] - np.linalg.slogdet(before)[1]
    best = int(np.argmax(value))
    return NextMeasurement(
        what=f"measure this pose bare and with load {load.label}, from both sides",
        poses_rad=(tuple(round(float(angle), 6) for angle in q[best]),),
        reduction=float(np.sqrt(stays + (1.0 - stays) * np.exp(-value[best] / 4.0))),
    )


def shrinks_most(load: LoadEstimate) -> NextMeasurement | None:
    """Return the action against the largest source of a mass's variance; None if no source dominates.

    `reduction` is the expected standard deviation over the present one. Friction and noise are assumed to drop to half
    their variance, other sources to zero.
    """
    if not load.budget or load.refused is not None:
        return None
    source = max(load.budget, key=lambda name: load.budget[name])
    share = load.budget[source]
    if share < _DOMINANT_SHARE:
        return None
    action, cause, remaining = _ACTIONS[source]
    return NextMeasurement(
        what=f"{action.format(load=load.label)}: {100 * share:.0f} % of the variance of {load.label}'s mass comes from"
        f" {cause}",
        reduction=float(np.sqrt(max(1.0 - share * (1.0 - remaining), 0.0))),
    )


def candidates(robot: Robot) -> Floats:
    """Return random postures (n, N) within the joint limits, with a fixed seed.

    A joint without limits covers one turn.
    """
    low = np.where(np.isfinite(robot.lower_rad), robot.lower_rad, -np.pi)
    high = np.where(np.isfinite(robot.upper_rad), robot.upper_rad, np.pi)
    return np.random.default_rng(_SEED).uniform(low, high, size=(_CANDIDATES, robot.axes))


def _with_unknown(load: LoadEstimate, share: float) -> Floats | None:
    """Return this share of the covariance (4, 4) of [m, h], with a wide variance in undetermined directions."""
    if load.refused is not None or not np.isfinite(load.covariance).all():
        return None
    wide = np.diag([_UNKNOWN_KG, *[0.3 * _UNKNOWN_KG] * 3]) ** 2
    open_ = np.array([name in load.unidentifiable for name in ("mass_kg", "com_x_m", "com_y_m", "com_z_m")])
    return share * load.covariance + np.where(np.outer(open_, open_), wide, 0.0) + 1e-12 * np.eye(4)


def wrist_in_words(robot: Robot) -> str:
    """Name the axes that rotate the flange about the wrist: the last three of an arm with more than three axes."""
    first = max(2, robot.axes - 2)
    return f"axis {first}" if first == robot.axes else f"axes {first} to {robot.axes}"


def cost_of_missing_axes(robot: Robot, q_rad: Floats, sigma_nm: Floats, knowledge: Knowledge) -> float:
    """Return the present standard deviation of the mass over that with all axes measured.

    Infinite if the mass is undetermined now. Unmeasured axes are assumed to have the median noise of the others.
    """
    full = np.where(np.isfinite(sigma_nm), sigma_nm, np.nanmedian(sigma_nm))
    now, then = (
        payload_information(robot, q_rad, sigma, knowledge.gravity_m_s2).sum(axis=0) for sigma in (sigma_nm, full)
    )
    return float(np.sqrt(_mass_variance(now) / _mass_variance(then)))


def _mass_variance(information: Floats) -> float:
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    keep = values > 1e-9 * values[-1]
    if (np.abs(vectors[0, ~keep]) > 1e-6).any():
        return np.inf
    return float(np.sum(vectors[0, keep] ** 2 / values[keep])) / size[0] ** 2
