"""What is known of the drive train of every axis: identified in motion, else typed in the cell file.

The cell names a sealed result of this cell and arm (`identified` of `[[arm]]`). What it holds of friction and rotor
inertia is taken before what was typed, each with its file and date as source. What it does not hold, or not well
enough, falls back to what was typed, and that is said. A number that no typing error explains is refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gateway.cell.config import ArmConfig, AxisConfig, LoadedCell, SourcedNumber
from gateway.errors import InputError
from gateway.feedforward.load import other_origin, sourced
from gateway.model.robot import Robot
from gateway.result.drawn import Drawn
from gateway.result.interval import half_width
from gateway.result.numerals import with_interval
from gateway.result.result import AxisMotion, Result, read_result
from gateway.result.values import NAN

#: An identified constant that differs from the typed one by this factor is said; by `REFUSED_FACTOR`, with its whole
#: interval, it is refused: friction doubles from warm to cold, and a datasheet's rotor may lack gear and brake.
SAID_FACTOR, REFUSED_FACTOR = 2.0, 5.0
#: Half of the 95 % interval over the value: beyond this a constant is not known well enough to be used.
LARGEST_HALF = 1.0


@dataclass(frozen=True, slots=True)
class Known:
    """A constant of an axis and where it comes from: identified in motion, or typed."""

    value: float
    source: str
    identified: bool = False


@dataclass(frozen=True, slots=True)
class AxisConstants:
    """Drive train of one axis, at the gear output; None where neither identified nor typed.

    Attributes
    ----------
    rotor_kg_m2, coulomb_nm, viscous_nm_s_rad : Known or None
    load_friction : float
        Part of the torque at the gear output that is lost beside what the stated gear efficiency says; 0 = none
        identified.
    breakaway_nm, stribeck_rad_s : float
        Friction at the onset of motion, and the speed over which it falls to `coulomb_nm`; NaN where no Stribeck curve
        was identified.
    notes : tuple of str
        What was identified and is not used, or differs from what was typed.
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
    """A result whose friction and rotor inertia are used.

    Attributes
    ----------
    result : Result
    where : str
        Its file.
    """

    result: Result
    where: str

    @property
    def source(self) -> str:
        """File and date, as the pages show them."""
        return sourced("identified", self.result, self.where)


def read_identified(loaded: LoadedCell, arm: ArmConfig, robot: Robot) -> Identified | None:
    """What the cell says was identified of an arm; None where it names no file.

    Raises
    ------
    InputError
        The file cannot be read, was edited, is not sealed, is of another robot, cell or arm, or holds neither friction
        nor rotor inertia.
    """
    if arm.identified is None:
        return None
    path = loaded.path(arm.identified)
    result = read_result(path)
    if result.sha256 is None:
        raise InputError(f"{path}: has no checksum, so its origin is not verified; estimate again")
    about = result.data or Drawn()
    if about.cell is None or about.arm is None:
        raise InputError(f"{path}: does not say of which cell and arm it is: estimate its recording again with --cell")
    elsewhere = other_origin(result, loaded, arm, robot)
    if elsewhere:
        raise InputError(
            f"{path}: was identified on {elsewhere}: friction and rotors of another arm are no use here; correct"
            f" `identified` of arm '{arm.name}', or identify this one"
        )
    if not result.motion:
        raise InputError(
            f"{path}: holds neither friction nor rotor inertia, which need a motion: servo-gateway record CELL"
            " --moving, then estimate; or leave `identified` out"
        )
    return checked(result, str(path), len(arm.axis))


def checked(result: Result, where: str, axes: int) -> Identified:
    """Return the result as an identification of an arm of so many axes.

    Raises
    ------
    InputError
        A joint twice, or one that the arm does not have.
    """
    joints = [axis.joint for axis in result.motion]
    wrong = [joint for joint in joints if not 1 <= joint <= axes or joints.count(joint) > 1]
    if wrong:
        raise InputError(
            f"{where}: motion: joint {wrong[0]} is given twice, or the arm of {axes} axes does not have it"
        )
    return Identified(result, where)


def with_identified(loaded: LoadedCell, arm: str, path: Path | None) -> LoadedCell:
    """The same cell with another file of what was identified of one arm; None = as it is."""
    if path is None:
        return loaded
    cell = loaded.cell
    arms = tuple(
        each.model_copy(update={"identified": str(path.resolve())}) if each.name == arm else each for each in cell.arm
    )
    return loaded.model_copy(update={"cell": cell.model_copy(update={"arm": arms})})


def axis_constants(arm: ArmConfig, identified: Identified | None) -> tuple[AxisConstants, ...]:
    """Constants of every axis.

    Parameters
    ----------
    arm : ArmConfig
    identified : Identified or None

    Raises
    ------
    InputError
        A constant contradicts the typed one, or is negative beyond its interval; every such constant is named.
    """
    held = {} if identified is None else {axis.joint: axis for axis in identified.result.motion}
    found = [
        _Axis(axis, held.get(joint), identified).constants(f"J{joint}") for joint, axis in enumerate(arm.axis, start=1)
    ]
    wrong = [what for _, several in found for what in several]
    if wrong and identified is not None:
        raise InputError(
            f"{identified.where}: " + "; ".join(wrong) + "; correct the cell file (at the joint, that is times the gear"
            " ratio squared for a rotor), or identify again"
        )
    return tuple(constants for constants, _ in found)


class _Axis:
    """One axis: what was typed, what was identified, and the source that the latter gets."""

    def __init__(self, typed: AxisConfig, held: AxisMotion | None, identified: Identified | None) -> None:
        self._typed, self._identified = typed, held
        self._source = "" if identified is None else identified.source
        self._notes: list[str] = []
        self._wrong: list[str] = []

    def constants(self, joint: str) -> tuple[AxisConstants, list[str]]:
        """What is used of an axis, and what contradicts."""
        typed, held = self._typed, self._identified or AxisMotion(0)
        rotor = self._one(
            "rotor inertia",
            typed.rotor_inertia_kg_m2,
            (held.rotor_inertia_kg_m2, held.rotor_inertia_std_kg_m2, "kg m2"),
        )
        coulomb = self._one("Coulomb friction", typed.coulomb_nm, (held.coulomb_nm, held.coulomb_std_nm, "Nm"))
        viscous = self._one(
            "viscous friction",
            typed.viscous_nm_s_rad,
            (held.viscous_nm_s_rad, held.viscous_std_nm_s_rad, "Nm s/rad"),
        )
        breakaway, stribeck, lost = NAN, NAN, 0.0
        if coulomb is not None and coulomb.identified:  # one curve: its parts are not mixed with typed ones
            breakaway, stribeck = self._onset(coulomb.value, held)
            lost = self._lost(held)
        constants = AxisConstants(rotor, coulomb, viscous, lost, breakaway, stribeck, tuple(self._notes))
        return constants, [f"{joint} {what}" for what in self._wrong]

    def _one(self, name: str, typed: SourcedNumber | None, said: tuple[float, float, str]) -> Known | None:
        fallback = None if typed is None else Known(typed.value, typed.source)
        value, std, unit = said
        if self._identified is None:
            return fallback
        half = half_width(std)
        number = f"{with_interval(value, std)} {unit}"
        instead = "the typed one is used" if typed is not None else "it is left out"
        if not math.isfinite(value):
            self._notes.append(f"{name} was not identified: {instead}")
            return fallback
        if value < -(half if math.isfinite(half) else 0.0):
            self._wrong.append(f"{name} is negative ({number}), which no axis has")
            return fallback
        if not half <= LARGEST_HALF * max(value, 0.0):
            self._notes.append(f"{name} is not known well enough ({number}): {instead}")
            return fallback
        if typed is not None:
            self._compare(name, typed.value, (value, half), number)
        return Known(value, self._source, identified=True)

    def _compare(self, name: str, typed: float, said: tuple[float, float], number: str) -> None:
        value, half = said
        low, high = value - half, value + half
        if low > REFUSED_FACTOR * typed or high < typed / REFUSED_FACTOR:
            self._wrong.append(f"{name}: {number} was identified and {typed:g} typed, one of the two is wrong")
        elif not typed / SAID_FACTOR <= value <= SAID_FACTOR * typed:
            self._notes.append(f"{name}: {number} was identified and is used, {typed:g} is typed")

    def _onset(self, coulomb_nm: float, held: AxisMotion) -> tuple[float, float]:
        """Breakaway torque and Stribeck speed, NaN where they are not known."""
        known = math.isfinite(held.breakaway_nm) and half_width(held.breakaway_std_nm) <= held.breakaway_nm
        if not known or held.breakaway_nm <= coulomb_nm or not held.stribeck_rad_s > 0.0:
            return NAN, NAN
        return held.breakaway_nm, held.stribeck_rad_s

    def _lost(self, held: AxisMotion) -> float:
        """Load friction beyond its own standard error, else 0."""
        half = half_width(held.load_friction_std)
        return held.load_friction if math.isfinite(held.load_friction) and held.load_friction > half else 0.0


def notes_of(notes: Sequence[Sequence[str]]) -> Iterator[tuple[str, str]]:
    """Joints and what has to be said of them, from the notes of every axis; the same words of several joints once."""
    said: dict[str, list[str]] = {}
    for joint, axis in enumerate(notes, start=1):
        for note in axis:
            said.setdefault(note, []).append(f"J{joint}")
    return ((", ".join(joints), note) for note, joints in said.items())
