"""Parse the option `prior:S`, where S is a relative standard deviation."""

from __future__ import annotations

import math
from typing import Final

_PRIOR: Final = "prior:"


def prior_share(text: str) -> float | None:
    """Return the relative standard deviation S > 0 of `prior:S`; None for any other text."""
    if not text.startswith(_PRIOR):
        return None
    try:
        share = float(text.removeprefix(_PRIOR))
    except ValueError:
        return None
    return share if math.isfinite(share) and share > 0 else None
