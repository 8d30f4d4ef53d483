"""Messages of a measurement with `--until`: the uncertainty after each pose, and the reason of the end."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.acquire.until.choice import MOST_POSES, Narrowness
from gateway.acquire.until.search import NextStep
from gateway.estimate.expected_information import ExpectedInformation
from gateway.result.interval import PLUS_MINUS, SAID, half_width
from gateway.result.result import Finding

Floats = NDArray[np.float64]

PARTS: Final = ("mass", "x", "y", "z")
_KNOWN_LOAD: Final = "mount a load of known mass and estimate with --known LABEL=MASS,X,Y,Z"


def narrowed(decision: NextStep) -> str:
    """Return one line after a pose: present half widths, and the expected number of further poses."""
    verdict = decision.verdict
    if verdict.done or decision.plan is None:
        more = "the measurement ends"
    else:
        more = (
            f"about {verdict.ahead} more poses expected"
            if not verdict.hopeless.any()
            else "further poses would still help"
        )
    return f"{verdict.poses} poses: {_widths(verdict.half)}; {more}"


def ended(decision: NextStep, label: str) -> str:
    """Return the reason of the end: goal reached, or goal not reachable and what would help."""
    verdict, stock = decision.verdict, decision.stock
    after = f"after {verdict.poses} poses"
    if stock.refused is not None:
        check = "check whether it slips or touches something, and measure again"
        return f"load {label} is refused {after}: {stock.refused}; {check}"
    if verdict.reached.all():
        return f"load {label} has reached the requested uncertainty {after}: {_widths(verdict.half)} ({SAID})"
    short = np.flatnonzero(~verdict.reached).tolist()
    missed = ", ".join(
        f"{PARTS[k]} {_width(k, verdict.goal[k])} (it is {_width(k, verdict.half[k])}, "
        f"expected after {MOST_POSES} poses: {_width(k, verdict.limit[k])})"
        for k in short
    )
    return f"no further pose brings load {label} to {missed}; {what_helps(stock.information, verdict)}"


def end_of(decision: NextStep, label: str) -> Finding:
    """Return the reason of the end as a finding of the result."""
    reached = bool(decision.verdict.reached.all()) and decision.stock.refused is None
    said, _, helps = ended(decision, label).partition("; ")
    return Finding("info" if reached else "warn", f"load {label}", said, helps)


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
    known = [_width(0, half[0])] if math.isfinite(half[0]) else ["not known"]
    com = [_width(k, half[k], "") for k in (1, 2, 3)]
    return f"mass {known[0]}, centre of gravity {' '.join(com)} mm"


def _width(part: int, half: float, unit: str = " mm") -> str:
    """Return the half width of a quantity as text: mass in kg, coordinate in mm."""
    if not math.isfinite(half):
        return f"{PLUS_MINUS}?"
    return f"{PLUS_MINUS}{half:.2g} kg" if part == 0 else f"{PLUS_MINUS}{1000 * half:.2g}{unit}"
