"""Detect placeholder values that exporters write to a URDF: equal efforts or masses, and impossible inertia."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from gateway.cell.plausible import LARGEST_TORQUE_NM
from gateway.model.robot import Robot

#: Tolerance of the triangle inequality of principal moments, for rounding in a file.
_ROUNDED: Final = 1e-6


def placeholders(robot: Robot) -> Iterator[str]:
    """Return one sentence with a corrective action for each kind of placeholder in a robot model."""
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
    names: list[str] = []
    for name, tensor in zip(robot.link_names, robot.inertia_kg_m2, strict=True):
        if np.isfinite(tensor).all():
            least, middle, largest = np.linalg.eigvalsh(tensor).tolist()
            if least <= 0.0 or least + middle < (1.0 - _ROUNDED) * largest:
                names.append(name)
    if not names:
        return ""
    return (
        f"the inertia of {', '.join(names)} is not possible for a body (a principal moment is not positive, or above"
        " the sum of"
        " the others)"
    )
