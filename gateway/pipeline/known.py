"""Known loads stated by the operator: mass, and centre of gravity in the frame of the last link or flange, or
unknown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gateway.cell.plausible import LARGEST_LEVER_M
from gateway.data.labels import BARE_LABEL
from gateway.errors import ConfigError, InputError
from gateway.model.load_bounds import LoadBounds
from gateway.model.robot import Robot
from gateway.result.result import Finding

OPTION = "--known"
FLANGE = "flange"
FORM = "LABEL=MASS,X,Y,Z (last link), LABEL=MASS,flange=X,Y,Z, or LABEL=MASS (centre not known)"

Load = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class KnownLoad:
    """Known load: mass [kg], centre of gravity [m] (None = not known), and its frame (None = last link).

    A frame that is not named is reported by `unnamed_frame`.
    """

    mass_kg: float
    com_m: tuple[float, float, float] | None = None
    frame: str | None = None


def parse_known(text: str) -> tuple[str, KnownLoad]:
    """Parse `LABEL=MASS`, `LABEL=MASS,X,Y,Z` or `LABEL=MASS,FRAME=X,Y,Z`.

    Raises
    ------
    InputError
        Wrong form, a negative mass, mass 0 without a centre, or a centre that can only be in millimetres.
    """
    label, equals, rest = text.partition("=")
    first, comma, after = rest.partition(",")
    frame, named, numbers = after.rpartition("=")
    try:
        values = [float(word) for word in (first, *(numbers.split(",") if comma else ()))]
    except ValueError:
        values = []
    label, frame = label.strip(), frame.strip()
    complete = equals and label and len(values) == (4 if comma else 1) and bool(named) == bool(frame)
    if not complete or not all(map(math.isfinite, values)) or values[0] < 0:
        raise InputError(f"{OPTION} {text}: expected {FORM} in kg and m, such as tool=12.5,flange=0,0,0.06")
    if label == BARE_LABEL:
        raise InputError(f"{OPTION} {text}: '{BARE_LABEL}' is the unloaded arm: name the load that is known")
    if not comma:
        if values[0] == 0:
            raise InputError(f"{OPTION} {text}: a load of 0 kg is not allowed; the unloaded arm is load 'none'")
        return label, KnownLoad(values[0])
    mass, *(x, y, z) = values
    far = max(map(abs, (x, y, z)))
    if far > LARGEST_LEVER_M:
        in_m = ",".join(f"{value / 1000:g}" for value in (x, y, z))
        raise InputError(
            f"{OPTION} {text}: a centre of gravity {far:g} m away is beyond {LARGEST_LEVER_M:g} m: these are"
            f" millimetres; write {label}={mass:g},{frame}{named}{in_m}"
        )
    return label, KnownLoad(mass, (x, y, z), frame or None)


def in_last_link(label: str, known: KnownLoad, robot: Robot | None, bounds: LoadBounds) -> Load | float:
    """Return (mass [kg], x, y, z [m] in the last link) of a known load; its mass alone without a centre.

    Raises
    ------
    ConfigError
        The centre is stated in the flange frame, but the flange is not known.
    InputError
        The frame is neither the last link nor the flange, or the load is beyond the capacity of the arm.
    """
    wrong = bounds.violation(known.mass_kg, known.com_m or ())
    if wrong:
        raise InputError(f"{OPTION} {label}: {wrong}")
    if known.com_m is None:
        return known.mass_kg
    last = "link_6" if robot is None else robot.last_link
    if known.frame in (None, last):
        return (known.mass_kg, *known.com_m)
    if known.frame != FLANGE:
        raise InputError(f"{OPTION} {label}: frame '{known.frame}' is not known: write {last}= or {FLANGE}= before X")
    if robot is None or robot.flange is None:
        raise ConfigError(
            f"{OPTION} {label}: the centre of gravity is stated in the flange frame, but the flange is not known:"
            " give --cell CELL with"
            f" flange_xyz_m and flange_rpy_rad, or state the centre as {last}=X,Y,Z"
        )
    x, y, z = (robot.flange[:3, :3] @ known.com_m + robot.flange[:3, 3]).tolist()
    return (known.mass_kg, x, y, z)


def with_and_without_centre(
    stated: Mapping[str, KnownLoad], robot: Robot | None, bounds: LoadBounds
) -> tuple[dict[str, Load], dict[str, float]]:
    """Return the known loads, and the masses of those with unknown centre; errors as in `in_last_link`."""
    loads = {label: in_last_link(label, known, robot, bounds) for label, known in stated.items()}
    known = {label: load for label, load in loads.items() if isinstance(load, tuple)}
    return known, {label: load for label, load in loads.items() if not isinstance(load, tuple)}


def unnamed_frame(label: str, known: KnownLoad, robot: Robot | None) -> Finding | None:
    """Report the assumed frame of a known load if none was named and flange and last link differ."""
    if (
        known.com_m is None
        or known.frame is not None
        or robot is None
        or robot.flange is None
        or np.allclose(robot.flange, np.eye(4))
    ):
        return None
    return Finding(
        "info",
        f"load {label}",
        f"{OPTION}: no frame was named, the centre of gravity was taken in {robot.last_link}",
        f"name it: {robot.last_link}=X,Y,Z or {FLANGE}=X,Y,Z",
    )
