"""Strength of the nuisance effects: mild in every arm, strong where a condition raises it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Harshness:
    """Ranges of the nuisance effects; a span is (least, most), uniform unless stated otherwise.

    Attributes
    ----------
    gain_std : standard deviation of the relative error of the torque constants; one draw a cell
    bias_share : size of the bias by direction over the band, its sign by chance
    load_loss : friction torque per transmitted torque, at rated torque
    efficiency : undeclared residual efficiency of the gear
    efficiency_split : standard deviation of half the difference between driving and driven back
    warm_share : how much wider the band is when cold, both time constants together
    tail_freedom : degrees of freedom of the scatter of friction; the lower, the heavier its tails
    tail_share : standard deviation of that scatter over the band
    side_correlation : size of the correlation of that scatter between the sides, its sign by chance
    outlier_share : share of the visits with an outlier on one axis
    repeat_rad : standard deviation of the link angle from visit to visit at the same encoder angle
    backlash_rad : width of the play behind the encoder
    cogging_ratio : RMS of the cogging over the noise floor of the axis
    cad_std : standard deviation of the CAD's inertials
    cad_outliers : share of the links whose error is drawn 2.5 times as wide as that of the others
    """

    gain_std: Span = (0.005, 0.01)
    bias_share: Span = (0.0, 0.04)
    load_loss: Span = (0.005, 0.03)
    efficiency: Span = (0.98, 1.0)
    efficiency_split: Span = (0.0, 0.003)
    warm_share: Span = (0.02, 0.10)
    tail_freedom: Span = (9.0, 15.0)
    tail_share: Span = (0.01, 0.04)
    side_correlation: Span = (0.0, 0.2)
    outlier_share: Span = (0.0, 0.004)
    repeat_rad: Span = (0.00005, 0.0003)
    backlash_rad: Span = (0.00005, 0.0005)
    cogging_ratio: Span = (0.05, 0.2)
    cad_std: Span = (0.02, 0.04)
    cad_outliers: Span = (0.0, 0.0)


MILD = Harshness()
#: What each condition raises, and how far.
RAISED = {
    "base": {},
    "gains": {"gain_std": (0.02, 0.05)},
    "bias": {"bias_share": (0.07, 0.17), "side_correlation": (0.3, 0.7)},
    "losses": {"load_loss": (0.03, 0.15)},
    "efficiency": {"efficiency": (0.85, 0.95), "efficiency_split": (0.005, 0.015)},
    "warm_up": {"warm_share": (0.3, 0.7)},
    "tails": {"tail_freedom": (3.0, 4.0), "tail_share": (0.08, 0.16), "side_correlation": (0.4, 0.8)},
    "gross": {"outlier_share": (0.02, 0.05)},
    "backlash": {"repeat_rad": (0.0005, 0.0015), "backlash_rad": (0.001, 0.003)},
    "cogging": {"cogging_ratio": (0.4, 1.1)},
    "cad": {"cad_std": (0.05, 0.20), "cad_outliers": (0.2, 0.2)},
}
CONDITIONS = (*RAISED, "all")


def levels_of(condition: str) -> Harshness:
    """Levels of a condition; ``all`` has everything at the mean of mild and strong.

    Raises
    ------
    KeyError
        No such condition.
    """
    if condition != "all":
        return replace(MILD, **RAISED[condition])
    harsh: dict[str, Span] = {name: span for raised in RAISED.values() for name, span in raised.items()}
    half = {
        field.name: tuple(
            0.5 * (mild + high) for mild, high in zip(getattr(MILD, field.name), harsh[field.name], strict=True)
        )
        for field in fields(MILD)
    }
    # both conditions that raise the correlation raise it to their own level; together, to that of heavy tails
    return replace(MILD, **half)
