"""A million answers compared with the drives' own."""

from __future__ import annotations

from typing import Any

from tests.chaos.figure import figure
from tests.chaos.truth import million

ANSWERS = 1_000_000


def figures(scope: Any) -> dict[str, dict]:
    """Compare."""
    answers = scope.count(ANSWERS)
    bar = scope.bar("answers under faults", answers)
    verdict = million(answers, progress=bar.step)
    return {
        "answers taken under faults": figure(verdict.taken, f">= {answers}"),
        "wrong answers taken as good": figure(verdict.wrong, "== 0", f"of {verdict.taken}"),
        "answers to the SYNC before taken as good": figure(verdict.stale, ">= 0", f"of {verdict.taken}"),
    }
