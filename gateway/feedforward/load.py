"""Load in the feedforward: the identified load, or the largest load that the arm may carry.

Measurements at rest identify mass and centre of gravity, not the load's own inertia (JP3698770B2 neglects it);
measurements in motion do. Where the result does not hold the complete inertia, that of a solid cube of
`CUBE_DENSITY_KG_M3` is assumed and reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.cell.config import ArmConfig, LoadedCell
from gateway.errors import ConfigError, DataUnusable, InputError
from gateway.identify.links import body_parameters
from gateway.model.load_bounds import NO_ARM, LoadBounds
from gateway.model.robot import Robot
from gateway.result.drawn import Drawn
from gateway.result.inertia import has_a_body, tensor_of
from gateway.result.result import LoadResult, Result

Floats = NDArray[np.float64]

#: Between a hollow aluminium gripper and solid steel, assumed.
CUBE_DENSITY_KG_M3 = 3000.0
FRAME = "link_6"


@dataclass(frozen=True, slots=True, eq=False)
class FeedLoad:
    """Load as a rigid body on the last link.

    Attributes
    ----------
    label : str
    mass_kg : float
    com_m : array of shape (3,)
        In the last link.
    inertia_kg_m2 : array of shape (3, 3)
        About the centre of gravity, axes of the last link.
    source, inertia_source : str
        Where mass and centre of gravity, and the inertia, come from.
    mass_std_kg : float
        NaN where it is not known.
    """

    label: str
    mass_kg: float
    com_m: Floats
    inertia_kg_m2: Floats
    source: str
    inertia_source: str
    mass_std_kg: float = float("nan")

    @property
    def parameters(self) -> Floats:
        """Inertial parameters [m, hx, hy, hz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz] (10,) about the origin of the last link."""
        return body_parameters(self.mass_kg, self.com_m, self.inertia_kg_m2)

    def scaled(self, factor: float) -> FeedLoad:
        """Return the same body with its mass multiplied by `factor`."""
        inertia = factor * self.inertia_kg_m2
        return replace(self, mass_kg=factor * self.mass_kg, inertia_kg_m2=inertia, source=f"{factor:g} x {self.source}")


def cube_inertia(mass_kg: float) -> Floats:
    """Return the inertia (3, 3) [kg m2] of a solid cube about its centre: m a^2 / 6 with m = density a^3."""
    side_m = (mass_kg / CUBE_DENSITY_KG_M3) ** (1.0 / 3.0)
    return np.eye(3) * (mass_kg * side_m**2 / 6.0)


def assumed_load(label: str, mass_kg: float, com_m: Floats, source: str) -> FeedLoad:
    """Return a load with known mass and centre of gravity and an assumed shape."""
    about = f"assumed: solid cube of {CUBE_DENSITY_KG_M3:g} kg/m3"
    return FeedLoad(label, mass_kg, np.asarray(com_m, dtype=float), cube_inertia(mass_kg), source, about)


def identified_load(result: Result, label: str | None, where: str, bounds: LoadBounds = NO_ARM) -> FeedLoad:
    """Return the identified load of a result.

    Parameters
    ----------
    result : Result
    label : str or None
        Label of the load, if the result holds several.
    where : str
        Name of the file, for messages.
    bounds : LoadBounds
        Bounds of the arm that carries the load.

    Raises
    ------
    ConfigError
        No such label, or several loads and no label.
    DataUnusable
        No load was identified, it was refused, it exceeds the capacity of the arm, or mass or centre of gravity is
        missing.
    InputError
        The load is given in another frame than link 6.
    """
    if not result.loads:
        raise DataUnusable(f"{where}: holds no identified load; estimate one first: servo-gateway estimate DATA --json")
    known = ", ".join(load.label for load in result.loads)
    named = [load for load in result.loads if label in (None, load.label)]
    if not named:
        raise ConfigError(f"{where}: holds no load '{label}'; it holds {known}")
    if label is None and len(result.loads) > 1:
        raise ConfigError(f"{where}: holds several loads ({known}); name one with --load")
    chosen = named[0]
    if chosen.frame != FRAME:
        raise InputError(f"{where}: load '{chosen.label}' is given in frame '{chosen.frame}', {FRAME} is needed")
    if chosen.refused:
        raise DataUnusable(f"{where}: load '{chosen.label}' was refused and cannot be used: {chosen.refused}")
    com = np.array(chosen.com_m or (np.nan,) * 3)
    if not np.isfinite([chosen.mass_kg, *com]).all() or chosen.mass_kg <= 0:
        missing = ", ".join(chosen.unidentifiable) or "mass or centre of gravity"
        raise DataUnusable(
            f"{where}: load '{chosen.label}' is not fully identified ({missing}); measure the poses that the result "
            "names under `next`"
        )
    wrong = bounds.violation(chosen.mass_kg, com.tolist())
    if wrong:
        raise DataUnusable(f"{where}: load '{chosen.label}': {wrong}")
    source = f"{where}, load {chosen.label}"
    load = assumed_load(chosen.label, chosen.mass_kg, com, source)
    return replace(
        _with_own_inertia(load, chosen, sourced("identified", result, where)), mass_std_kg=chosen.mass_std_kg
    )


def _with_own_inertia(load: FeedLoad, chosen: LoadResult, source: str) -> FeedLoad:
    """Return the load with the identified inertia, if it is complete and physically possible."""
    if chosen.inertia_kg_m2 is None:
        return load
    if not np.isfinite(chosen.inertia_kg_m2).all():
        return replace(load, inertia_source=f"{load.inertia_source}, because the inertia was only partly identified")
    inertia = tensor_of(chosen.inertia_kg_m2)
    if not has_a_body(inertia):
        return replace(load, inertia_source=f"{load.inertia_source}, because that in {source} is physically impossible")
    return replace(load, inertia_kg_m2=inertia, inertia_source=source)


def sourced(what: str, result: Result, where: str) -> str:
    """Return a source text such as `identified, result.json of 2026-11-22 20:31 UTC`."""
    created = None if result.data is None else result.data.created
    return f"{what}, {Path(where).name}" + (f" of {created}" if created else "")


def check_origin(result: Result, loaded: LoadedCell, arm: ArmConfig, robot: Robot, where: str) -> None:
    """Refuse a result of another robot, cell or arm.

    Raises
    ------
    InputError
        The result is of another robot, cell or arm; the message names it.
    """
    elsewhere = other_origin(result, loaded, arm, robot)
    if elsewhere:
        raise InputError(
            f"{where}: was identified on {elsewhere}: the load of another arm is in another frame; identify the load"
            " on this arm"
        )


def other_origin(result: Result, loaded: LoadedCell, arm: ArmConfig, robot: Robot) -> str:
    """Return a text such as "cell 'a', not on 'b'" if a result is of another robot, cell or arm; else an empty text."""
    about = result.data or Drawn()
    for what, have, want in (
        ("robot", result.robot, robot.name),
        ("cell", about.cell, loaded.cell.name),
        ("arm", about.arm, arm.name),
    ):
        if have is not None and have != want:
            return f"{what} '{have}', not on '{want}'"
    return ""


def rated_load(arm: ArmConfig, robot: Robot) -> FeedLoad:
    """Return the largest load that the arm may carry: controllers assume it when no load is entered.

    Raises
    ------
    ConfigError
        The cell file states neither rated_load_kg nor max_load_kg.
    """
    flange = np.zeros(3) if robot.flange is None else robot.flange[:3, 3]
    if arm.rated_load_kg is not None:
        com = flange if arm.rated_load_com_m is None else np.array(arm.rated_load_com_m)
        return assumed_load("maximum", arm.rated_load_kg.value, com, f"rated load, {arm.rated_load_kg.source}")
    if arm.max_load_kg is not None:
        com = flange if arm.max_load_com_m is None else np.array(arm.max_load_com_m)
        return assumed_load("maximum", arm.max_load_kg, com, "max_load_kg of the cell file")
    raise ConfigError(
        f"arm '{arm.name}': rated_load_kg is missing in the cell file: the load that is assumed when none is entered; "
        'give rated_load_kg = { value = .., source = "datasheet" } and rated_load_com_m'
    )
