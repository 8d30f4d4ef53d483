"""Limits that are written to the drives of an arm (motor side), and the torque that each axis needs at worst."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drives.profile import DriveProfile
from gateway.cell.config import ArmConfig
from gateway.cell.conversion import AxisConversion
from gateway.errors import ConfigError
from gateway.feedforward.identified import AxisConstants, axis_constants, drawn_parameters
from gateway.feedforward.load import FeedLoad, assumed_load, rated_load
from gateway.model.regressor import regressor
from gateway.motion.workspace import BAND_SHARE, Workspace
from gateway.preflight.coasting import quick_stop_ramp
from gateway.preflight.rules import Readings, counts_per_revolution

#: Margin beyond a joint limit [rad, joint] within which the drive accepts a target that was rounded to counts.
ROUNDING_RAD: Final = 1e-4

Range = tuple[float, float]
Floats = NDArray[np.float64]
#: Reserve factor: Coriolis torques, model errors of some percent, a swinging load.
RESERVE = 1.3
#: Search for the worst posture: number of random postures, angles per joint, number of refinements,
#: and the factor by which each refinement narrows the range.
POSTURES, STARTS, ANGLES, SWEEPS, NARROWER = 1500, 3, 24, 4, 5
SEED = 11


def motor_ranges_rad(arm: ArmConfig) -> tuple[Range | None, ...]:
    """Return the motor angles [rad] at the limits of each joint; None for an axis whose motor also turns other joints.

    Parameters
    ----------
    arm : ArmConfig
    """
    axes = AxisConversion.from_arm(arm)
    limits = np.array([axis.position_limit_rad for axis in arm.axis]).T + ROUNDING_RAD * np.array([[-1.0], [1.0]])
    ends = np.sort(axes.motor_position(limits), axis=0)
    coupled = np.count_nonzero(axes.coupling, axis=1) > 1
    return tuple(None if mixed else (float(low), float(high)) for mixed, low, high in zip(coupled, *ends, strict=True))


def motor_torques_nm(axes: AxisConversion, joint_nm: Floats) -> Floats:
    """Return the motor torque (N,) [Nm] of each drive for joint torques (N,) [Nm] of either sign.

    Parameters
    ----------
    axes : AxisConversion
    joint_nm : array of shape (N,)
        Largest torque of each joint, gear losses included.
    """
    return np.abs(np.linalg.inv(axes.coupling)).T @ joint_nm / np.abs(axes.ratio)


def quick_stop_rad_s2(
    arm: ArmConfig, profiles: Sequence[DriveProfile], readings: Sequence[Readings]
) -> np.ndarray | None:
    """Return the joint decelerations (N,) [rad/s2] of the drives' quick stop ramps; None if one is not known.

    Parameters
    ----------
    arm : ArmConfig
    profiles : sequence of DriveProfile, one per axis
    readings : sequence of Readings, one per axis
        Objects of each drive.
    """
    motor: list[float] = []
    for profile, objects in zip(profiles, readings, strict=True):
        raw, velocity = quick_stop_ramp(objects)[1], profile.velocity
        unit_rad_s2 = None if velocity is None else velocity.ramp_rad_s2(counts_per_revolution(profile, objects))
        if not raw or unit_rad_s2 is None:
            return None
        motor.append(raw * unit_rad_s2)
    return AxisConversion.from_arm(arm).joint_bound(np.array(motor))


def needed_torque_nm(
    workspace: Workspace, arm: ArmConfig, decel_rad_s2: Floats, known: tuple[AxisConstants, ...] = ()
) -> Floats | None:
    """Return the largest torque (N,) [Nm, joint side, gear losses included] that every axis needs, with a reserve.

    1.3 x (largest gravity torque over the joint range, divided by the gear efficiency, + friction band + quick stop
    torque). Gravity is that of the unloaded arm and of the arm with the rated and the heaviest load. The quick stop
    torque is the row of the inertia matrix, including the rotor, times the decelerations of all axes. The three maxima
    are added, although they occur at different postures.

    Parameters
    ----------
    workspace : Workspace
    arm : ArmConfig
        Source of the loads, and of rotors and friction that were not identified.
    decel_rad_s2 : array of shape (N,)
        Quick stop decelerations at the joints.
    known : tuple of AxisConstants, one per axis, optional
        Rotors and friction; defaults to those of the arm.

    Returns
    -------
    array of shape (N,) or None
        None where the links, a rotor's inertia or the load that the arm may carry are not known.
    """
    loads = possible_loads(workspace, arm)
    bodies = links_with_loads(workspace, arm, loads) if loads else None
    known = known or axis_constants(arm, None)
    rotors = [axis.rotor_kg_m2 for axis in known]
    if bodies is None or None in rotors:
        return None
    rotor = np.array([0.0 if inertia is None else inertia.value for inertia in rotors])
    lost = np.maximum(1.0 / workspace.efficiency, [1.0 + axis.load_friction for axis in known])
    friction = dry_friction_nm(arm, known)

    def gravity_nm(q_rad: Floats) -> Floats:
        still = np.zeros_like(q_rad)
        rows = regressor(workspace.robot, q_rad, still, still, workspace.gravity_m_s2)
        return np.abs(rows @ bodies).max(axis=2) * lost

    def stopping_nm(q_rad: Floats) -> Floats:
        still, turned = np.zeros_like(q_rad), [np.broadcast_to(row, q_rad.shape) for row in np.diag(decel_rad_s2)]
        rows = (regressor(workspace.robot, q_rad, still, qdd_rad_s2, np.zeros(3)) for qdd_rad_s2 in turned)
        return sum((np.abs(each @ bodies) for each in rows), np.zeros(())).max(axis=2)

    middle = (workspace.lower_rad + workspace.upper_rad) / 2
    half = np.minimum((workspace.upper_rad - workspace.lower_rad) / 2, np.pi)
    largest = [_largest(torque, middle - half, middle + half) for torque in (gravity_nm, stopping_nm)]
    return RESERVE * (sum(largest, friction) + rotor * decel_rad_s2)


def dry_friction_nm(arm: ArmConfig, known: Sequence[AxisConstants]) -> Floats:
    """Return the dry friction (N,) [Nm] of the joints: the largest known value, including breakaway.

    Without any value the assumed friction band is used.
    """
    return np.array(
        [
            BAND_SHARE * axis.torque_limit_nm
            if constants.coulomb_nm is None
            else float(np.fmax(constants.coulomb_nm.value, constants.breakaway_nm))
            for constants, axis in zip(known, arm.axis, strict=True)
        ]
    )


def links_with_loads(workspace: Workspace, arm: ArmConfig, loads: Sequence[FeedLoad]) -> Floats | None:
    """Return the link parameters (10 N, 1 + loads) without and with each load; None where a link is unknown."""
    try:
        links = drawn_parameters(workspace.robot, arm)
    except ConfigError:
        return None
    carried = [links]
    for load in loads:
        carried.append(links.copy())
        carried[-1][-10:] += load.parameters
    return np.column_stack(carried)


def possible_loads(workspace: Workspace, arm: ArmConfig) -> tuple[FeedLoad, ...]:
    """Return the rated and the heaviest load, if defined, as solid bodies in the last link."""
    loads = [] if arm.rated_load_kg is None else [rated_load(arm, workspace.robot)]
    if workspace.max_load is not None:
        com_m = workspace.max_load[1:] / workspace.max_load[0]
        loads.append(assumed_load("heaviest", float(workspace.max_load[0]), com_m, "max_load_kg of the cell file"))
    return tuple(loads)


def _largest(torque_nm: Callable[[Floats], Floats], lower_rad: Floats, upper_rad: Floats) -> Floats:
    """Return the largest torque (N,) over a range of postures, of a function of postures (n, N) to torques (n, N)."""
    random = np.random.default_rng(SEED)
    axes = len(lower_rad)
    drawn = random.uniform(lower_rad, upper_rad, (POSTURES, axes))
    found = torque_nm(drawn)
    best = np.argsort(-found, axis=0)[:STARTS]
    axis = np.tile(np.arange(axes), STARTS)
    q_rad = drawn[best.ravel()]
    rows = np.arange(len(q_rad))
    for sweep, joint in product(range(SWEEPS), range(axes)):
        tried = np.repeat(q_rad[:, None], ANGLES + 1, axis=1)
        half = (upper_rad[joint] - lower_rad[joint]) / NARROWER**sweep
        around = q_rad[:, joint, None] + np.linspace(-half, half, ANGLES)
        tried[:, :-1, joint] = np.clip(around, lower_rad[joint], upper_rad[joint])
        value = torque_nm(tried.reshape(-1, axes)).reshape(len(q_rad), ANGLES + 1, axes)
        q_rad = tried[rows, np.argmax(value[rows, :, axis], axis=1)]
    return np.maximum(found.max(axis=0), torque_nm(q_rad).max(axis=0))
