"""The centre of gravity as it is shown: in the frame of the flange where that is known, else in that of the load."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gateway.result.result import UNKNOWN_THREE, LoadResult, Result
from gateway.result.values import Matrix, Numbers


@dataclass(frozen=True, slots=True)
class Centre:
    """Place and standard deviation (3,) [m] in `frame`, NaN where unknown; `correlation` (4, 4) of [mass, x, y, z]."""

    frame: str
    com_m: Numbers
    std_m: Numbers
    correlation: Matrix | None

    @property
    def known(self) -> bool:
        """Whether all three components are."""
        return all(map(math.isfinite, self.com_m))


def centre(load: LoadResult, result: Result | None = None) -> Centre | None:
    """Centre of gravity of a load, None where there is none.

    Parameters
    ----------
    load : LoadResult
    result : Result, optional
        Of which it is a final load: knows the uncertainty in the frame of the flange.
    """
    std_m, correlation = load.com_std_m or UNKNOWN_THREE, load.correlation
    if load.com_flange_m:
        turned = None if result is None or result.data is None else result.data.flange.get(load.label)
        if turned is not None:
            std_m, correlation = turned.com_std_m, turned.correlation
        return Centre("flange", load.com_flange_m, std_m, correlation)
    return None if load.com_m is None else Centre(load.frame, load.com_m, std_m, correlation)


def earlier(result: Result, load: LoadResult) -> LoadResult | None:
    """The same load before the effects were added; None where none were."""
    if not result.effects:
        return None
    return next((item for item in result.before.loads if item.label == load.label), None)
