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
    kind : "rest", "motion" or "both"; "next load" at rest, with constants that `calibrate` has measured; "part" at
        rest and "part in motion": a workpiece as the difference of two loads
    method : of `servo-gateway estimate`
    repeats : visits of every pose
    paired : whether the k-th recordings of both loads have one name
    poses : number of rest poses
    missing : torque that no model of the product has (`nature.missing_torque`), "" = none
    """

    unloaded: int = 1
    loaded: int = 1
    gain_std: float = 0.01
    kind: str = "rest"
    method: str = "joint"
    repeats: int = 1
    paired: bool = False
    poses: int = 12
    missing: str = ""


CONDITIONS = {
    "rest": Condition(),
    "7 recordings": Condition(loaded=6),
    "4 recordings of one load": Condition(unloaded=4, loaded=4, gain_std=0.003, paired=True, poses=10),
    "motion": Condition(kind="motion", gain_std=0.003),
    "motion, constants 3 %": Condition(kind="motion", gain_std=0.03),
    "rest with motion": Condition(kind="both", gain_std=0.003, poses=8),
    "difference": Condition(method="difference"),
    "repeats": Condition(gain_std=0.003, repeats=4, poses=6),
    "constants 3 %": Condition(gain_std=0.03),
    "constants 3 %, cogging": Condition(gain_std=0.03, missing="cogging"),
    "constants 3 %, cables on J4 and J5": Condition(gain_std=0.03, missing="cables"),
    "constants 3 %, spring on J2": Condition(gain_std=0.03, missing="spring"),
    "constants 3 %, no name on J2 and J3": Condition(gain_std=0.03, missing="unnamed"),
    "gripper and part": Condition(kind="part"),
    "gripper and part, constants 3 %": Condition(kind="part", gain_std=0.03),
    "gripper and part in motion": Condition(kind="part in motion"),
    "calibration and next load": Condition(kind="next load", gain_std=0.03),
}
