"""What separates the two real arms from their data sheets: drawn by the simulator from a seed, told to nobody."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.pair.geometry import ArmGeometry, bases, nominal_arm, translation

Array = NDArray[np.float64]

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
BACKLASH_RAD = np.array([0.0, 0.0, 0.0, 0.2e-3, 0.2e-3, 0.2e-3])
CYCLIC_RAD = 0.05e-3
#: Periods per revolution of a gear stage; the error comes from the slower of two equal stages.
CYCLIC_PERIODS = 2.0
SKEW_S = 1.0e-3
GRAVITY_SHARE, FRICTION_SHARE = 0.02, 0.20
COULOMB_SHARE, VISCOUS_SHARE = 0.03, 0.02
DRIFT_M = 0.1e-3
DRIFT_S = 600.0


@dataclass(frozen=True, slots=True, eq=False)
class ArmErrors:
    """One real arm.

    Attributes
    ----------
    geometry : ArmGeometry, the true one
    gear_stiffness_nm_rad : array of shape (6,)
    lag_s : array of shape (6,), time constant of the servo of each joint
    backlash_rad : array of shape (6,), full play of the gear
    cyclic_rad, cyclic_phase_rad : arrays of shape (6,), amplitude and phase of the gear's cyclic error
    cyclic_per_rev : array of shape (6,), periods per revolution of the joint
    gravity_scale, friction_scale : arrays of shape (6,), what the controller's model says over what is true
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
    """Errors of both arms; the same seed gives the same errors.

    Parameters
    ----------
    seed : int
    nominal_bases : two arrays of shape (4, 4)
        Bases of master and slave in the world [m].
    """
    rng = np.random.default_rng([seed, 0xA51])
    master, slave = (_draw_arm(rng, base, lag) for base, lag in zip(nominal_bases, SERVO_LAG_S, strict=True))
    return PairErrors(seed, master, slave, float(rng.uniform(0.0, SKEW_S)))


def without_local(errors: PairErrors) -> PairErrors:
    """The same arms without backlash and cyclic gear error."""
    zero = np.zeros(6)
    master, slave = (replace(arm, backlash_rad=zero, cyclic_rad=zero) for arm in (errors.master, errors.slave))
    return replace(errors, master=master, slave=slave)


def without_lag(errors: PairErrors) -> PairErrors:
    """The same arms with servos that follow at once, and both buses in step."""
    zero = np.zeros(6)
    master, slave = (replace(arm, lag_s=zero) for arm in (errors.master, errors.slave))
    return replace(errors, master=master, slave=slave, skew_s=0.0)


def ideal(errors: PairErrors) -> PairErrors:
    """Arms as their data sheets say, servos that follow at once; only what the force estimate is told stays wrong."""
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


def _draw_arm(rng: np.random.Generator, base: Array, lag_s: float) -> ArmErrors:
    nominal = nominal_arm(base)
    geometry = ArmGeometry(
        d_m=nominal.d_m + rng.normal(0.0, LENGTH_M, 6),
        a_m=nominal.a_m + rng.normal(0.0, LENGTH_M, 6),
        alpha_rad=nominal.alpha_rad + rng.normal(0.0, TWIST_RAD, 6),
        zero_rad=rng.normal(0.0, ZERO_RAD, 6),
        base=nominal.base @ _small_pose(rng, BASE_M, BASE_RAD),
        tool=nominal.tool @ _small_pose(rng, TOOL_M, TOOL_RAD),
    )
    return ArmErrors(
        geometry=geometry,
        gear_stiffness_nm_rad=GEAR_STIFFNESS_NM_RAD * rng.uniform(1.0 - STIFFNESS_SHARE, 1.0 + STIFFNESS_SHARE, 6),
        lag_s=lag_s * (1.0 + rng.normal(0.0, LAG_SHARE, 6)),
        backlash_rad=BACKLASH_RAD.copy(),
        cyclic_rad=np.full(6, CYCLIC_RAD),
        cyclic_phase_rad=rng.uniform(0.0, 2.0 * np.pi, 6),
        cyclic_per_rev=CYCLIC_PERIODS * GEAR_RATIO / np.round(np.sqrt(GEAR_RATIO)),
        gravity_scale=1.0 + rng.normal(0.0, GRAVITY_SHARE, 6),
        friction_scale=1.0 + rng.normal(0.0, FRICTION_SHARE, 6),
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
