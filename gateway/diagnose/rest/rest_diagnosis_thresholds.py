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
        "poses below which nothing is held out and no effect is named",
        "one to spare beyond the three of a centre of gravity",
    )
    least_strength: float = threshold(
        0.5, "floors", "what links, loads and bands leave of an effect that is named", BLIND
    )
    least_link_strength: float = threshold(
        0.8, "floors", "the same of extra mass on a link, which a drawing that is wrong looks like", BLIND
    )
    unseen: float = threshold(
        1.0,
        "std",
        "by how much unseen rows have to be met better with an effect that is named, over poses",
        "five of six that are seen to help do help",
    )
    sure_odds: float = threshold(20.0, "", "odds below which another set of effects is a rival", KASS)
    ask_odds: float = threshold(
        400.0,
        "",
        "odds below which a rival is worth more measurements",
        "the square of sure odds: one more measurement of the same weight could turn it",
    )
    out_of_reach: float = threshold(
        100.0,
        "log odds",
        "behind the best, beyond which no choice of fewer poses goes back",
        "more than one pose decides",
    )
    hint_odds: float = threshold(3.0, "", "odds below which a larger set is kept in mind", KASS)
    structure_p: float = threshold(
        1e-3,
        "",
        "probability that noise leaves what is left, below which structure remains",
        "one false alarm in a thousand clean cells",
    )
    least_pairs: int = threshold(
        4, "", "pairs of visits of one pose below which an axis's residuals are not compared", "as least poses"
    )
    least_freedom: float = threshold(
        3.0, "rows", "freedom below which an axis's scatter is not compared", "fewer know their own scatter to a factor"
    )
    scatter_freedom: float = threshold(
        0.5,
        "",
        "share of the freedom that the scatter of an axis is compared with",
        "friction that is left after settling is not normal, nor are its two sides quite independent",
    )
    power: float = threshold(0.8, "", "probability with which the size that is told would have been seen", "custom")
    power_draws: int = threshold(120, "", "draws by which that size is found", "they tell 80 % to 4 %")
    power_seed: int = threshold(20, "", "seed of those draws", "any; the same data give the same result")
    largest_structure: float = threshold(
        20.0, "floors", "size beyond which no structure is asked about", "the strongest effect of the blind cells"
    )
    structure_step: float = threshold(0.02, "", "to what share that size is found", "less than its draws scatter")
    fresh_p: float = threshold(
        0.05,
        "",
        "probability of residuals as large on fresh rows, below which they contradict the model",
        "with the slack one false alarm in seventy, which asks for more poses and names nothing; four poses see a "
        "doubled residual of one axis one time in two so, and one in eight at a thousandth",
    )
    fresh_slack: float = threshold(1.15, "", "by which the variance of fresh rows may be larger than foretold", BLIND)
    most_effects: int = threshold(
        8, "", "effects of one hypothesis", "an end to the search, well beyond what its gains let it reach"
    )
    needed: float = threshold(3.0, "log odds", "what an effect has to gain to stay", "log of 20, as sure odds")
    implausible: float = threshold(8.0, "log odds", "against an effect that its mechanism cannot do", BLIND)
    rare: float = threshold(2.0, "log odds", "against a shape without a name beside the effects with one", BLIND)
    cogging: float = threshold(1.0, "floors", "RMS of a ripple that every gear has", "`methods.md` 9: below one floor")
    # where the search looks
    singles: int = threshold(8, "", "places fitted alone", BLIND)
    pairs: int = threshold(10, "", "pairs of places fitted together", BLIND)
    forward: int = threshold(5, "", "places added to a leader", BLIND)
    unnamed: int = threshold(4, "", "shapes without a name added to a leader", BLIND)
    shapes: int = threshold(2, "", "shapes fitted at one place, of effects that are linear", BLIND)
    shapes_fitted: int = threshold(6, "", "the same of effects that are not", BLIND)
    shapes_added: int = threshold(3, "", "the same, added to a leader", BLIND)
    inert: float = threshold(
        0.5,
        "floors",
        "largest change of all rows below which a candidate does nothing",
        "half a floor over all rows together is seen by no fit",
    )
    # swings of unknown order
    ripple_angles: int = threshold(
        12,
        "",
        "angles of an axis below which its orders are not looked through",
        "fewer are met by the best of thousands of orders whatever the torque is: by draws",
    )
    ripple_squares: float = threshold(
        3.0, "floors2", "mean square of what is left of an axis below which it is not asked", "a swing of two floors"
    )
    ripple_p: float = threshold(
        0.01,
        "",
        "probability that torque without any order is met as well by the best of all orders, over all axes",
        "one name in a hundred for what is no ripple",
    )
    ripple_draws: int = threshold(1000, "", "draws by which that is found", "they tell one in a hundred to a third")
    ripples: int = threshold(3, "", "axes whose ripple is looked for one after the other", "the heavy ones")
    aliases: int = threshold(3, "", "further orders that are told where they fit nearly as well", "a line of text")
    # commissioning mistakes
    mistake: float = threshold(20.0, "log odds", "what undoing a mistake has to gain", BLIND)
    common_mistake: float = threshold(
        30.0, "log odds", "against one factor on all axes: heavier links look like it", BLIND
    )
    surer: float = threshold(2.0, "log odds", "against a mistake beside the best effects instead", BLIND)
    obvious: float = threshold(150.0, "log odds", "gain at which effects need not be searched for first", BLIND)
    most_mistakes: int = threshold(3, "", "mistakes of one arm", "two wrong drives and one cable")
    mistake_sure: float = threshold(
        0.95, "", "probability that undoing a mistake foretells unseen poses better", "custom, one-sided"
    )
    least_axes: int = threshold(
        2,
        "",
        "axes that were measured and moved, below which no mistake is looked for",
        "what one axis shows alone, any spring or wrong link shows too",
    )
    moved_rad: float = threshold(
        0.02, "rad", "range of an axis's angles below which it stood still", "ten times the tolerance of one pose"
    )
    suspicious: float = threshold(
        1.7, "floors", "what is left of the half sums at which mistakes are looked for", BLIND
    )
    beyond_any_effect: float = threshold(8.0, "floors", "the same at which they are looked for first", BLIND)
    negative_band: float = threshold(
        -3.0,
        "std",
        "a friction band this far below zero is read with the wrong sign",
        "one axis in a thousand by chance",
    )
    odd_gain: float = threshold(
        0.24,
        "",
        "a scale this far from 1 may be a factor of sqrt 2",
        "what 1 lacks to the root of one half, less 5 % of the drawing",
    )
    statement_effects: int = threshold(
        3,
        "",
        "wrong constants and links from which the robot model or the constants as a whole are wrong",
        "no cell of `make blind` has more than two effects",
    )
    far_from_cad: float = threshold(
        60.0,
        "",
        "squares of links over their trust beyond which a mistake is likelier",
        "24 parameters, and 5 standard deviations of their chi-square",
    )
    # direct evidence
    wind_up: float = threshold(6.0, "std", "compliance by a secondary encoder that is named", BLIND)
    wind_up_strength: float = threshold(0.6, "floors", "what the torque would miss without that encoder", BLIND)
    bias: float = threshold(
        5.0,
        "std",
        "friction by direction in one-sided visits that is named",
        "six axes, one false alarm in half a million",
    )
    bias_strength: float = threshold(0.5, "floors", "size of it that matters", "as least strength")
    each_side: int = threshold(2, "", "one-sided visits from each side", "one to fit, one to contradict")
    # what to measure next
    asked: int = threshold(8, "", "poses asked for at once", "some five minutes of measuring")
    told_in_all: float = threshold(
        0.1,
        "",
        "share of what a pose tells of all rivals, beside the one that is hardest to tell",
        "small: it only decides between poses that tell that one equally well",
    )
    telling: float = threshold(
        1.0, "log odds", "what new poses have to promise", "less does not change odds that matter"
    )
    apart_rad: float = threshold(
        0.3, "rad", "distance of poses that are asked for", "17 degrees: the same pose twice tells friction, not shape"
    )


REST: Final = RestThresholds()
