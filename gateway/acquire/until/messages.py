"""How far a load is known, in sentences: after each pose, and at the end with what would help."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gateway.acquire.until.choice import MOST_POSES, Narrowness
from gateway.acquire.until.search import NextStep
from gateway.estimate.outlook import Outlook
from gateway.result.interval import PLUS_MINUS, SAID, half_width
from gateway.result.result import Finding

Floats = NDArray[np.float64]

PARTS: Final = ("mass", "x", "y", "z")
_KNOWN_LOAD: Final = "mount a load of known mass and estimate with --known LABEL=MASS,X,Y,Z"


def narrowed(decision: NextStep) -> str:
    """One line after a pose: half widths now, and how many more poses are expected."""
    verdict = decision.verdict
    if verdict.done or decision.plan is None:
        more = "nothing more is measured"
    else:
        more = f"about {verdict.ahead} more" if not verdict.hopeless.any() else "more would still help"
    return f"{verdict.poses} poses: {_widths(verdict.half)}; {more}"


def ended(decision: NextStep, label: str) -> str:
    """Why the measurement ended: known well enough, or what no pose gives and what would."""
    verdict, stock = decision.verdict, decision.stock
    after = f"after {verdict.poses} poses"
    if stock.refused is not None:
        return f"load {label} is refused {after}: {stock.refused}; look whether it slips or touches, and measure again"
    if verdict.reached.all():
        return f"load {label} is known as well as was asked for {after}: {_widths(verdict.half)} ({SAID})"
    short = np.flatnonzero(~verdict.reached).tolist()
    missed = ", ".join(
        f"{PARTS[k]} {_width(k, verdict.goal[k])} (it is {_width(k, verdict.half[k])}, "
        f"{MOST_POSES} poses would leave {_width(k, verdict.limit[k])})"
        for k in short
    )
    return f"no further pose brings load {label} to {missed}; {what_helps(stock.outlook, verdict)}"


def end_of(decision: NextStep, label: str) -> Finding:
    """The same as a finding of the result."""
    reached = bool(decision.verdict.reached.all()) and decision.stock.refused is None
    said, _, helps = ended(decision, label).partition("; ")
    return Finding("info" if reached else "warn", f"load {label}", said, helps)


def what_helps(known: Outlook, verdict: Narrowness) -> str:
    """What would bring a load as far as was asked for, where poses do not."""
    short = ~verdict.reached
    now = half_width(1.0) * known.std[short]
    constants = half_width(1.0) * known.std_given(known.gain)[short]
    links = half_width(1.0) * known.std_given(np.arange(len(known.links)))[short]
    goal = verdict.goal[short]
    if (constants <= goal).all() or (constants / now).max() < (links / now).max():
        return f"what would: better torque constants (std_percent in the cell file), or {_KNOWN_LOAD}"
    if (links <= goal).all() or (links / now).max() < 1.0:
        return "what would: more poses of the unloaded arm, so that its own weight is known better"
    return f"what would: a quieter approach (approach_speed_rad_s) or more samples, and {_KNOWN_LOAD}"


def _widths(half: Floats) -> str:
    known = [_width(0, half[0])] if math.isfinite(half[0]) else ["not known"]
    com = [_width(k, half[k], "") for k in (1, 2, 3)]
    return f"mass {known[0]}, centre of gravity {' '.join(com)} mm"


def _width(part: int, half: float, unit: str = " mm") -> str:
    """Half width of a part: mass in kg, a coordinate in mm."""
    if not math.isfinite(half):
        return f"{PLUS_MINUS}?"
    return f"{PLUS_MINUS}{half:.2g} kg" if part == 0 else f"{PLUS_MINUS}{1000 * half:.2g}{unit}"
