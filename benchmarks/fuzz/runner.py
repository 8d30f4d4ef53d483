"""Run a fuzz target over so many inputs, the same ones every time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings

from benchmarks.fuzz.targets import Target


def run(target: Target, inputs: int, start: int = 1, count: Callable[[], None] | None = None) -> None:
    """Check so many inputs; the smallest one that breaks the promise is raised with its error.

    Parameters
    ----------
    target : Target
    inputs : int
        How many.
    start : int
        Seed of the generator.
    count : callable, optional
        Called once per input, for progress.
    """

    def one(data: Any) -> None:
        if count is not None:
            count()
        target.check(data)

    checked = given(target.strategy())(one)
    seeded = seed(start)(checked)
    settings(
        max_examples=inputs,
        deadline=None,
        database=None,
        phases=(Phase.explicit, Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )(seeded)()
