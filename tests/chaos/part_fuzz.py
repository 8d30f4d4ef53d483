"""The full number of inputs from strangers."""

from __future__ import annotations

from typing import Any

from tests.chaos.figure import figure
from tests.fuzz.runner import run
from tests.fuzz.targets import TARGETS

INPUTS = {"decoder": 100_000, "reader": 10_000}
#: An input that breaks a promise ends the run of its target: the figure is then 1, with the input printed.
CHUNK = 5_000


def figures(scope: Any) -> dict[str, dict]:
    """Feed every decoder and reader."""
    escapes = 0
    fed = {"decoder": 0, "reader": 0}
    for target in TARGETS:
        inputs = scope.count(round(INPUTS[target.kind] * target.share))
        bar = scope.bar(f"fuzz {target.name}", inputs)
        try:
            for start in range(0, inputs, CHUNK):
                run(target, min(CHUNK, inputs - start), start=start + 1)
                bar.step(min(CHUNK, inputs - start))
                fed[target.kind] += min(CHUNK, inputs - start)
        except Exception as error:
            escapes += 1
            notes = " ".join(getattr(error, "__notes__", ()))[:2000]
            scope.print(f"{target.name}: {type(error).__name__}: {error} {notes}", markup=False)
    return {
        "fuzzed inputs, decoders": figure(fed["decoder"], ">= 0"),
        "fuzzed inputs, file readers": figure(fed["reader"], ">= 0"),
        "fuzzed inputs that escaped": figure(escapes, "== 0"),
    }
