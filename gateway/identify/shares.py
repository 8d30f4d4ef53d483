"""Where the variance of a quantity comes from, where all knowledge but the noise stands in priors of parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int_]

#: The source of what no prior accounts for.
NOISE: Final = "noise"


def shares(lead: Floats, precision: Floats, sources: Mapping[str, Ints], variance: float) -> dict[str, float]:
    """Share of a variance by source, sum 1; `NOISE` is what the priors leave.

    With covariance `C` and prior precision `L` the variance `a C a` of `a x` is `a C A C a + a C L C a`, the first from
    the rows and the second from the priors, one term for each parameter.

    Parameters
    ----------
    lead : array of shape (p,)
        `C a`: covariance of the quantity with every parameter.
    precision : array of shape (p,)
        Of the prior of every parameter, 0 = free.
    sources : mapping of name to parameters (k,)
    variance : float
        Of the quantity, with what is beyond the model; nothing comes out where it is not above 0.
    """
    if not (np.isfinite(variance) and variance > 0.0):
        return {}
    part = lead**2 * precision / variance
    out = {name: float(part[index].sum()) for name, index in sources.items()}
    whole = max(sum(out.values()), 1e-300)
    known = min(whole, 1.0)
    return {name: share * known / whole for name, share in out.items()} | {NOISE: 1.0 - known}
