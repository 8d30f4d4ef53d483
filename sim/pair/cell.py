"""The pair of a cell file with what the gateway is not told, drawn from a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sim.cellfile import ArmSpec, CellFileError, CellSpec
from sim.pair.body import ArmTruth
from sim.pair.errors import GEAR_STIFFNESS_NM_RAD, ArmErrors, PairErrors, draw
from sim.pair.gap import GapSensors, add_sensors
from sim.pair.geometry import TOOL_M, bases, frames, nominal_arm, nominal_arms
from sim.pair.light import LightWorld
from sim.pair.motors import DriveTrain
from sim.pair.two_arms import TwoArms
from sim.pair.unit import PairUnit
from sim.pair.workpiece import Stiffness
from sim.pair.world import PairWorld, WorldSettings
from sim.urdf import SimBody, combine

Array = NDArray[np.float64]

#: Servo lag of a pair without drawn errors [s].
NOMINAL_LAG_S = 0.016
#: Half the bar about its end, as a rod of 0.2 m.
HALF_PART_M = 0.2
FIT_M = 1e-6
#: What may stand for the arms: PyBullet in small steps, or a balance of forces that keeps up with the clock.
PLANTS: Mapping[str, type[TwoArms]] = {"bullet": PairWorld, "light": LightWorld}


@dataclass(frozen=True, slots=True)
class PairOptions:
    """What may be changed about the simulated pair.

    Attributes
    ----------
    seed : of the undeclared errors; None = the arms of the data sheet
    errors : drawn errors in place of the seed's
    settings : fields of `WorldSettings` to change
    plant : "bullet", or "light" for the clock; None = as the buses' pacing asks
    """

    seed: int | None = None
    errors: PairErrors | None = None
    settings: Mapping[str, Any] | None = None
    plant: Literal["bullet", "light"] | None = None


def pair_units(cell: CellSpec, options: PairOptions) -> dict[str, PairUnit]:
    """Both arms of a cell on one physics, by name.

    Raises
    ------
    CellFileError : a key is missing, or the arms are not the ones this simulator builds
    """
    names = [str((cell.pair or {}).get(role)) for role in ("master", "slave")]
    specs = {arm.name: arm for arm in cell.arms}
    if not all(name in specs for name in names) or names[0] == names[1]:
        raise CellFileError(f"[pair] of cell '{cell.name}': master and slave must name two arms of it, got {names}")
    arms = (specs[names[0]], specs[names[1]])
    for arm in arms:
        _check(arm)
    errors = options.errors
    if errors is None:
        errors = _without_errors() if options.seed is None else draw(options.seed, bases())
    pair = cell.pair or {}
    part, apart = float(pair.get("part_mass_kg", 0.0)), "distance" in pair
    shares = (_whole_part(part), None) if apart else (_half_part(0.5 * part),) * 2
    truths = (_truth(arms[0], errors.master, shares[0]), _truth(arms[1], errors.slave, shares[1]))
    start = tuple(np.array(arm.start_rad, dtype=float) for arm in arms)
    settings = WorldSettings(
        (start[0], start[1]), skew_s=errors.skew_s, seed=1 if options.seed is None else options.seed
    )
    if apart:
        settings = replace(settings, stiffness=Stiffness(0.0, 0.0))
    real = any(cell.buses[arm.bus].pacing == "real" for arm in arms)
    plant = PLANTS[options.plant or ("light" if real else "bullet")]
    world = plant(truths, replace(settings, **(options.settings or {})))
    world.told_nobody = _plain(asdict(errors))
    units = {arm.name: PairUnit(arm, world, index, cell.buses[arm.bus]) for index, arm in enumerate(arms)}
    if apart:
        unit = next(units[arm.name] for arm in arms if arm.bus == pair["distance"]["bus"])
        add_sensors(pair, unit, GapSensors(pair, world, settings.seed))
    return units


def _check(arm: ArmSpec) -> None:
    """The simulated pair is built from its own table of rows; the cell's URDF has to be the same arm."""
    if arm.start_rad is None or len(arm.start_rad) != 6:
        raise CellFileError(
            f"arm '{arm.name}' of a pair needs start_rad: six joint angles at which the part is gripped"
        )
    nominal = nominal_arm(np.eye(4))
    own = frames(nominal, np.zeros(6))
    before = np.eye(4)
    for i in range(6):
        before = before @ arm.chain.placement[i]
        wanted = np.eye(4) if i == 0 else own[i - 1]
        if np.abs(before - wanted).max() > FIT_M:
            raise CellFileError(f"arm '{arm.name}': joint {i + 1} does not stand where the simulated pair has it")


def _plain(value: Any) -> Any:
    """Arrays as lists, all the way down."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value


def _without_errors() -> PairErrors:
    one, zero = np.ones(6), np.zeros(6)
    master, slave = (
        ArmErrors(arm, GEAR_STIFFNESS_NM_RAD, np.full(6, NOMINAL_LAG_S), zero, zero, zero, one, one, one)
        for arm in nominal_arms()
    )
    return PairErrors(-1, master, slave, 0.0)


def _truth(arm: ArmSpec, errors: ArmErrors, carried: SimBody | None) -> ArmTruth:
    axes = arm.axes
    bodies: list[SimBody] = []
    for number, body in enumerate(arm.chain.bodies):
        if body is None:
            raise CellFileError(f"robot of arm '{arm.name}': link {number + 1} has no <inertial>; all six are needed")
        share = 1.0 / float(errors.gravity_scale[number])
        bodies.append(SimBody(body.mass_kg * share, body.com_m, body.inertia_kg_m2 * share))
    if carried is not None:
        bodies[5] = combine(bodies[5], carried)
    rated = np.array([axis.torque_limit_nm / 3.0 for axis in axes])
    train = DriveTrain(
        stiffness_nm_rad=errors.gear_stiffness_nm_rad,
        rotor_kg_m2=np.array([axis.rotor_inertia_kg_m2 for axis in axes]),
        coulomb_nm=np.array([axis.coulomb_nm for axis in axes]) / errors.friction_scale,
        viscous_nm_s_rad=np.array([axis.viscous_nm_s_rad for axis in axes]) / errors.friction_scale,
        rated_nm=rated,
        lag_s=np.maximum(errors.lag_s, 1e-3),
        backlash_rad=errors.backlash_rad,
        cyclic_rad=errors.cyclic_rad,
        cyclic_per_rad=errors.cyclic_per_rev,
        cyclic_phase_rad=errors.cyclic_phase_rad,
    )
    if not np.all(train.rotor_kg_m2 > 0):
        raise CellFileError(f"arm '{arm.name}' of a pair: every axis needs rotor_inertia_kg_m2, coulomb_nm, viscous")
    shift = np.array([axis.zero_offset_rad for axis in axes])
    speed = np.array([3.0 * axis.speed_limit_rad_s for axis in axes])
    return ArmTruth(errors.geometry, tuple(bodies), train, shift, speed)


def _half_part(mass_kg: float) -> SimBody:
    """Half the part at the fingertip of link 6."""
    place = np.array([0.0, 0.0, 0.10 + TOOL_M])
    return SimBody(mass_kg, place, np.eye(3) * mass_kg * HALF_PART_M**2 / 3.0)


def _whole_part(mass_kg: float) -> SimBody:
    """The part on the master alone: it holds one end of it."""
    place = np.array([-HALF_PART_M, 0.0, 0.10 + TOOL_M])
    inertia = mass_kg * HALF_PART_M**2 / 3.0
    return SimBody(mass_kg, place, np.diag([1e-4 * mass_kg, inertia, inertia]))
