"""Constants of the feedforward: friction and rotor inertia of every axis, and inertial parameters of the links.

The cell file names a sealed result of this cell and arm (`identified` of `[[arm]]`). Its friction and rotor inertia
replace the stated values, each with file and date as source. A value that is missing or too uncertain falls back to the
stated one, with a note. A contradiction beyond a factor of `REFUSED_FACTOR` is refused.

The links have their CAD values, corrected by an identification at rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig, AxisConfig, LoadedCell
from gateway.errors import ConfigError, InputError
from gateway.feedforward.load import other_origin, sourced
from gateway.identify.links import PER_LINK_AT_REST, body_parameters, link_prior, link_values
from gateway.model.robot import Robot
from gateway.result.drawn import Drawn
from gateway.result.numerals import half_width, with_interval
from gateway.result.result import AxisMotion, Bare, Result, read_result
from gateway.result.values import NAN

Floats = NDArray[np.float64]

#: An identified constant that differs from the stated one by this factor is reported; by `REFUSED_FACTOR`, with its
#: whole
#: interval, it is refused: friction doubles from warm to cold, and a datasheet's rotor may lack gear and brake.
SAID_FACTOR, REFUSED_FACTOR = 2.0, 5.0
#: Largest ratio of the half width of the 95 % interval to the value at which a constant is used.
LARGEST_HALF = 1.0
#: Smallest corrected link mass, as a share of the CAD mass: below it the identification contradicts the robot model.
LEAST_SHARE = 0.3


@dataclass(frozen=True, slots=True)
class Known:
    """Constant of an axis with its source: identified in motion, or stated."""

    value: float
    source: str
    identified: bool = False


@dataclass(frozen=True, slots=True)
class AxisConstants:
    """Drive train constants of one axis, at the gear output; None where neither identified nor stated.

    Attributes
    ----------
    rotor_kg_m2, coulomb_nm, viscous_nm_s_rad : Known or None
    load_friction : float
        Share of the torque at the gear output that is lost in addition to the stated gear efficiency; 0 = not
        identified.
    breakaway_nm, stribeck_rad_s : float
        Breakaway friction, and the speed over which it falls to `coulomb_nm`; NaN without an identified Stribeck curve.
    notes : tuple of str
        Notes on identified values that are not used, or that differ from the stated ones.
    """

    rotor_kg_m2: Known | None = None
    coulomb_nm: Known | None = None
    viscous_nm_s_rad: Known | None = None
    load_friction: float = 0.0
    breakaway_nm: float = NAN
    stribeck_rad_s: float = NAN
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """Result whose friction and rotor inertia are used.

    Attributes
    ----------
    result : Result
    where : str
        File of the result.
    """

    result: Result
    where: str

    @property
    def source(self) -> str:
        """File and date, as shown in reports."""
        return sourced("identified", self.result, self.where)


def read_identified(loaded: LoadedCell, arm: ArmConfig, robot: Robot) -> Identified | None:
    """Return the identification that the cell file names for an arm; None if it names no file.

    Raises
    ------
    InputError
        The file cannot be read, was edited, has no checksum, is of another robot, cell or arm, or holds neither
        friction nor rotor inertia.
    """
    if arm.identified is None:
        return None
    path = loaded.path(arm.identified)
    result = read_result(path)
    if result.sha256 is None:
        raise InputError(f"{path}: has no checksum, so its origin is not verified; estimate again")
    about = result.data or Drawn()
    if about.cell is None or about.arm is None:
        raise InputError(f"{path}: names no cell and arm: estimate its recording again with --cell")
    elsewhere = other_origin(result, loaded, arm, robot)
    if elsewhere:
        raise InputError(
            f"{path}: was identified on {elsewhere}: friction and rotors of another arm cannot be used; correct"
            f" `identified` of arm '{arm.name}', or identify this one"
        )
    if not result.motion:
        raise InputError(
            f"{path}: holds neither friction nor rotor inertia, which need a motion: servo-gateway plan CELL"
            " --moving -o PLAN.json, record CELL --plan PLAN.json, estimate; or remove `identified` from the cell file"
        )
    return checked(result, str(path), len(arm.axis))


def checked(result: Result, where: str, axes: int) -> Identified:
    """Return the result as an identification of an arm with `axes` axes.

    Raises
    ------
    InputError
        A joint appears twice, or does not exist on the arm.
    """
    joints = [axis.joint for axis in result.motion]
    wrong = [joint for joint in joints if not 1 <= joint <= axes or joints.count(joint) > 1]
    if wrong:
        raise InputError(
            f"{where}: motion: joint {wrong[0]} is given twice, or the arm of {axes} axes does not have it"
        )
    return Identified(result, where)


def with_identified(loaded: LoadedCell, arm: str, path: Path | None) -> LoadedCell:
    """Return the cell with another identification file for one arm; None = unchanged."""
    if path is None:
        return loaded
    cell = loaded.cell
    arms = tuple(
        each.model_copy(update={"identified": str(path.resolve())}) if each.name == arm else each for each in cell.arm
    )
    return loaded.model_copy(update={"cell": cell.model_copy(update={"arm": arms})})


def axis_constants(arm: ArmConfig, identified: Identified | None) -> tuple[AxisConstants, ...]:
    """Return the constants of every axis.

    Parameters
    ----------
    arm : ArmConfig
    identified : Identified or None

    Raises
    ------
    InputError
        A constant contradicts the stated one, or is significantly negative; every such constant is named.
    """
    held = {} if identified is None else {axis.joint: axis for axis in identified.result.motion}
    source = "" if identified is None else identified.source
    found = [_axis(f"J{joint}", axis, held.get(joint), source) for joint, axis in enumerate(arm.axis, start=1)]
    wrong = [what for _, several in found for what in several]
    if wrong and identified is not None:
        raise InputError(
            f"{identified.where}: " + "; ".join(wrong) + "; correct the cell file (values at the joint: a rotor"
            " inertia is multiplied by the gear ratio squared), or identify again"
        )
    return tuple(constants for constants, _ in found)


def _axis(joint: str, stated: AxisConfig, held: AxisMotion | None, source: str) -> tuple[AxisConstants, list[str]]:
    """Return the constants of one axis, identified in motion (`held`) or else stated, and the contradictions."""
    motion = held or AxisMotion(0)
    known, notes, wrong = list[Known | None](), list[str](), list[str]()
    for name, unit, given, value, std in (
        (
            "rotor inertia",
            "kg m2",
            stated.rotor_inertia_kg_m2,
            motion.rotor_inertia_kg_m2,
            motion.rotor_inertia_std_kg_m2,
        ),
        ("Coulomb friction", "Nm", stated.coulomb_nm, motion.coulomb_nm, motion.coulomb_std_nm),
        ("viscous friction", "Nm s/rad", stated.viscous_nm_s_rad, motion.viscous_nm_s_rad, motion.viscous_std_nm_s_rad),
    ):
        known.append(None if given is None else Known(given.value, given.source))
        if held is None:
            continue
        half, number = half_width(std), f"{with_interval(value, std)} {unit}"
        instead = "the stated value is used" if given is not None else "the term is left out"
        if not math.isfinite(value):
            notes.append(f"{name} was not identified: {instead}")
        elif value < -(half if math.isfinite(half) else 0.0):
            wrong.append(f"{joint} {name} is negative ({number}), which is not possible")
        elif not half <= LARGEST_HALF * max(value, 0.0):
            notes.append(f"the uncertainty of {name} is too large ({number}): {instead}")
        else:
            known[-1] = Known(value, source, identified=True)
            if given is None:
                continue
            low, high = value - half, value + half
            if low > REFUSED_FACTOR * given.value or high < given.value / REFUSED_FACTOR:
                wrong.append(
                    f"{joint} {name}: {number} was identified, but {given.value:g} is stated; one of the two is wrong"
                )
            elif not given.value / SAID_FACTOR <= value <= SAID_FACTOR * given.value:
                notes.append(f"{name}: {number} was identified and is used; {given.value:g} is stated")
    rotor, coulomb, viscous = known
    breakaway, stribeck, lost = NAN, NAN, 0.0
    if coulomb is not None and coulomb.identified:  # one curve: its parts are not mixed with stated ones
        certain = math.isfinite(motion.breakaway_nm) and half_width(motion.breakaway_std_nm) <= motion.breakaway_nm
        if certain and motion.breakaway_nm > coulomb.value and motion.stribeck_rad_s > 0.0:
            breakaway, stribeck = motion.breakaway_nm, motion.stribeck_rad_s
        if motion.load_friction > half_width(motion.load_friction_std):
            lost = motion.load_friction
    return AxisConstants(rotor, coulomb, viscous, lost, breakaway, stribeck, tuple(notes)), wrong


def notes_of(notes: Sequence[Sequence[str]]) -> Iterator[tuple[str, str]]:
    """Return the notes of all axes as pairs of joints and text; equal texts of several joints are merged."""
    said: dict[str, list[str]] = {}
    for joint, axis in enumerate(notes, start=1):
        for note in axis:
            said.setdefault(note, []).append(f"J{joint}")
    return ((", ".join(joints), note) for note, joints in said.items())


def drawn_parameters(robot: Robot, arm: ArmConfig) -> Floats:
    """Return the parameters (10 N,) of the links from the robot model.

    Raises
    ------
    ConfigError
        Mass, centre of mass or inertia of a link is missing, or inertials = "ignore". No value is assumed to be zero.
    """
    if np.isinf(arm.link_std):
        raise ConfigError(
            f"arm '{arm.name}': inertials = \"ignore\" makes the links unknown, but feedforward needs them; give "
            'inertials = "prior:0.05" if the robot model holds plausible ones'
        )
    values = link_values(robot)
    missing = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(missing):
        raise ConfigError(
            f"robot '{robot.name}', link {missing[0] + 1}: mass, centre of mass or inertia is not given; feedforward "
            "needs every link's inertials in the robot model"
        )
    return values.ravel()


def corrected_parameters(robot: Robot, bare: Bare, gravity_m_s2: Floats) -> Floats | None:
    """Return the CAD parameters (10 N,) with the smallest change that reproduces the identified torque without a load.

    The sum of squares of the changes over mass (and over mass times link length, for first moments) is minimal. The
    inertia of each link about its own centre of mass is kept.

    Parameters
    ----------
    robot : Robot
    bare : Bare
        Base gravity parameters of a result.
    gravity_m_s2 : array of shape (3,)
        Gravity in the base frame of this arm.

    Returns
    -------
    array of shape (10 N,) or None
        None where the identification does not apply.
        That is another gravity or robot, missing values, or a link mass below `LEAST_SHARE` of the CAD mass.
    """
    if bare.robot != robot.name or not np.allclose(bare.gravity_m_s2, gravity_m_s2, atol=1e-6):
        return None
    combination, value = np.array(bare.combination, dtype=float), np.array(bare.value, dtype=float)
    if combination.ndim != 2 or not (np.isfinite(combination).all() and np.isfinite(value).all()):
        return None
    mean, std = link_prior(robot, 1.0, PER_LINK_AT_REST)
    # exact constraints: `identify.solve` weighs rows by their noise, and this arm has to hold its own torque exactly
    change = std * np.linalg.lstsq(combination * std, value - combination @ mean, rcond=1e-9)[0]
    moments = (mean + change).reshape(robot.axes, PER_LINK_AT_REST)
    if (moments[:, 0] < LEAST_SHARE * robot.mass_kg).any():
        return None
    return np.concatenate(
        [
            body_parameters(mass, moment / mass, robot.inertia_kg_m2[number])
            for number, (mass, moment) in enumerate(zip(moments[:, 0], moments[:, 1:], strict=True))
        ]
    )
