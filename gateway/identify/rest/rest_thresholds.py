"""Tuned numbers of the model at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from gateway.identify.tuned_number import BLIND, threshold


@dataclass(frozen=True, slots=True)
class RestModelThresholds:
    """Priors and noise of the model at rest."""

    strength_spread: float = threshold(
        10.0,
        "noise floors",
        "prior standard deviation of the strength of an effect of unknown size",
        "range of strengths in blind cells, 1.5 to 20",
    )
    noise_weight: float = threshold(4.0, "rows", "weight of the noise estimate from approach directions", BLIND)
    relative_floor: float = threshold(
        2e-4,
        "",
        "least noise as a share of an axis's torque",
        "resolution of a torque word of 1000 steps, rounded off over some visits",
    )
    drift_axis: float = threshold(
        0.003, "", "drift of an axis's torque reading while the arm warms up", "assumed: magnets, some 10 K"
    )
    drift_s: float = threshold(1800.0, "s", "time constant of that drift", "assumed: motors warm in 5 to 60 min")
    cold: float = threshold(
        0.25,
        "",
        "prior standard deviation of the extra friction when cold, for each time constant",
        "assumed: 0 to 0.5",
    )
    warm_fast_s: float = threshold(600.0, "s", "shorter time constant of the warm-up", "assumed: 5 to 60 min")
    warm_slow_s: float = threshold(2400.0, "s", "the longer", "assumed: 5 to 60 min")


REST_MODEL: Final = RestModelThresholds()


@dataclass(frozen=True, slots=True)
class ConflictThresholds:
    """Thresholds above which a statement counts as contradicted by the measurement."""

    log_odds: float = threshold(
        2.5,
        "",
        "log marginal likelihood of a wider prior over that of the stated one",
        "false alarms on clean cells of `make conflict`: at most 2 %",
    )
    dropped: float = threshold(
        3.0, "", "factor on the stated standard deviation of a group above which it is dropped", "assumed"
    )
    shown: float = threshold(
        2.0, "", "standard deviations above which a torque constant is listed", "one axis in twenty by chance"
    )
    bodies_p: float = threshold(
        1e-4,
        "",
        "probability below which two masses under one label are reported",
        "one false alarm in 10 000 labels",
    )


CONFLICT: Final = ConflictThresholds()
