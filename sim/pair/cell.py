"""Build the pair of a cell file with undeclared errors drawn from a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sim.cellfile import ArmSpec, CellFileError, CellSpec
from sim.pair.body import ArmTruth
from sim.pair.gap import GapSensors, add_sensors
from sim.pair.geometry import ArmGeometry
from sim.pair.light import LightWorld
from sim.pair.motors import DriveTrain
from sim.pair.pair_errors import (
    GEAR_STIFFNESS_NM_RAD,
    RATED_TORQUE_NM,
    ArmErrors,
    ArmSheet,
    as_stated,
    draw,
)
from sim.pair.rows import ArmRows, rows_of
from sim.pair.two_arms import TwoArms
from sim.pair.unit import PairUnit
from sim.pair.workpiece import Stiffness
from sim.pair.world import PairWorld, WorldSettings
from sim.urdf import SimBody, combine, translation

Array = NDArray[np.float64]

#: Servo lag of a pair without drawn errors [s].
NOMINAL_LAG_S = 0.016
#: Half the bar about its end, as a rod of 0.2 m.
HALF_PART_M = 0.2
#: Largest torque of an axis over its rated one.
PEAK = 3.0
#: Gears of a catalogue: rated torque [Nm] and stiffness [Nm/rad]; below and above, as the smallest and the largest.
GEARS = (
    np.concatenate([[0.0], np.sort(RATED_TORQUE_NM), [10.0 * RATED_TORQUE_NM.max()]]),
    np.concatenate([[0.0], np.sort(GEAR_STIFFNESS_NM_RAD), [10.0 * GEAR_STIFFNESS_NM_RAD.max()]]),
)
#: Plant models: PyBullet in small steps, or a static force balance that is fast enough for real time.
PLANTS: Mapping[str, type[TwoArms]] = {"bullet": PairWorld, "light": LightWorld}


def pair_units(
    cell: CellSpec,
    seed: int | None,
    settings: Mapping[str, Any] | None = None,
    plant: Literal["bullet", "light"] | None = None,
) -> dict[str, PairUnit]:
    """Both arms of a cell on one physics, by name.

    Parameters
    ----------
    cell : with the table of the pair
    seed : of the undeclared errors; None = the arms of the data sheet
    settings : fields of `WorldSettings` to change
    plant : "bullet", or "light" for real time; None = by the pacing of the buses

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
    rows = (rows_of(arms[0]), rows_of(arms[1]))
    sheets = (_sheet(arms[0], rows[0]), _sheet(arms[1], rows[1]))
    errors = as_stated(sheets, NOMINAL_LAG_S) if seed is None else draw(seed, sheets)
    pair = cell.pair or {}
    part, apart = float(pair.get("part_mass_kg", 0.0)), "distance" in pair
    hands = [_fingertip(one.geometry) for one in rows]
    shares = (_whole_part(part, hands[0]), None) if apart else tuple(_half_part(0.5 * part, hand) for hand in hands)
    truths = (_truth(arms[0], rows[0], errors.master, shares[0]), _truth(arms[1], rows[1], errors.slave, shares[1]))
    start = tuple(np.array(arm.start_rad, dtype=float) for arm in arms)
    stated = WorldSettings((start[0], start[1]), skew_s=errors.skew_s, seed=1 if seed is None else seed)
    if apart:
        stated = replace(stated, stiffness=Stiffness(0.0, 0.0))
    stated = replace(stated, **(settings or {}))
    real = any(cell.buses[arm.bus].pacing == "real" for arm in arms)
    world = PLANTS[plant or ("light" if real else "bullet")](truths, stated)
    world.undeclared = _plain(asdict(errors))
    units = {arm.name: PairUnit(arm, world, index, cell.buses[arm.bus]) for index, arm in enumerate(arms)}
    if apart:
        unit = next(units[arm.name] for arm in arms if arm.bus == pair["distance"]["bus"])
        add_sensors(pair, unit, GapSensors(pair, world, stated.seed))
    return units


def _check(arm: ArmSpec) -> None:
    if arm.start_rad is None or len(arm.start_rad) != len(arm.axes):
        raise CellFileError(
            f"arm '{arm.name}' of a pair needs start_rad: {len(arm.axes)} joint angles at which the part is gripped"
        )


def _sheet(arm: ArmSpec, rows: ArmRows) -> ArmSheet:
    """Data sheet of an arm: gears are as stiff as gears of their torque are."""
    stiffness = np.interp(_rated_nm(arm), *GEARS)
    return ArmSheet(rows.geometry, stiffness, np.array([axis.gear_ratio for axis in arm.axes]))


def _rated_nm(arm: ArmSpec) -> Array:
    return np.array([axis.torque_limit_nm / PEAK for axis in arm.axes])


def _plain(value: Any) -> Any:
    """Convert arrays to lists, recursively."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value


def _truth(arm: ArmSpec, rows: ArmRows, errors: ArmErrors, carried: SimBody | None) -> ArmTruth:
    axes = arm.axes
    bodies: list[SimBody] = []
    for number, body in enumerate(rows.bodies):
        if body is None:
            raise CellFileError(f"robot of arm '{arm.name}': link {number + 1} has no <inertial>; all are needed")
        share = 1.0 / float(errors.gravity_scale[number])
        bodies.append(SimBody(body.mass_kg * share, body.com_m, body.inertia_kg_m2 * share))
    if carried is not None:
        bodies[-1] = combine(bodies[-1], carried)
    train = DriveTrain(
        stiffness_nm_rad=errors.gear_stiffness_nm_rad,
        rotor_kg_m2=np.array([axis.rotor_inertia_kg_m2 for axis in axes]),
        coulomb_nm=np.array([axis.coulomb_nm for axis in axes]) / errors.friction_scale,
        viscous_nm_s_rad=np.array([axis.viscous_nm_s_rad for axis in axes]) / errors.friction_scale,
        rated_nm=_rated_nm(arm),
        lag_s=np.maximum(errors.lag_s, 1e-3),
        backlash_rad=errors.backlash_rad,
        cyclic_rad=errors.cyclic_rad,
        cyclic_per_rad=errors.cyclic_per_rev,
        cyclic_phase_rad=errors.cyclic_phase_rad,
        shift_rad=np.array([axis.zero_offset_rad for axis in axes]),
        max_rad_s=np.array([3.0 * axis.speed_limit_rad_s for axis in axes]),
    )
    if not np.all(train.rotor_kg_m2 > 0):
        raise CellFileError(f"arm '{arm.name}' of a pair: every axis needs rotor_inertia_kg_m2, coulomb_nm, viscous")
    return ArmTruth(errors.geometry, tuple(bodies), train)


def _fingertip(geometry: ArmGeometry) -> Array:
    """Fingertip (4, 4) in the frame that turns with the last row."""
    return translation(0.0, 0.0, float(geometry.d_m[-1])) @ geometry.tool


def _half_part(mass_kg: float, fingertip: Array) -> SimBody:
    """Half the part at a fingertip (4, 4)."""
    return SimBody(mass_kg, fingertip[:3, 3], np.eye(3) * mass_kg * HALF_PART_M**2 / 3.0)


def _whole_part(mass_kg: float, fingertip: Array) -> SimBody:
    """The part on the master alone: it holds one end of it with its fingertip (4, 4)."""
    turned = fingertip[:3, :3]
    place = fingertip[:3, 3] + turned @ np.array([-HALF_PART_M, 0.0, 0.0])
    inertia = mass_kg * HALF_PART_M**2 / 3.0
    return SimBody(mass_kg, place, turned @ np.diag([1e-4 * mass_kg, inertia, inertia]) @ turned.T)
