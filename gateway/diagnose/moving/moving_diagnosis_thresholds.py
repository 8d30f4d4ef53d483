"""Every tuned number of the diagnosis in motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from gateway.identify.tuned_number import RUNS, threshold


@dataclass(frozen=True, slots=True)
class Demands:
    """What an effect must show.

    Attributes
    ----------
    ratio : held-out RMS of its axes with it over without it, at most
    p_demand : probability that the fitted rows demand it by chance, times the candidates tried, at most
    p_held : probability that the held-out error drops by chance, at most
    blocks_better : share of the held-out blocks that get better, at least
    """

    ratio: float
    p_demand: float
    p_held: float
    blocks_better: float


@dataclass(frozen=True, slots=True)
class MovingThresholds:
    """Thresholds of the diagnosis in motion."""

    # rows
    blocks: int = threshold(
        6, "", "blocks of time held out in turn", "each still holds every axis both ways in a run of 10 s"
    )
    judged_blocks: int = threshold(
        4, "", "outer blocks that judge in turn", "three quarters of the rows are left to choose a model by"
    )
    several_runs: int = threshold(
        3, "", "runs from which on one may be held out whole", "two are left, which show what changes from run to run"
    )
    fewest_rows: int = threshold(60, "", "rows below which nothing is held out", "ten a block")
    shortest_s: float = threshold(
        2.0, "s", "run below which nothing is held out", "some ten correlation times of a drive's current"
    )
    # what is named
    ordinary: Demands = threshold(Demands(0.90, 5e-3, 0.02, 0.5), "", "demands on effects that any gear has", RUNS)
    special: Demands = threshold(Demands(0.70, 1e-3, 0.02, 0.75), "", "demands on a fault or an extra part", RUNS)
    special_all_axes: Demands = threshold(
        Demands(0.85, 1e-3, 0.02, 0.75), "", "the same where it shows on more than two axes", RUNS
    )
    rare: float = threshold(
        30.0, "", "odds beforehand of another shape of friction over a fault or an extra part", RUNS
    )
    sure_odds: float = threshold(10.0, "", "odds below which a runner-up contests an effect", RUNS)
    largest_model: int = threshold(60, "", "terms of one model", "more than any arm has: keeps the search finite")
    runners: int = threshold(
        12, "", "candidates weighed in the place of an effect, and judged first as the next one", RUNS
    )
    lead: float = threshold(
        5.0, "log likelihood", "by which another law has to do better on held-out rows than a plainer one", RUNS
    )
    coupling_slack: float = threshold(
        4.0,
        "cost",
        "by which a coupling has to fit better than one to one",
        "two standard deviations of the coefficient",
    )
    certain_scale: float = threshold(4.0, "std", "distance of a scale from 1 that is a failing finding", RUNS)
    # what is left
    structure_ratio: float = threshold(
        0.87, "", "held-out ratio of a shape without a cause at which structure remains", RUNS
    )
    structure_p: float = threshold(
        1e-3,
        "",
        "probability that it does so by chance",
        "one false alarm in a thousand, over seven shapes and six axes one in twenty",
    )
    near_floor: float = threshold(
        1.41,
        "",
        "held-out RMS over the noise between periods up to which it is noise, beside two of its standard deviations",
        "what repeats is as large as the noise: friction next to standstill, which no model foretells, reaches 1.35",
    )
    overfitted: float = threshold(
        2.0,
        "",
        "held-out over fitted RMS at which the motion is too poor",
        "held-out variance four times that of the fit",
    )
    quiet: float = threshold(0.1, "", "share of the mean square that a quiet stretch counts beside its own", RUNS)
    # commissioning mistakes
    mistake: float = threshold(
        4.0,
        "std",
        "power of friction below zero that reads a torque with the wrong sign",
        "six axes, one false alarm in five thousand",
    )
    halved: float = threshold(
        0.5, "", "held-out ratio that undoing a mistake must reach", "a mistake leaves residuals as large as the torque"
    )
    right_way: float = threshold(
        2.0, "std", "power of friction above zero in one run that proves the sign of its torque", "one in forty"
    )
    explained: float = threshold(
        0.1, "", "share of an axis's torque that is left of one that may be another axis's", RUNS
    )
    most_mistakes: int = threshold(3, "", "mistakes of one arm", "two wrong drives and one cable")
    # secondary encoders
    wind_up: float = threshold(6.0, "std", "compliance by a secondary encoder that is named", RUNS)
    wind_up_ratio: float = threshold(
        0.7, "", "held-out ratio of the wind-up with the torque over without it", "as demands on an extra part"
    )
    largest_wind_up_rad: float = threshold(0.05, "rad", "beyond which the encoders do not belong together", "3 degrees")
    # trust in the drawing of the links
    usual_trust: float = threshold(
        0.05, "", "relative error of drawings that is usual", "CAD against weighed links: a few percent"
    )
    first_trust: float = threshold(
        0.02, "", "trust to search with: at the usual one the links stretch to swallow a balancer", RUNS
    )
    usual_factor: float = threshold(2.0, "", "factor by which a drawing may be worse, one standard deviation", RUNS)
    worthless: float = threshold(0.5, "", "error at which a drawing tells nothing", "links that may be half or double")
    contradicted: float = threshold(3.0, "log odds", "against a tighter trust than the data like best", "log of 20")
    loose_mass: float = threshold(
        0.5, "", "relative standard deviation at which a mass is unknown", "a load that may be half or double is none"
    )
    next_to_nothing: float = threshold(0.05, "", "as at rest: up to here a mass about 0 is told", "as at rest")
    loose_com_m: float = threshold(
        0.3,
        "m",
        "standard deviation at which a centre of gravity is unknown",
        "the size of a load that a small arm moves",
    )


MOVING: Final = MovingThresholds()
