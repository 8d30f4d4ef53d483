"""What the pair's controller says of a cycle and of itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gateway.pair.function import TransformFunction


@dataclass(frozen=True, slots=True)
class CycleSummary:
    """One finished cycle.

    Attributes
    ----------
    cycle : number, from 1
    complete : every command was run, with every epoch complete
    learned : whether the second function was rebuilt from it
    reason : why not, "" where there is nothing to say
    function : "first" or "second", what the slave followed
    knots : of that function
    force_n, moment_nm : largest internal force and moment as estimated, NaN where no force is measured
    at_command : index of the largest force, -1 = none
    correction_m, correction_rad : largest correction of the slave
    change_m, change_rad : how far the knots of the second function moved, NaN where it was not rebuilt
    gap_m : largest deviation of a distance from the demanded one, NaN where none is measured
    """

    cycle: int
    complete: bool
    learned: bool
    reason: str
    function: str
    knots: int
    force_n: float
    moment_nm: float
    at_command: int
    correction_m: float
    correction_rad: float
    change_m: float
    change_rad: float
    gap_m: float = float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class ControllerState:
    """What the controller holds between two cycles."""

    cycle: int
    frozen: bool
    first: TransformFunction
    second: TransformFunction | None
    in_use: str
    points: np.ndarray
    margin: float
    lead_s: float
