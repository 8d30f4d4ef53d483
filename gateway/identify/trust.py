"""How far something is trusted, as an option says it: `prior:S`, S its relative standard deviation."""

from __future__ import annotations

import math
from typing import Final

_PRIOR: Final = "prior:"


def prior_share(text: str) -> float | None:
    """Relative standard deviation S > 0 behind `prior:S`; None where the text is anything else."""
    if not text.startswith(_PRIOR):
        return None
    try:
        share = float(text.removeprefix(_PRIOR))
    except ValueError:
        return None
    return share if math.isfinite(share) and share > 0 else None
