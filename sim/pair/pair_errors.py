"""Draw from a seed how the two simulated arms differ from their data sheets; the gateway does not read these values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.pair.geometry import ArmGeometry
from sim.urdf import translation, turn_about

Array = NDArray[np.float64]

#: The reference arm's.
GEAR_STIFFNESS_NM_RAD = np.array([4e5, 4e5, 2.5e5, 6e4, 4e4, 2.5e4])
RATED_TORQUE_NM = np.array([600.0, 900.0, 500.0, 120.0, 100.0, 60.0])
SERVO_LAG_S = (0.015, 0.017)
LENGTH_M, TWIST_RAD, ZERO_RAD = 0.4e-3, 0.3e-3, 0.5e-3
BASE_M, BASE_RAD = 1.0e-3, 1.0e-3
TOOL_M, TOOL_RAD = 0.3e-3, 0.5e-3
STIFFNESS_SHARE, LAG_SHARE = 0.20, 0.08
#: Of the gears of the hand, the last joints of an arm; the others have none.
BACKLASH_RAD, HAND_JOINTS = 0.2e-3, 3
CYCLIC_RAD = 0.05e-3
#: Periods per revolution of a gear stage; the error comes from the slower of two equal stages.
CYCLIC_PERIODS = 2.0
SKEW_S = 1.0e-3
GRAVITY_SHARE, FRICTION_SHARE = 0.02, 0.20
COULOMB_SHARE, VISCOUS_SHARE = 0.03, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class ArmSheet:
    """Nominal values of one arm from its data sheet.

    Attributes
    ----------
    geometry : ArmGeometry
    gear_stiffness_nm_rad, gear_ratio : arrays of shape (N,)
    """

    geometry: ArmGeometry
    gear_stiffness_nm_rad: Array
    gear_ratio: Array


@dataclass(frozen=True, slots=True, eq=False)
class ArmErrors:
    """True values of one simulated arm.

    Attributes
    ----------
    geometry : ArmGeometry, the true one
    gear_stiffness_nm_rad : array of shape (N,)
    lag_s : array of shape (N,), time constant of the servo of each joint
    backlash_rad : array of shape (N,), full play of the gear
    cyclic_rad, cyclic_phase_rad : arrays of shape (N,), amplitude and phase of the gear's cyclic error
    cyclic_per_rev : array of shape (N,), periods per revolution of the joint
    gravity_scale, friction_scale : arrays of shape (N,), ratio of the controller's model to the true value
    """

    geometry: ArmGeometry
    gear_stiffness_nm_rad: Array
    lag_s: Array
    backlash_rad: Array
    cyclic_rad: Array
    cyclic_phase_rad: Array
    cyclic_per_rev: Array
    gravity_scale: Array
    friction_scale: Array


@dataclass(frozen=True, slots=True, eq=False)
class PairErrors:
    """True values of both arms, and the delay of the slave's SYNC after the master's [s]."""

    seed: int
    master: ArmErrors
    slave: ArmErrors
    skew_s: float


def draw(seed: int, sheets: tuple[ArmSheet, ArmSheet]) -> PairErrors:
    """Draw the errors of the arms of two data sheets; the same seed gives the same errors."""
    rng = np.random.default_rng([seed, 0xA51])
    master, slave = (_draw_arm(rng, sheet, lag) for sheet, lag in zip(sheets, SERVO_LAG_S, strict=True))
    return PairErrors(seed, master, slave, float(rng.uniform(0.0, SKEW_S)))


def as_stated(sheets: tuple[ArmSheet, ArmSheet], lag_s: float) -> PairErrors:
    """Return arms with the values of their data sheets and equal servo lag [s]."""
    arms = []
    for sheet in sheets:
        one, zero = np.ones(sheet.gear_ratio.shape), np.zeros(sheet.gear_ratio.shape)
        geometry, stiffness = sheet.geometry, sheet.gear_stiffness_nm_rad
        arms.append(ArmErrors(geometry, stiffness, lag_s * one, zero, zero, zero, one, one, one))
    return PairErrors(-1, arms[0], arms[1], 0.0)


def _draw_arm(rng: np.random.Generator, sheet: ArmSheet, lag_s: float) -> ArmErrors:
    nominal, ratio = sheet.geometry, sheet.gear_ratio
    axes = len(ratio)
    geometry = ArmGeometry(
        d_m=nominal.d_m + rng.normal(0.0, LENGTH_M, axes),
        a_m=nominal.a_m + rng.normal(0.0, LENGTH_M, axes),
        alpha_rad=nominal.alpha_rad + rng.normal(0.0, TWIST_RAD, axes),
        zero_rad=nominal.zero_rad + rng.normal(0.0, ZERO_RAD, axes),
        base=nominal.base @ _small_pose(rng, BASE_M, BASE_RAD),
        tool=nominal.tool @ _small_pose(rng, TOOL_M, TOOL_RAD),
    )
    return ArmErrors(
        geometry=geometry,
        gear_stiffness_nm_rad=sheet.gear_stiffness_nm_rad
        * rng.uniform(1.0 - STIFFNESS_SHARE, 1.0 + STIFFNESS_SHARE, axes),
        lag_s=lag_s * (1.0 + rng.normal(0.0, LAG_SHARE, axes)),
        backlash_rad=np.where(np.arange(axes) < axes - HAND_JOINTS, 0.0, BACKLASH_RAD),
        cyclic_rad=np.full(axes, CYCLIC_RAD),
        cyclic_phase_rad=rng.uniform(0.0, 2.0 * np.pi, axes),
        cyclic_per_rev=CYCLIC_PERIODS * ratio / np.round(np.sqrt(ratio)),
        gravity_scale=1.0 + rng.normal(0.0, GRAVITY_SHARE, axes),
        friction_scale=1.0 + rng.normal(0.0, FRICTION_SHARE, axes),
    )


def _small_pose(rng: np.random.Generator, position_m: float, angle_rad: float) -> Array:
    """Draw a small displacement (4, 4): translation, and an exact rotation about a random vector."""
    vector = rng.normal(0.0, angle_rad, 3)
    result = translation(*rng.normal(0.0, position_m, 3))
    result[:3, :3] = turn_about(vector)
    return result
