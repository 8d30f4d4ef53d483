"""Known loads stated by the operator: mass, and centre of gravity in the frame of the last link or flange, or
unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from gateway.cell.plausible import LARGEST_LEVER_M
from gateway.data.labels import BARE_LABEL
from gateway.errors import ConfigError, InputError
from gateway.identify.knowledge import WeighedLoad
from gateway.model.load_bounds import LoadBounds
from gateway.model.robot import Robot
from gateway.result.result import Finding

OPTION = "--known"
FLANGE = "flange"
FORM = (
    "LABEL=MASS,X,Y,Z (last link), LABEL=MASS,flange=X,Y,Z, or LABEL=MASS (centre not known), and +-STD behind the"
    " mass or the centre"
)
#: Largest standard deviation [m] of the centre of a load that was weighed: a larger one is in millimetres.
_LARGEST_COM_STD_M: Final = 0.2


@dataclass(frozen=True, slots=True)
class KnownLoad:
    """Known load as it is stated.

    Attributes
    ----------
    mass_kg : float
    com_m : centre of gravity; None = not known
    frame : of the centre; None = last link, and `unnamed_frame` reports it
    mass_std_kg, com_std_m : standard deviation of the mass, and of each coordinate of the centre; 0 = exact
    """

    mass_kg: float
    com_m: tuple[float, float, float] | None = None
    frame: str | None = None
    mass_std_kg: float = 0.0
    com_std_m: float = 0.0


def parse_known(text: str) -> tuple[str, KnownLoad]:
    """Parse `LABEL=MASS`, `LABEL=MASS,X,Y,Z` or `LABEL=MASS,FRAME=X,Y,Z`; `+-STD` may follow the mass and the centre.

    Raises
    ------
    InputError
        Wrong form, a negative mass, mass 0 without a centre, a standard deviation that leaves the mass open, or a
        length that can only be in millimetres.
    """
    label, equals, rest = text.replace("±", "+-").partition("=")
    first, comma, after = rest.partition(",")
    frame, named, numbers = after.rpartition("=")
    masses, mass_std = _numbers(first)
    centre, com_std = _numbers(numbers) if comma else ([], 0.0)
    label, frame = label.strip(), frame.strip()
    complete = equals and label and len(masses) == 1 and len(centre) == (3 if comma else 0)
    values = (*masses, *centre, mass_std, com_std)
    readable = complete and bool(named) == bool(frame) and all(map(math.isfinite, values))
    if not readable or min(*masses, mass_std, com_std) < 0:
        raise InputError(
            f"{OPTION} {text}: expected {FORM} in kg and m, such as tool=12.5+-0.01,flange=0,0,0.06+-0.002"
        )
    (mass,) = masses
    if label == BARE_LABEL:
        raise InputError(f"{OPTION} {text}: '{BARE_LABEL}' is the unloaded arm: name the load that is known")
    if mass_std > 0 and mass_std >= mass:
        raise InputError(
            f"{OPTION} {text}: a standard deviation of {mass_std:g} kg leaves a mass of {mass:g} kg open; weigh the"
            f" load, or leave {OPTION} out"
        )
    if not comma:
        if mass == 0:
            raise InputError(f"{OPTION} {text}: a load of 0 kg is not allowed; the unloaded arm is load 'none'")
        return label, KnownLoad(mass, mass_std_kg=mass_std)
    x, y, z = centre
    far = max(map(abs, centre))
    if far > LARGEST_LEVER_M:
        in_m = ",".join(f"{value / 1000:g}" for value in centre)
        raise InputError(
            f"{OPTION} {text}: a centre of gravity {far:g} m away is beyond {LARGEST_LEVER_M:g} m: these are"
            f" millimetres; write {label}={first},{frame}{named}{in_m}"
        )
    if com_std > _LARGEST_COM_STD_M:
        raise InputError(
            f"{OPTION} {text}: a standard deviation of {com_std:g} m of the centre is in millimetres: write"
            f" +-{com_std / 1000:g}"
        )
    return label, KnownLoad(mass, (x, y, z), frame or None, mass_std, com_std)


def _numbers(text: str) -> tuple[list[float], float]:
    """Return the numbers before `+-`, and the one behind it (0 without one); none where a word is not a number."""
    values, sign, std = text.partition("+-")
    try:
        return [float(word) for word in values.split(",")], float(std) if sign else 0.0
    except ValueError:
        return [], 0.0


def in_last_link(label: str, known: KnownLoad, robot: Robot | None, bounds: LoadBounds) -> WeighedLoad:
    """Return a known load with its centre of gravity in the last link.

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
    com_m, last = known.com_m, "link_6" if robot is None else robot.last_link
    if com_m is not None and known.frame not in (None, last):
        if known.frame != FLANGE:
            raise InputError(
                f"{OPTION} {label}: frame '{known.frame}' is not known: write {last}= or {FLANGE}= before X"
            )
        if robot is None or robot.flange is None:
            raise ConfigError(
                f"{OPTION} {label}: the centre of gravity is stated in the flange frame, but the flange is not known:"
                " give --cell CELL with"
                f" flange_xyz_m and flange_rpy_rad, or state the centre as {last}=X,Y,Z"
            )
        x, y, z = (robot.flange[:3, :3] @ com_m + robot.flange[:3, 3]).tolist()
        com_m = (x, y, z)
    return WeighedLoad(known.mass_kg, known.mass_std_kg, com_m, known.com_std_m)


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
