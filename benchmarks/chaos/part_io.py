"""Input and output that fail beside the motion: terminal, frame log, adapter, malformed frames, SDO answers."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any

from benchmarks.chaos.io_faults import KINDS, play_again
from benchmarks.chaos.remote import Remote, remote
from benchmarks.chaos.rig import Rig, rig
from benchmarks.figure import figure

SEEDS = 3
PERIOD_S = 0.02


def figures(scope: Any) -> dict[str, dict]:
    """All kinds, in both pacings."""
    out: dict[str, dict] = {}
    drives_in: dict[str, Callable[[], AbstractContextManager[Rig | Remote]]] = {
        "lockstep": rig,
        "real": partial(remote, PERIOD_S),
    }
    seeds = scope.count(SEEDS)
    for pacing, made in drives_in.items():
        bar = scope.bar(f"input and output that fail, {pacing}", seeds * len(KINDS))
        with made() as drives:
            for kind in KINDS:
                wrong, again = 0, 0
                for seed in range(seeds):
                    complaints, tries = play_again(drives, kind, seed)
                    again += tries
                    wrong += bool(complaints)
                    scope.complain(complaints, f"{kind}, {pacing}, seed {seed}")
                    bar.step()
                detail = f"of {seeds}" + (f"; {again} begun again, this computer kept no time" if again else "")
                out[f"{kind}, {pacing}: not as stated"] = figure(wrong, "== 0", detail)
    return out
