"""A million answers compared with the drives' own."""

from __future__ import annotations

from typing import Any

from benchmarks.chaos.pool import side_by_side
from benchmarks.chaos.truth import Verdict, many
from benchmarks.figure import figure

ANSWERS = 1_000_000
#: Pieces with seeds of their own, so many at a time: all in lockstep.
PIECES, JOBS = 20, 2


def figures(scope: Any) -> dict[str, dict]:
    """Compare."""
    answers = scope.count(ANSWERS)
    piece = -(-answers // PIECES)
    bar = scope.bar("answers under faults", answers)
    verdicts: list[Verdict] = []
    for _, verdict in side_by_side(many, [(piece, seed) for seed in range(1, PIECES + 1)], JOBS):
        verdicts.append(verdict)
        bar.step(piece)
    taken = sum(verdict.taken for verdict in verdicts)
    return {
        "answers taken under faults": figure(taken, f">= {answers}"),
        "wrong answers taken as good": figure(sum(verdict.wrong for verdict in verdicts), "== 0", f"of {taken}"),
        "answers to the SYNC before taken as good": figure(
            sum(verdict.stale for verdict in verdicts), ">= 0", f"of {taken}"
        ),
    }
