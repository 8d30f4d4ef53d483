"""Every tuned number of the model at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from gateway.identify.thresholds import BLIND, threshold


@dataclass(frozen=True, slots=True)
class RestModelThresholds:
    """Priors and noise of the model at rest."""

    strength_spread: float = threshold(
        10.0,
        "floors",
        "how strong an effect of unknown size may be (standard deviation of its prior)",
        "the strengths that blind cells draw, 1.5 to 20",
    )
    noise_weight: float = threshold(4.0, "rows", "weight of the noise that the sides of visits show beforehand", BLIND)
    relative_floor: float = threshold(
        2e-4,
        "",
        "share of an axis's torque below which no noise is believed",
        "resolution of a torque word of 1000 steps, rounded off over some visits",
    )
    drift_axis: float = threshold(
        0.003, "", "drift of an axis's torque reading while the arm warms up", "`methods.md` 11: magnets, some 10 K"
    )
    drift_s: float = threshold(1800.0, "s", "time constant of that drift", "`methods.md` 9: motors warm in 5 to 60 min")
    cold: float = threshold(
        0.25, "", "share by which friction is larger cold, of each time constant", "`methods.md` 9: 0 to 0.5"
    )
    warm_fast_s: float = threshold(600.0, "s", "the shorter time in which it warms up", "`methods.md` 9: 5 to 60 min")
    warm_slow_s: float = threshold(2400.0, "s", "the longer", "`methods.md` 9: 5 to 60 min")


REST_MODEL: Final = RestModelThresholds()


@dataclass(frozen=True, slots=True)
class ConflictThresholds:
    """When a statement about the arm counts as contradicted by the measurement."""

    log_odds: float = threshold(
        2.5,
        "",
        "logarithm of the marginal likelihood that a wider prior gains over the stated one",
        "false alarms on clean cells of `make conflict`: at most 2 %",
    )
    dropped: float = threshold(
        3.0, "", "times its stated spread that a group needs before it is dropped", "`methods.md` 11"
    )
    shown: float = threshold(
        2.0, "", "standard deviations from which a torque constant is listed", "one axis in twenty by chance"
    )
    bodies_p: float = threshold(
        1e-4,
        "",
        "probability at which two masses under one label are told from one",
        "one false alarm in 10 000 labels",
    )


CONFLICT: Final = ConflictThresholds()
