"""Every tuned number of the diagnosis in motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from gateway.identify.tuned_number import RUNS, threshold


@dataclass(frozen=True, slots=True)
class MovingThresholds:
    """Thresholds of the diagnosis in motion."""

    # rows
    blocks: int = threshold(
        6, "", "blocks of time held out in turn", "in a run of 10 s each contains both directions of every axis"
    )
    judged_blocks: int = threshold(
        4, "", "outer blocks held out in turn for validation", "three quarters of the rows remain to choose a model"
    )
    several_runs: int = threshold(
        3, "", "number of runs from which a whole run may be held out", "the two others show the changes between runs"
    )
    fewest_rows: int = threshold(60, "", "smallest number of rows for holding out any", "ten per block")
    shortest_s: float = threshold(
        2.0, "s", "shortest run for holding out any rows", "about ten correlation times of a drive's current"
    )
    # what is named
    sure: float = threshold(
        20.0,
        "log likelihood",
        "smallest gain on held-out rows, without the block that gains most, of an effect",
        "blind arms in motion: 23 at most on 14 without a mechanism, 33 and more of eight strong ones",
    )
    sure_if_visible: float = threshold(
        3.0, "log likelihood", "the same of an effect that lowers the held-out residual visibly", "log of 20"
    )
    visible_ratio: float = threshold(
        0.70, "", "held-out ratio up to which the residual is visibly lower: half of its square", RUNS
    )
    demanded: float = threshold(
        1e-3, "", "largest p-value of an effect on the fitted rows, times the number of tried candidates", RUNS
    )
    common_ratio: float = threshold(
        0.90, "", "largest held-out ratio of an effect that every gear has to some extent: less is not reported", RUNS
    )
    rare: float = threshold(30.0, "", "prior odds of another friction curve against a fault or an extra part", RUNS)
    naming_odds: float = threshold(10.0, "", "odds below which a runner-up contests an effect", RUNS)
    largest_model: int = threshold(
        60, "", "largest number of terms of a model", "more than any arm has; limits the search"
    )
    runners: int = threshold(
        12, "", "number of candidates compared with an effect, and tried first as the next one", RUNS
    )
    lead: float = threshold(
        5.0, "log likelihood", "smallest gain on held-out rows of a complex friction law over a simpler one", RUNS
    )
    coupling_slack: float = threshold(
        4.0,
        "cost",
        "smallest improvement of a fitted coupling over a one-to-one coupling",
        "two standard deviations of the coefficient",
    )
    certain_scale: float = threshold(4.0, "std", "deviation of a scale from 1 that gives a failing finding", RUNS)
    # what is left
    structure_ratio: float = threshold(
        0.87, "", "held-out ratio of an unnamed torque curve below which structure remains", RUNS
    )
    near_floor: float = threshold(
        1.41,
        "",
        "largest held-out RMS over the noise between periods that counts as noise, plus two standard deviations",
        "the repeating error is then as large as the noise; unmodelled friction near standstill reaches 1.35",
    )
    overfitted: float = threshold(
        2.0,
        "",
        "ratio of held-out to fitted RMS above which the motion is not rich enough",
        "held-out variance four times that of the fit",
    )
    # commissioning mistakes
    mistake: float = threshold(
        4.0,
        "std",
        "negative friction power that proves a reversed torque sign",
        "one false alarm in five thousand arms of six axes",
    )
    halved: float = threshold(
        0.5,
        "",
        "largest held-out ratio of the correction of a mistake",
        "a mistake leaves residuals as large as the torque",
    )
    dissipating_power: float = threshold(
        2.0, "std", "positive friction power in one run that proves a correct torque sign", "one error in forty"
    )
    explained: float = threshold(
        0.1, "", "largest share of an axis's torque not explained by another axis, for a suspected swap", RUNS
    )
    most_mistakes: int = threshold(3, "", "largest number of mistakes of one arm", "two wrong drives and one cable")
    # secondary encoders
    wind_up: float = threshold(6.0, "std", "smallest significant compliance from a secondary encoder", RUNS)
    wind_up_ratio: float = threshold(
        0.7, "", "largest ratio of the held-out wind-up with the torque to that without it", "as for an extra part"
    )
    largest_wind_up_rad: float = threshold(
        0.05, "rad", "largest wind-up; above it the encoders do not belong to one joint", "3 degrees"
    )
    # uncertainty of the CAD values of the links
    usual_trust: float = threshold(
        0.05, "", "usual relative error of CAD link values", "CAD against weighed links: a few percent"
    )
    first_trust: float = threshold(
        0.02, "", "CAD error assumed in the search; with the usual one the links could absorb a balancer", RUNS
    )
    usual_factor: float = threshold(2.0, "", "factor by which CAD values may be worse (one standard deviation)", RUNS)
    worthless: float = threshold(
        0.5, "", "relative error from which CAD values are not used", "links that may be half or double"
    )
    contradicted: float = threshold(
        3.0, "log odds", "log odds against a smaller CAD error than the best one, for rejecting it", "log of 20"
    )


MOVING: Final = MovingThresholds()
