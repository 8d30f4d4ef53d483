"""The full number of inputs from strangers, on all cores."""

from __future__ import annotations

from typing import Any

from benchmarks.chaos.pool import side_by_side
from benchmarks.figure import figure
from benchmarks.fuzz.runner import run
from benchmarks.fuzz.targets import TARGETS

INPUTS = {"decoder": 100_000, "reader": 10_000}
#: An input that breaks a promise ends its piece of the run: it is counted, and printed.
CHUNK = 2_000


def figures(scope: Any) -> dict[str, dict]:
    """Feed every decoder and reader."""
    pieces: list[tuple[int, int, int]] = []
    for number, target in enumerate(TARGETS):
        inputs = scope.count(round(INPUTS[target.kind] * target.share))
        pieces += [(number, start + 1, min(CHUNK, inputs - start)) for start in range(0, inputs, CHUNK)]
    bar = scope.bar("fuzz [inputs]", sum(count for _, _, count in pieces))
    escapes = 0
    fed = {"decoder": 0, "reader": 0}
    for (number, _, count), escape in side_by_side(feed, pieces):
        if escape:
            escapes += 1
            scope.print(escape, markup=False)
        else:
            fed[TARGETS[number].kind] += count
        bar.step(count)
    return {
        "fuzzed inputs, decoders": figure(fed["decoder"], ">= 0"),
        "fuzzed inputs, file readers": figure(fed["reader"], ">= 0"),
        "fuzzed inputs that escaped": figure(escapes, "== 0"),
    }


def feed(number: int, start: int, count: int) -> str:
    """Feed a piece of the inputs of a target; what escaped, "" if nothing did."""
    target = TARGETS[number]
    try:
        run(target, count, start=start)
    except Exception as error:
        notes = " ".join(getattr(error, "__notes__", ()))[:2000]
        return f"{target.name}: {type(error).__name__}: {error} {notes}"
    return ""
