"""What separates the two real arms from their data sheets: drawn by the simulator from a seed, told to nobody."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.pair.geometry import ArmGeometry, bases, nominal_arm, translation

Array = NDArray[np.float64]

#: The reference arm's.
GEAR_STIFFNESS_NM_RAD = np.array([4e5, 4e5, 2.5e5, 6e4, 4e4, 2.5e4])
RATED_TORQUE_NM = np.array([600.0, 900.0, 500.0, 120.0, 100.0, 60.0])
GEAR_RATIO = np.array([120.0, 120.0, 100.0, 80.0, 80.0, 50.0])
#: Joint speed that the viscous friction figure (2 % of rated torque) refers to, assumed [rad/s].
VISCOUS_AT_RAD_S = 1.0
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
DRIFT_M = 0.1e-3
DRIFT_S = 600.0


@dataclass(frozen=True, slots=True, eq=False)
class ArmSheet:
    """One arm as its data sheet says.

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
    """One real arm.

    Attributes
    ----------
    geometry : ArmGeometry, the true one
    gear_stiffness_nm_rad : array of shape (N,)
    lag_s : array of shape (N,), time constant of the servo of each joint
    backlash_rad : array of shape (N,), full play of the gear
    cyclic_rad, cyclic_phase_rad : arrays of shape (N,), amplitude and phase of the gear's cyclic error
    cyclic_per_rev : array of shape (N,), periods per revolution of the joint
    gravity_scale, friction_scale : arrays of shape (N,), what the controller's model says over what is true
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
    """Both arms, and how much later than the master's bus the slave's bus has its SYNC [s]."""

    seed: int
    master: ArmErrors
    slave: ArmErrors
    skew_s: float


def draw(seed: int, nominal_bases: tuple[Array, Array]) -> PairErrors:
    """Errors of both reference arms; the same seed gives the same errors.

    Parameters
    ----------
    seed : int
    nominal_bases : two arrays of shape (4, 4)
        Bases of master and slave in the world [m].
    """
    first, second = (ArmSheet(nominal_arm(base), GEAR_STIFFNESS_NM_RAD, GEAR_RATIO) for base in nominal_bases)
    return draw_of(seed, (first, second))


def draw_of(seed: int, sheets: tuple[ArmSheet, ArmSheet]) -> PairErrors:
    """Errors of the arms of two data sheets; the same seed gives the same errors."""
    rng = np.random.default_rng([seed, 0xA51])
    master, slave = (_draw_arm(rng, sheet, lag) for sheet, lag in zip(sheets, SERVO_LAG_S, strict=True))
    return PairErrors(seed, master, slave, float(rng.uniform(0.0, SKEW_S)))


def as_stated(sheets: tuple[ArmSheet, ArmSheet], lag_s: float) -> PairErrors:
    """Arms as their data sheets say, with servos that lag alike [s]."""
    arms = []
    for sheet in sheets:
        one, zero = np.ones(sheet.gear_ratio.shape), np.zeros(sheet.gear_ratio.shape)
        geometry, stiffness = sheet.geometry, sheet.gear_stiffness_nm_rad
        arms.append(ArmErrors(geometry, stiffness, lag_s * one, zero, zero, zero, one, one, one))
    return PairErrors(-1, arms[0], arms[1], 0.0)


def without_local(errors: PairErrors) -> PairErrors:
    """The same arms without backlash and cyclic gear error."""
    master, slave = (
        replace(arm, backlash_rad=np.zeros_like(arm.backlash_rad), cyclic_rad=np.zeros_like(arm.cyclic_rad))
        for arm in (errors.master, errors.slave)
    )
    return replace(errors, master=master, slave=slave)


def without_lag(errors: PairErrors) -> PairErrors:
    """The same arms with servos that follow at once, and both buses in step."""
    master, slave = (replace(arm, lag_s=np.zeros_like(arm.lag_s)) for arm in (errors.master, errors.slave))
    return replace(errors, master=master, slave=slave, skew_s=0.0)


def ideal(errors: PairErrors) -> PairErrors:
    """Reference arms by their data sheets, servos that follow at once; only what the force estimate is told is off."""
    plain = without_local(without_lag(errors))
    master, slave = (
        replace(arm, geometry=nominal_arm(base)) for arm, base in zip((plain.master, plain.slave), bases(), strict=True)
    )
    return replace(plain, master=master, slave=slave)


def warmed(errors: PairErrors, time_s: float) -> PairErrors:
    """The same arms after some time of work: both upper arms have grown, 0.1 mm in the first 10 min."""
    share = min(time_s / DRIFT_S, 1.0)
    grown = []
    for arm in (errors.master, errors.slave):
        a_m = arm.geometry.a_m.copy()
        a_m[1] += DRIFT_M * share
        grown.append(replace(arm, geometry=replace(arm.geometry, a_m=a_m)))
    return replace(errors, master=grown[0], slave=grown[1])


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
    """A pose (4, 4) a little off: exact rotation about a drawn vector."""
    vector = rng.normal(0.0, angle_rad, 3)
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    result = translation(*rng.normal(0.0, position_m, 3))
    result[:3, :3] = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    return result
