"""Goal of a measurement with `--until`: parsed from text, compared with the present estimate, reported as text.

Pure functions of the present estimate: how far a load is known, what further poses would bring, which pose to measure
next, and when to stop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.errors import InputError
from gateway.estimate.expected_information import ExpectedInformation, Stock
from gateway.identify.load_estimate import LoadEstimate
from gateway.result.numerals import PLUS_MINUS, SAID, half_width
from gateway.result.result import Finding

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

OPTION: Final = "--until"
#: Quantities of a goal: their units and factors; the first is the SI unit.
UNITS: Final = {"mass": {"kg": 1.0, "g": 1e-3, "%": 1e-2}, "com": {"m": 1.0, "mm": 1e-3}}
_EXAMPLE: Final = "such as mass=0.5%,com=3mm, mass=0.2kg or com=0.003m"
#: Largest half widths that are accepted: half of the mass, one metre of the centre of gravity.
_MOST: Final = {"%": 50.0, "com": 1.0}
#: Smallest and largest number of poses of a load: the noise has to be measured, and the duration is limited.
LEAST_POSES: Final = 4
MOST_POSES: Final = 40
#: Smallest number of samples per approach direction: fewer do not determine their scatter.
LEAST_SAMPLES: Final = 20
#: If the goal is not reachable: stop at this ratio to the half width expected after `MOST_POSES` poses.
NEAR: Final = 1.25
#: Numbers of samples that are compared.
_COUNTS: Final = 5
#: Number of candidates in the prediction of further poses.
_AHEAD: Final = 80
#: The first further poses are predicted one by one, later ones in blocks of this size.
_SINGLY: Final = 6
_TOGETHER: Final = 6
PARTS: Final = ("mass", "x", "y", "z")
_KNOWN_LOAD: Final = "mount a load of known mass and estimate with --known LABEL=MASS,X,Y,Z"


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
    numbers: dict[str, tuple[float, str]] = {}
    for part in text.split(","):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not equals or name not in UNITS:
            raise InputError(f"{OPTION} {text}: '{part.strip()}' must be mass=.. or com=..; {_EXAMPLE}")
        if name in numbers:
            raise InputError(f"{OPTION} {text}: {name} is given twice; give each once, {_EXAMPLE}")
        units, choice = UNITS[name], ", ".join(UNITS[name])
        unit = max((each for each in units if value.endswith(each)), key=len, default="")
        try:
            number = float(value[: len(value) - len(unit)])
        except ValueError:
            what = f"'{value}' of {name} is not a number with a unit ({choice})"
            raise InputError(f"{OPTION} {text}: {what}; {_EXAMPLE}") from None
        if not unit:
            raise InputError(f"{OPTION} {text}: {name}={value} lacks its unit ({choice}); {_EXAMPLE}")
        if not (math.isfinite(number) and number > 0):
            raise InputError(f"{OPTION} {text}: {name}={value}: a half width must be positive; {_EXAMPLE}")
        if number * units[unit] > (_MOST["%"] / 100.0 if unit == "%" else _MOST.get(name, math.inf)):
            what = f"{name}={value} is too large to be a goal; give a smaller half width"
            raise InputError(f"{OPTION} {text}: {what}, {_EXAMPLE}")
        numbers[name] = number * units[unit], unit
    mass, unit = numbers.get("mass", (math.inf, "kg"))
    share = unit == "%"
    return Goal(
        mass_kg=math.inf if share else mass,
        mass_share=mass if share else math.inf,
        com_m=numbers.get("com", (math.inf, "m"))[0],
    )


def half_widths(load: LoadEstimate | None) -> Floats:
    """Return the half widths (4,) of the 95 % intervals of mass [kg] and centre of gravity [m]; infinite if unknown."""
    if load is None:
        return np.full(4, math.inf)
    std = np.concatenate([[load.mass_std_kg], load.com_std_m])
    return np.where(np.isfinite(std), half_width(1.0) * std, math.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Narrowness:
    """Half widths of the 95 % intervals and their goal; arrays (4,) of mass [kg] and centre of gravity [m].

    Attributes
    ----------
    half : present half widths
    goal : requested half widths, infinite without a request
    limit : expected half widths after `MOST_POSES` poses
    poses : poses of this load measured so far
    ahead : further poses that are expected to be needed
    """

    half: Floats
    goal: Floats
    limit: Floats
    poses: int
    ahead: int

    @property
    def reached(self) -> Bools:
        """Mask (4,) of the half widths that have reached their goal."""
        return self.half <= self.goal

    @property
    def hopeless(self) -> Bools:
        """Mask (4,) of the half widths that no number of poses brings to their goal."""
        return ~self.reached & (self.limit > self.goal)

    @property
    def aim(self) -> Floats:
        """Half widths (4,) to measure for: the goal, or a value near the limit where the goal is not reachable."""
        return np.where(self.limit > self.goal, NEAR * self.limit, self.goal)

    @property
    def done(self) -> bool:
        """True if no further pose is worth measuring."""
        if self.poses < LEAST_POSES:
            return False
        return self.poses >= MOST_POSES or bool((self.half <= self.aim).all())


def judge(
    known: ExpectedInformation, half: Floats, goal: Floats, poses: int, regressor: Floats, most_samples: int
) -> Narrowness:
    """Compare a load's half widths with the goal, and predict those after further poses.

    Parameters
    ----------
    known : ExpectedInformation
    half : array of shape (4,)
        Estimated half widths.
    goal : array of shape (4,)
    poses : int
        Number of poses of this load so far.
    regressor : array of shape (n, N, 4 N)
        Gravity regressors of candidate postures.
    most_samples : int
        Largest number of samples per approach direction: that of the cell file.
    """
    requested = np.isfinite(goal)
    if not requested.any() or (poses >= LEAST_POSES and (half <= goal).all()):
        return Narrowness(half, goal, np.zeros(4), poses, 0)
    some = regressor[:_AHEAD]
    done = poses
    while done < MOST_POSES and (done < LEAST_POSES or (half_width(1.0) * known.std > goal).any()):
        after = known.std_after(some, most_samples)
        count = min(1 if done - poses < _SINGLY else _TOGETHER, MOST_POSES - done)
        known = known.with_poses(some[int(np.argmin(_distance(after, goal)))], most_samples, count)
        done += count
    return Narrowness(half, goal, np.where(requested, half_width(1.0) * known.std, 0.0), poses, done - poses)


def best_first(
    known: ExpectedInformation,
    verdict: Narrowness,
    regressor: Floats,
    seconds: Floats,
    period_s: float,
    most_samples: int,
) -> tuple[NDArray[np.int_], int]:
    """Sort the candidates by decreasing information per second; also return the samples per approach direction.

    Parameters
    ----------
    known : ExpectedInformation
    verdict : Narrowness
    regressor : array of shape (n, N, 4 N)
        Gravity regressors of the candidates.
    seconds : array of shape (n,)
        Time of the path, both approaches and settling, without sampling; infinite = excluded.
    period_s : float
        SYNC period.
    most_samples : int
        As `judge`.

    Returns
    -------
    rows : int array of shape (k,)
        Indices of the candidates that are not excluded.
    samples : int
    """
    before = _distance(known.std[None], verdict.aim)
    least = min(LEAST_SAMPLES, most_samples)
    counts = np.unique(np.geomspace(least, most_samples, _COUNTS).round().astype(int)).tolist()
    rates = []
    for samples in counts:
        gain = before - _distance(known.std_after(regressor, samples), verdict.aim)
        rates.append(np.where(np.isfinite(seconds), gain / (seconds + 2.0 * samples * period_s), -np.inf))
    best = int(np.argmax([rate.max(initial=-np.inf) for rate in rates]))
    order = np.argsort(-rates[best], kind="stable")
    return order[np.isfinite(seconds[order])], counts[best]


def _distance(std: Floats, aim: Floats) -> Floats:
    """Return the distance of standard deviations (n, 4) to the aimed half widths (4,): sum of logarithms."""
    requested = np.isfinite(aim) & (aim > 0)
    ratio = half_width(1.0) * std[:, requested] / aim[requested]
    return np.log(np.maximum(ratio, 1.0)).sum(axis=1)


# -- text --------------------------------------------------------------------------------------------------------------


def narrowed(verdict: Narrowness, ends: bool) -> str:
    """Return one line after a pose: present half widths, and the expected number of further poses."""
    if ends:
        more = "the measurement ends"
    elif verdict.hopeless.any():
        more = "further poses would still help"
    else:
        more = f"about {verdict.ahead} more poses expected"
    return f"{verdict.poses} poses: {_widths(verdict.half)}; {more}"


def ended(stock: Stock, verdict: Narrowness, label: str) -> str:
    """Return the reason of the end: goal reached, or goal not reachable and what would help."""
    after = f"after {verdict.poses} poses"
    if stock.refused is not None:
        check = "check whether it slips or touches something, and measure again"
        return f"load {label} is refused {after}: {stock.refused}; {check}"
    if verdict.reached.all():
        return f"load {label} has reached the requested uncertainty {after}: {_widths(verdict.half)} ({SAID})"
    missed = ", ".join(
        f"{PARTS[k]} {_width(k, verdict.goal[k])} (it is {_width(k, verdict.half[k])}, "
        f"expected after {MOST_POSES} poses: {_width(k, verdict.limit[k])})"
        for k in np.flatnonzero(~verdict.reached).tolist()
    )
    return f"no further pose brings load {label} to {missed}; {what_helps(stock.information, verdict)}"


def end_of(stock: Stock, verdict: Narrowness, label: str) -> Finding:
    """Return the reason of the end as a finding of the result."""
    reached = bool(verdict.reached.all()) and stock.refused is None
    what, _, advice = ended(stock, verdict, label).partition("; ")
    return Finding("info" if reached else "warn", f"load {label}", what, advice)


def what_helps(known: ExpectedInformation, verdict: Narrowness) -> str:
    """Return the measures that would bring a load to its goal where further poses do not."""
    short = ~verdict.reached
    now = half_width(1.0) * known.std[short]
    constants = half_width(1.0) * known.std_given(known.gain)[short]
    links = half_width(1.0) * known.std_given(np.arange(len(known.links)))[short]
    goal = verdict.goal[short]
    if (constants <= goal).all() or (constants / now).max() < (links / now).max():
        return f"possible measures: better torque constants (std_percent in the cell file), or {_KNOWN_LOAD}"
    if (links <= goal).all() or (links / now).max() < 1.0:
        return "possible measures: more poses of the unloaded arm, so that the uncertainty of its own weight decreases"
    return f"possible measures: a slower approach (approach_speed_rad_s) or more samples, and {_KNOWN_LOAD}"


def _widths(half: Floats) -> str:
    mass = _width(0, half[0]) if math.isfinite(half[0]) else "not known"
    return f"mass {mass}, centre of gravity {' '.join(_width(k, half[k], '') for k in (1, 2, 3))} mm"


def _width(part: int, half: float, unit: str = " mm") -> str:
    """Return the half width of a quantity as text: mass in kg, coordinate in mm."""
    if not math.isfinite(half):
        return f"{PLUS_MINUS}?"
    return f"{PLUS_MINUS}{half:.2g} kg" if part == 0 else f"{PLUS_MINUS}{1000 * half:.2g}{unit}"
