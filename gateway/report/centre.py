"""Centre of gravity for display: in the flange frame if known, otherwise in the frame of the result."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gateway.result.result import UNKNOWN_THREE, LoadResult, Result
from gateway.result.values import Matrix, Numbers


@dataclass(frozen=True, slots=True)
class Centre:
    """Position and standard deviation (3,) [m] in `frame`, NaN if unknown; `correlation` (4, 4) of [mass, x, y, z]."""

    frame: str
    com_m: Numbers
    std_m: Numbers
    correlation: Matrix | None

    @property
    def known(self) -> bool:
        """Return whether all three components are known."""
        return all(map(math.isfinite, self.com_m))


def centre(load: LoadResult, result: Result | None = None) -> Centre | None:
    """Return the centre of gravity of a load, or None.

    Parameters
    ----------
    load : LoadResult
    result : Result, optional
        Result of the load, with its uncertainty in the flange frame.
    """
    std_m, correlation = load.com_std_m or UNKNOWN_THREE, load.correlation
    if load.com_flange_m:
        turned = None if result is None or result.data is None else result.data.flange.get(load.label)
        if turned is not None:
            std_m, correlation = turned.com_std_m, turned.correlation
        return Centre("flange", load.com_flange_m, std_m, correlation)
    return None if load.com_m is None else Centre(load.frame, load.com_m, std_m, correlation)


def earlier(result: Result, load: LoadResult) -> LoadResult | None:
    """Return the same load before the effects were added, or None."""
    if not result.effects:
        return None
    return next((item for item in result.before.loads if item.label == load.label), None)
