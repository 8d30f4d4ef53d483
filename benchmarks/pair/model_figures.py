"""The numpy tier as figures of `make pair`: conditions with the value that decides, and every seed."""

from __future__ import annotations

from collections.abc import Sequence

from tests.support.pair.model import Scope, figures
from tests.support.pair.model_gap import gaps
from tests.support.pair.model_verdicts import verdicts

SEEDS = tuple(range(6))
ALL = Scope()


def model_figures(seeds: Sequence[int] = SEEDS, scope: Scope = ALL) -> dict[str, dict[str, object]]:
    """Name -> value, interval, unit (with the figures of all seeds), goal, met; about 2 min of one core for 6 seeds."""
    found = verdicts(figures(seeds, scope), gaps(seeds))
    return {
        f"numpy {item.name}": {
            "value": float(item.value),
            "interval": None,
            "unit": f"{item.unit}; {item.figures}",
            "goal": item.demands,
            "met": item.passed,
        }
        for item in found
    }
