"""Largest credible load of an arm, from its rating, torque limits, mass and reach.

Inputs (cell file, `--known`) and results are compared with it: a value beyond it is in a wrong unit, or of another arm.
The bounds are wide (five times the rating): they detect factors of 1000.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from gateway.cell.config import ArmConfig
from gateway.cell.plausible import LARGEST_LEVER_M, LARGEST_LOAD_KG, OVERLOAD
from gateway.errors import ConfigError
from gateway.model.kinematics import STANDARD_GRAVITY_M_S2
from gateway.model.placeholders import mass_placeholder
from gateway.model.robot import Robot, reach_m


@dataclass(frozen=True, slots=True)
class LoadBounds:
    """Largest credible mass [kg] and distance of the centre of gravity [m], each with its source."""

    mass_kg: float = LARGEST_LOAD_KG
    mass_source: str = "more than the payload of any six-axis arm"
    lever_m: float = LARGEST_LEVER_M
    lever_source: str = "longer than the lever of any load"

    def violation(
        self,
        mass_kg: float,
        com_m: Sequence[float],
        margin_kg: float = 0.0,
        margin_m: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> str:
        """Return the violation of the bounds and the likely unit; empty if the load is credible or not known.

        Parameters
        ----------
        mass_kg : float
        com_m : sequence of 3 floats
            In the last link or the flange; empty = not known.
        margin_kg, margin_m : float, sequence of 3 floats
            Half widths of their intervals: a violation has to be significant. NaN counts as 0. A mass with a margin is
            measured, so that the likely unit is that of the torque.
        """
        if mass_kg - np.nan_to_num(margin_kg) > self.mass_kg:
            unit = "grams" if margin_kg == 0.0 else "torque of the joint mapped as taum instead of tau? torque in mNm"
            return (
                f"{mass_kg:.6g} kg is beyond {self.mass_kg:.4g} kg ({self.mass_source}): {unit}? that is"
                f" {mass_kg / 1000:.4g} kg"
            )
        nearest = np.maximum(np.abs(com_m) - np.nan_to_num(margin_m), 0.0) if len(com_m) else np.zeros(3)
        if float(np.linalg.norm(nearest)) > self.lever_m:
            far = math.hypot(*com_m)
            return (
                f"a centre of gravity {far:.4g} m off, beyond {self.lever_m:.4g} m: {self.lever_source};"
                f" millimetres? that is {far / 1000:.4g} m"
            )
        return ""


#: Bounds of a load if no arm is known.
NO_ARM: Final = LoadBounds()


def bounds_of(
    robot: Robot | None,
    torque_nm: float | None = None,
    rating: tuple[float, str] | None = None,
    *,
    trusts_masses: bool = True,
) -> LoadBounds:
    """Derive the bounds of an arm.

    The mass is bounded by five times the rated load, and by five times the load that the strongest joint holds with the
    arm stretched out. Without a rating it is also bounded by the mass of the links.
    Of one axis only the rating counts: the lever of a bench is lighter than the weight on it.

    Parameters
    ----------
    robot : Robot or None
    torque_nm : float, optional
        Largest torque limit of a joint.
    rating : tuple of float and str, optional
        Rated load [kg] and its source.
    trusts_masses : bool
        The masses of the links may be used.
    """
    masses = [(NO_ARM.mass_kg, NO_ARM.mass_source)]
    levers = [(NO_ARM.lever_m, NO_ARM.lever_source)]
    if robot is not None and robot.axes == 1:
        robot = None
    reach = 0.0 if robot is None else reach_m(robot)
    if rating is not None:
        masses.append((OVERLOAD * rating[0], f"{OVERLOAD:g} x {rating[1]} of {rating[0]:g} kg"))
    elif trusts_masses and robot is not None and np.isfinite(robot.mass_kg).all() and not mass_placeholder(robot):
        masses.append((float(robot.mass_kg.sum()), "the total mass of the links"))
    if reach > 0:
        levers.append((reach, "the reach of the arm"))
        if torque_nm is not None:
            held_kg = torque_nm / (math.hypot(*STANDARD_GRAVITY_M_S2) * reach)
            source = (
                f"{OVERLOAD:g} x what the largest torque limit, {torque_nm:g} Nm, holds at the reach of {reach:.3g} m"
            )
            masses.append((OVERLOAD * held_kg, source))
    return LoadBounds(*min(masses), *min(levers))


def load_bounds(robot: Robot | None, arm: ArmConfig | None, *, trusts_masses: bool = True) -> LoadBounds:
    """Derive the bounds of an arm from its robot model and its cell file; see `bounds_of`."""
    if arm is None:
        return bounds_of(robot, trusts_masses=trusts_masses)
    rating = None if arm.max_load_kg is None else (arm.max_load_kg, "max_load_kg")
    if arm.rated_load_kg is not None:
        rating = (arm.rated_load_kg.value, "rated_load_kg")
    return bounds_of(robot, _strongest_nm(arm), rating, trusts_masses=trusts_masses)


def _strongest_nm(arm: ArmConfig) -> float | None:
    """Return the largest torque limit of the joints; None if one of them is a placeholder."""
    if any(axis.torque_limit_is_assumed for axis in arm.axis):
        return None
    return max(axis.torque_limit_nm for axis in arm.axis)


def refuse_stated_loads(arm: ArmConfig, robot: Robot, where: str) -> None:
    """Refuse loads in the cell file beyond the bounds of the arm; the heaviest is compared with the rated load too.

    Raises
    ------
    ConfigError
        A load is beyond the bounds; the message names the key and the likely unit.
    """
    trusted, rated = math.isfinite(arm.link_std), arm.rated_load_kg
    stated = (
        ("rated_load_kg", None if rated is None else rated.value, arm.rated_load_com_m, None),
        ("max_load_kg", arm.max_load_kg, arm.max_load_com_m, None if rated is None else (rated.value, "rated_load_kg")),
    )
    for key, mass_kg, com_m, rating in stated:
        bounds = bounds_of(robot, _strongest_nm(arm), rating, trusts_masses=trusted)
        wrong = "" if mass_kg is None else bounds.violation(mass_kg, com_m or ())
        if wrong:
            raise ConfigError(f"{where}: arm '{arm.name}': {key}: {wrong}; correct the cell file")
