"""A million answers compared with the drives' own."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any

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
    with ProcessPoolExecutor(JOBS, mp_context=get_context("spawn")) as pool:
        for done in as_completed([pool.submit(many, piece, seed) for seed in range(1, PIECES + 1)]):
            verdicts.append(done.result())
            bar.step(piece)
    taken = sum(verdict.taken for verdict in verdicts)
    return {
        "answers taken under faults": figure(taken, f">= {answers}"),
        "wrong answers taken as good": figure(sum(verdict.wrong for verdict in verdicts), "== 0", f"of {taken}"),
        "answers to the SYNC before taken as good": figure(
            sum(verdict.stale for verdict in verdicts), ">= 0", f"of {taken}"
        ),
    }
