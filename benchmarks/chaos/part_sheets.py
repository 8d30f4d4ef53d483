"""1 000 mutated data sheets: values that are read otherwise than stated and not named, crashes, time of reading."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.chaos.mutated_sheets import mutated
from benchmarks.chaos.sheet_judge import judged
from benchmarks.figure import figure

SHEETS = 1_000
LONGEST_S = 1.0


def figures(scope: Any) -> dict[str, dict]:
    """Write, read and judge every sheet; the seeds are 0 to 999."""
    count = scope.count(SHEETS)
    bar = scope.bar("data sheets", count)
    unreported = crashed = delayed = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(count):
            sheet = mutated(seed)
            try:
                words, duration_s = judged(sheet, Path(folder))
            except Exception as error:
                crashed += 1
                scope.print(f"sheet {seed} ({', '.join(sheet.what)}): {type(error).__name__}: {error}", markup=False)
            else:
                unreported += bool(words)
                delayed += duration_s > LONGEST_S
                if words:
                    scope.print(f"sheet {seed} ({', '.join(sheet.what)}): {'; '.join(words)}", markup=False)
            bar.step()
    return {
        "mutated data sheets": figure(count, ">= 0"),
        "mutated data sheets, a value differs and is not named": figure(unreported, "== 0"),
        "mutated data sheets, crash": figure(crashed, "== 0"),
        "mutated data sheets, over 1 s": figure(delayed, "== 0"),
    }
