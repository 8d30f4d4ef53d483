"""Detect placeholder values that exporters write to a URDF: equal efforts or masses, and impossible inertia."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import compress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.cell.plausible import LARGEST_TORQUE_NM
from gateway.model.robot import Robot, link_lengths_m, reach_m

#: Tolerance of the triangle inequality of principal moments, for rounding in a file.
_ROUNDED: Final = 1e-6
#: Radius of gyration of a body over its length: at most 0.6 for any rod; twice the length allows a wide link.
_GYRATION: Final = 2.0
#: Radius of gyration over the reach of the arm from which a link is not a part of this arm.
_GYRATION_OF_REACH: Final = 0.1


def model_remarks(robot: Robot) -> Iterator[str]:
    """Return the parts of a robot description that are not used, and a sentence for each kind of placeholder in it."""
    yield from robot.remarks
    for why, advice in (
        (effort_placeholder(robot), "take torque limits from the data sheet of the gears"),
        (mass_placeholder(robot), "correct the masses, or give --inertials ignore"),
        (inertia_placeholder(robot), "correct it, or trust no prior of the inertia in motion"),
    ):
        if why:
            yield f"{robot.source}: a placeholder: {why}; {advice}"


def effort_placeholder(robot: Robot) -> str:
    """Return the reason why the efforts of a URDF are not limits of this arm; empty if they may be."""
    stated = robot.effort_nm[np.isfinite(robot.effort_nm)].tolist()
    absurd = [effort for effort in stated if not 0.0 < effort <= LARGEST_TORQUE_NM]
    if absurd:
        return f"the URDF states an effort of {absurd[0]:g} Nm"
    if len(stated) > 2 and len(set(stated)) == 1:
        return f"the URDF states the same effort of {stated[0]:g} Nm on every axis"
    return ""


def mass_placeholder(robot: Robot) -> str:
    """Return the reason why the masses of a URDF are not those of this arm; empty if they may be."""
    stated = robot.mass_kg[np.isfinite(robot.mass_kg)]
    if len(stated) > 2 and np.ptp(stated) <= 1e-9 * stated[0]:
        return f"the URDF states the same mass of {stated[0]:g} kg for every link"
    return ""


def inertia_placeholder(robot: Robot) -> str:
    """Return a text that names the links with an impossible inertia; empty if there is none."""
    known = np.asarray(np.isfinite(robot.inertia_kg_m2).all(axis=(1, 2)))
    moments = np.linalg.eigvalsh(np.where(known.reshape(-1, 1, 1), robot.inertia_kg_m2, np.eye(3)))
    least, middle, largest = moments.T
    impossible = np.asarray(known & ((least <= 0.0) | (least + middle < (1.0 - _ROUNDED) * largest)))
    reasons: tuple[tuple[NDArray[np.bool_], str], ...] = (
        (impossible, "possible for a body (a principal moment is not positive, or above the sum of the others)"),
        (wide_inertia(robot) & ~impossible, "that of a link of this mass and size (too large a radius of gyration)"),
    )
    named = ((", ".join(compress(robot.link_names, links.tolist())), why) for links, why in reasons)
    return "; ".join(f"the inertia of {names} is not {why}" for names, why in named if names)


def wide_inertia(robot: Robot) -> NDArray[np.bool_]:
    """Links (N,) whose radius of gyration exceeds twice the link's length and a tenth of the arm's reach."""
    known = np.asarray(np.isfinite(robot.inertia_kg_m2).all(axis=(1, 2))) & (robot.mass_kg > 0.0)
    largest = np.linalg.eigvalsh(np.where(known.reshape(-1, 1, 1), robot.inertia_kg_m2, 0.0))[:, -1]
    gyration_m = np.sqrt(np.maximum(largest, 0.0) / np.where(known, robot.mass_kg, 1.0))
    return known & (gyration_m > np.maximum(_GYRATION * link_lengths_m(robot), _GYRATION_OF_REACH * reach_m(robot)))
