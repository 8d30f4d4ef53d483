"""Conditions of measurement: what is recorded, how often, and by which method it is estimated."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Condition:
    """One way to measure: recordings of the unloaded and of the loaded arm, visits of each pose, method.

    Attributes
    ----------
    unloaded, loaded : number of recordings; `paired` puts one of each under one name
    gain_std : relative standard deviation of the torque constants, true and stated
    kind : "rest", "motion" or "both"; "next load" at rest, with constants that `calibrate` has measured
    method : of `servo-gateway estimate`
    repeats : visits of every pose
    paired : whether the k-th recordings of both loads have one name
    poses : number of rest poses
    """

    unloaded: int = 1
    loaded: int = 1
    gain_std: float = 0.01
    kind: str = "rest"
    method: str = "joint"
    repeats: int = 1
    paired: bool = False
    poses: int = 12


CONDITIONS = {
    "rest": Condition(),
    "7 recordings": Condition(loaded=6),
    "4 recordings of one load": Condition(unloaded=4, loaded=4, gain_std=0.003, paired=True, poses=10),
    "motion": Condition(kind="motion", gain_std=0.003),
    "motion, constants 3 %": Condition(kind="motion", gain_std=0.03),
    "rest with motion": Condition(kind="both", gain_std=0.003, poses=8),
    "difference": Condition(method="difference"),
    "repeats": Condition(gain_std=0.003, repeats=4, poses=6),
    "calibration and next load": Condition(kind="next load", gain_std=0.03),
}
