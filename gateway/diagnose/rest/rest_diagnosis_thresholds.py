"""Every tuned number of the diagnosis at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from gateway.identify.tuned_number import BLIND, threshold

KASS: Final = "Kass and Raftery (1995): 3 positive, 20 strong"


@dataclass(frozen=True, slots=True)
class RestThresholds:
    """Thresholds of the diagnosis at rest."""

    # what is named
    least_poses: int = threshold(
        4,
        "",
        "smallest number of poses for holding out any and naming an effect",
        "one more than the three that a centre of gravity needs",
    )
    least_strength: float = threshold(
        0.5, "noise floors", "smallest strength of a named effect after projecting out links, loads and bands", BLIND
    )
    unseen: float = threshold(
        1.0,
        "std",
        "smallest improvement of left-out poses by a named effect",
        "five of six effects with this improvement are true",
    )
    naming_odds: float = threshold(20.0, "", "odds below which another set of effects is a rival", KASS)
    ask_odds: float = threshold(
        400.0,
        "",
        "odds below which further measurements against a rival are recommended",
        "square of naming_odds: another equally informative measurement could reverse it",
    )
    out_of_reach: float = threshold(
        100.0,
        "log odds",
        "distance to the best hypothesis above which leaving out a pose cannot make it the best",
        "more than one pose contributes",
    )
    hint_odds: float = threshold(3.0, "", "odds below which a larger set of effects stays a candidate", KASS)
    structure_p: float = threshold(
        1e-3,
        "",
        "p-value of the residual below which structure remains",
        "one false alarm in a thousand clean cells",
    )
    least_pairs: int = threshold(
        4, "", "smallest number of pairs of visits of one pose for comparing an axis's residuals", "as least_poses"
    )
    least_freedom: float = threshold(
        3.0,
        "rows",
        "smallest degrees of freedom for comparing an axis's scatter",
        "fewer give the scatter only to a factor",
    )
    scatter_freedom: float = threshold(
        0.5,
        "",
        "share of the degrees of freedom used in comparing the scatter of an axis",
        "friction after settling is not normally distributed, and its two approaches are correlated",
    )
    power: float = threshold(0.8, "", "power of the tests at the reported size of a structure", "customary value")
    power_draws: int = threshold(
        120, "", "number of draws for that size", "standard deviation of a power of 80 % is 4 %"
    )
    power_seed: int = threshold(20, "", "seed of those draws", "any; the same data give the same result")
    largest_structure: float = threshold(
        20.0, "noise floors", "largest size of a structure that is computed", "the strongest effect of the blind cells"
    )
    structure_step: float = threshold(0.02, "", "relative accuracy of that size", "less than the scatter of the draws")
    fresh_p: float = threshold(
        0.05,
        "",
        "p-value of residuals of fresh rows below which they contradict the model",
        "with fresh_slack one false alarm in seventy, which recommends more poses and names no effect; four poses detect a "
        "doubled residual of one axis in one of two cases, and in one of eight at a p-value of 0.001",
    )
    fresh_slack: float = threshold(1.15, "", "largest ratio of the variance of fresh rows to the predicted one", BLIND)
    most_effects: int = threshold(
        8, "", "largest number of effects of a hypothesis", "limits the search; its gains end it much earlier"
    )
    needed: float = threshold(3.0, "log odds", "smallest gain of an effect that is kept", "log of 20, as naming_odds")
    implausible: float = threshold(
        8.0, "log odds", "prior penalty of an effect with a value that its mechanism cannot have", BLIND
    )
    rare: float = threshold(2.0, "log odds", "prior penalty of an unnamed torque curve against named effects", BLIND)
    cogging: float = threshold(1.0, "noise floors", "RMS of the usual ripple of a gear", "assumed: below one floor")
    # where the search looks
    singles: int = threshold(8, "", "number of places fitted alone", BLIND)
    pairs: int = threshold(10, "", "number of pairs of places fitted together", BLIND)
    forward: int = threshold(5, "", "number of places added to a leading hypothesis", BLIND)
    unnamed: int = threshold(4, "", "number of unnamed torque curves added to a leading hypothesis", BLIND)
    shapes: int = threshold(2, "", "number of shapes fitted at one place, of linear effects", BLIND)
    shapes_fitted: int = threshold(6, "", "number of shapes fitted at one place, of nonlinear effects", BLIND)
    shapes_added: int = threshold(3, "", "number of shapes added to a leading hypothesis at one place", BLIND)
    inert: float = threshold(
        0.5,
        "noise floors",
        "change of all rows together below which a candidate has no effect",
        "no fit can detect half a noise floor over all rows together",
    )
    # ripple of unknown order
    ripple_angles: int = threshold(
        12,
        "",
        "smallest number of angles of an axis for order analysis",
        "by simulation: the best of thousands of orders fits fewer angles for any torque",
    )
    ripple_squares: float = threshold(
        3.0,
        "noise floors2",
        "smallest mean square residual of an axis for order analysis",
        "a ripple of two noise floors",
    )
    ripple_p: float = threshold(
        0.01,
        "",
        "largest p-value of the best order, over all axes, under torque without an order",
        "one false ripple in a hundred",
    )
    ripple_draws: int = threshold(
        1000, "", "number of draws for that p-value", "standard deviation of a p-value of 0.01 is one third"
    )
    ripples: int = threshold(
        3, "", "largest number of axes with a ripple of unknown order", "the axes with large torque"
    )
    aliases: int = threshold(
        3, "", "largest number of reported further orders that fit nearly as well", "a line of text"
    )
    # commissioning mistakes
    mistake: float = threshold(20.0, "log odds", "smallest gain by correcting a mistake", BLIND)
    common_mistake: float = threshold(
        30.0, "log odds", "prior penalty of one factor on all axes, because heavier links look like it", BLIND
    )
    surer: float = threshold(2.0, "log odds", "margin of a mistake over the best effects without it", BLIND)
    obvious: float = threshold(150.0, "log odds", "gain of a mistake from which effects are not searched first", BLIND)
    most_mistakes: int = threshold(3, "", "largest number of mistakes of one arm", "two wrong drives and one cable")
    mistake_probability: float = threshold(
        0.95, "", "confidence that correcting a mistake improves left-out poses", "customary value, one-sided"
    )
    least_axes: int = threshold(
        2,
        "",
        "smallest number of measured and moved axes for the search of mistakes",
        "on a single axis a spring or a wrong link looks the same",
    )
    moved_rad: float = threshold(
        0.02, "rad", "range of an axis's angles below which it did not move", "ten times the tolerance of one pose"
    )
    suspicious: float = threshold(
        1.7, "noise floors", "residual of the half-sums from which mistakes are searched", BLIND
    )
    beyond_any_effect: float = threshold(
        8.0, "noise floors", "residual of the half-sums from which mistakes are searched before effects", BLIND
    )
    negative_band: float = threshold(
        -3.0,
        "std",
        "friction band below which the torque sign is reversed",
        "one axis in a thousand by chance",
    )
    odd_gain: float = threshold(
        0.24,
        "",
        "smallest deviation of a scale from 1 that may be a factor of sqrt 2",
        "1 minus sqrt 0.5, minus 5 % error of the CAD values",
    )
    far_from_cad: float = threshold(
        60.0,
        "",
        "sum of squared link corrections over their standard deviations above which a mistake is more likely",
        "24 parameters, and 5 standard deviations of their chi-square",
    )
    # direct evidence
    wind_up: float = threshold(6.0, "std", "smallest significant compliance from a secondary encoder", BLIND)
    wind_up_strength: float = threshold(
        0.6, "noise floors", "smallest torque error without the secondary encoder", BLIND
    )
    bias: float = threshold(
        5.0,
        "std",
        "smallest significant direction-dependent friction in one-sided visits",
        "one false alarm in half a million arms of six axes",
    )
    bias_strength: float = threshold(
        0.5, "noise floors", "smallest reported direction-dependent friction", "as least_strength"
    )
    each_side: int = threshold(2, "", "smallest number of one-sided visits per side", "one to fit, one to test")
    # what to measure next
    asked: int = threshold(8, "", "number of poses recommended at once", "about five minutes of measurement")
    total_information_share: float = threshold(
        0.1,
        "",
        "weight of the information on all rivals, added to that on the least separable one",
        "small: it only decides between poses with equal information on that rival",
    )
    telling: float = threshold(
        1.0, "log odds", "smallest expected information of recommended poses", "less does not change the verdict"
    )
    apart_rad: float = threshold(
        0.3,
        "rad",
        "smallest distance of recommended poses",
        "17 degrees: repeated poses determine friction, not pose dependence",
    )


REST: Final = RestThresholds()
