"""A commissioning disturbed at random instants: torque without a monitor, sentences that are not true."""

from __future__ import annotations

from typing import Any

from benchmarks.chaos.instants import disturb
from benchmarks.chaos.pool import side_by_side
from benchmarks.figure import figure

INSTANTS = 300
#: Pieces with seeds of their own, so many at a time.
PIECES, JOBS = 10, 2


def figures(scope: Any) -> dict[str, dict]:
    """Disturb and look."""
    count = scope.count(INSTANTS)
    piece = -(-count // PIECES)
    bar = scope.bar("instants of a commissioning", piece * PIECES)
    all_seen = []
    for _, seen in side_by_side(disturb, [(piece, seed) for seed in range(1, PIECES + 1)], JOBS):
        all_seen.append(seen)
        bar.step(piece)
        scope.complain(seen.complaints)
    total = {
        name: sum(getattr(seen, name) for seen in all_seen) for name in all_seen[0].__slots__ if name != "complaints"
    }
    longest_s = max(seen.unmonitored_s for seen in all_seen)
    return {
        "commissioning: instants": figure(
            total["runs"],
            f">= {count}",
            f"{total['powered']} under power, {total['asked']} with a question open, {total['again']} run again",
        ),
        "torque without a monitor for longer than heartbeat and stop": figure(
            total["unmonitored"], "== 0", f"longest without SYNC {longest_s:.2f} s"
        ),
        "torque while a question was open": figure(total["prompts"], "== 0"),
        "sentences about the arm that were not true": figure(total["untrue"], "== 0", f"of {total['sentences']}"),
    }
