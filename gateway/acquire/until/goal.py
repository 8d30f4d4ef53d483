"""Goal of `--until`: half widths of 95 % intervals, parsed from text and compared."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.errors import InputError
from gateway.identify.load_estimate import LoadEstimate
from gateway.result.interval import PLUS_MINUS, half_width

Floats = NDArray[np.float64]

OPTION: Final = "--until"
#: Quantities of a goal: their units and factors; the first is the SI unit.
UNITS: Final = {"mass": {"kg": 1.0, "g": 1e-3, "%": 1e-2}, "com": {"m": 1.0, "mm": 1e-3}}
_EXAMPLE: Final = "such as mass=0.5%,com=3mm, mass=0.2kg or com=0.003m"
#: Largest half widths that are accepted: half of the mass, one metre of the centre of gravity.
_MOST: Final = {"%": 50.0, "com": 1.0}


@dataclass(frozen=True, slots=True)
class Goal:
    """Requested half widths of the 95 % intervals of a load.

    Attributes
    ----------
    mass_kg : float
        Infinite if not requested.
    mass_share : float
        Share of the mass, instead of kg; infinite if not requested.
    com_m : float
        Of each coordinate of the centre of gravity; infinite if not requested.
    """

    mass_kg: float = math.inf
    mass_share: float = math.inf
    com_m: float = math.inf

    def half_widths(self, mass_kg: float) -> Floats:
        """Half widths (4,) of mass [kg] and centre of gravity [m] for a load of this mass."""
        share_kg = self.mass_share * abs(mass_kg) if math.isfinite(self.mass_share) else math.inf
        return np.array([min(self.mass_kg, share_kg), self.com_m, self.com_m, self.com_m])

    def __str__(self) -> str:
        """Return the goal as text for the operator."""
        mass = f"{PLUS_MINUS}{self.mass_kg:g} kg" if math.isfinite(self.mass_kg) else ""
        mass = f"{PLUS_MINUS}{100 * self.mass_share:g} %" if math.isfinite(self.mass_share) else mass
        com = f"{PLUS_MINUS}{1000 * self.com_m:g} mm" if math.isfinite(self.com_m) else ""
        return ", ".join(f"{name} {text}" for name, text in (("mass", mass), ("centre of gravity", com)) if text)


def parse_until(text: str) -> Goal:
    """Parse a text such as `mass=0.5%,com=3mm` to a goal.

    Raises
    ------
    InputError
        Unknown or duplicate quantity, or a number without unit, not positive or too large.
    """
    found: dict[str, tuple[float, str]] = {}
    for part in text.split(","):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not equals or name not in UNITS:
            raise InputError(f"{OPTION} {text}: '{part.strip()}' must be mass=.. or com=..; {_EXAMPLE}")
        if name in found:
            raise InputError(f"{OPTION} {text}: {name} is given twice; give each once, {_EXAMPLE}")
        found[name] = _number(text, name, value)
    mass, unit = found.get("mass", (math.inf, "kg"))
    share = unit == "%"
    return Goal(
        mass_kg=math.inf if share else mass,
        mass_share=mass if share else math.inf,
        com_m=found.get("com", (math.inf, "m"))[0],
    )


def _number(text: str, name: str, value: str) -> tuple[float, str]:
    """Return the number in SI units, and the unit that was typed."""
    units = UNITS[name]
    unit = max((each for each in units if value.endswith(each)), key=len, default="")
    choice = ", ".join(units)
    try:
        number = float(value[: len(value) - len(unit)])
    except ValueError:
        raise InputError(
            f"{OPTION} {text}: '{value}' of {name} is not a number with a unit ({choice}); {_EXAMPLE}"
        ) from None
    if not unit:
        raise InputError(f"{OPTION} {text}: {name}={value} lacks its unit ({choice}); {_EXAMPLE}")
    if not (math.isfinite(number) and number > 0):
        raise InputError(f"{OPTION} {text}: {name}={value}: a half width must be positive; {_EXAMPLE}")
    most = _MOST["%"] / 100.0 if unit == "%" else _MOST.get(name, math.inf)
    if number * units[unit] > most:
        raise InputError(
            f"{OPTION} {text}: {name}={value} is too large to be a goal; give a smaller half width, {_EXAMPLE}"
        )
    return number * units[unit], unit


def half_widths(load: LoadEstimate | None) -> Floats:
    """Return the half widths (4,) of the 95 % intervals of mass [kg] and centre of gravity [m]; infinite if unknown."""
    if load is None:
        return np.full(4, math.inf)
    std = np.concatenate([[load.mass_std_kg], load.com_std_m])
    return np.where(np.isfinite(std), half_width(1.0) * std, math.inf)
