"""Every kind of fault, three seeds, in lockstep and in real time."""

from __future__ import annotations

import re
import time
from collections.abc import Collection, Iterator, Sequence
from typing import Any, Final

from benchmarks.chaos.evidence import Outcome
from benchmarks.chaos.pool import side_by_side
from benchmarks.chaos.remote import remote
from benchmarks.chaos.rig import rig
from benchmarks.chaos.scenarios import STRICT, kinds, play_again
from benchmarks.figure import figure
from sim.faults import KINDS

SEEDS = 3
PERIOD_S = 0.02
PACINGS: Final = ("lockstep", "real")
#: In lockstep nothing depends on the clock: so many are played at a time, kinds dealt out in so many hands a seed.
JOBS, HANDS = 2, 4
#: Kinds whose rows are printed one by one: faults outside monitoring, and other bus participants.
NAMED: Final = (
    *(kind for kind, about in KINDS.items() if about.starts in ("in brakes", "between runs")),
    "second_master_slow",
    "nmt_preoperational",
    "not_following",
    "write_ignored",
)


def figures(scope: Any) -> dict[str, dict]:
    """Play all; what did not end as stated is printed."""
    seeds = range(1, scope.count(SEEDS) + 1)
    played = [kind for kind in kinds() if not scope.kinds or kind in scope.kinds]
    bar = scope.bar("fault scenarios", len(PACINGS) * len(played) * len(seeds))
    outcomes: list[Outcome] = []
    began_s = time.monotonic()
    for play_all in (_in_lockstep, _by_the_clock):
        for outcome in play_all(played, seeds):
            outcomes.append(outcome)
            bar.step()
            complain(scope, outcome)
    minutes = (time.monotonic() - began_s) / 60.0
    rows = by_kind(outcomes, scope.kinds or NAMED)
    if scope.kinds:
        return rows
    return summary(outcomes, len(played)) | rows | {"scenarios, time": figure(minutes, "<= 25", "min")}


def by_kind(outcomes: list[Outcome], named: Collection[str]) -> dict[str, dict]:
    """One row a kind and pacing, of those that are named."""
    rows: dict[str, dict] = {}
    for kind in named:
        for pacing in PACINGS:
            here = [each for each in outcomes if (each.kind, each.pacing) == (kind, pacing)]
            again = sum(each.tries - 1 for each in here)
            detail = f"of {len(here)}" + (f"; {again} begun again, this computer kept no time" if again else "")
            rows[f"{kind}, {pacing}: not as stated"] = figure(sum(not each.fine for each in here), "== 0", detail)
    return rows


def hand(played: Sequence[str], seed: int) -> list[Outcome]:
    """Some kinds in lockstep, on drives of their own."""
    with rig() as made:
        return [play_again(made, kind, seed) for kind in played]


def _in_lockstep(played: Sequence[str], seeds: Sequence[int]) -> Iterator[Outcome]:
    hands = [(played[number::HANDS], seed) for seed in seeds for number in range(HANDS)]
    for _, outcomes in side_by_side(hand, hands, JOBS):
        yield from outcomes


def _by_the_clock(played: Sequence[str], seeds: Sequence[int]) -> Iterator[Outcome]:
    for seed in seeds:
        with remote(PERIOD_S) as made:
            for kind in played:
                yield play_again(made, kind, seed)


def complain(scope: Any, outcome: Outcome) -> None:
    """Print what was not as stated."""
    for complaint in outcome.complaints:
        text = re.sub(r"rig-[0-9a-f]+", "rig", complaint)
        about = f"{outcome.kind}, {outcome.pacing}, seed {outcome.seed}, try {outcome.tries}"
        scope.print(f"{about}: {text}", markup=False, highlight=False)


def summary(outcomes: list[Outcome], played: int) -> dict[str, dict]:
    """The figures of all outcomes."""
    safe = [each.safe for each in outcomes if each.safe is not None]
    recorded = sum(each.recorded for each in outcomes)
    found = {
        "fault kinds played": figure(played, ">= 40"),
        "axes moved on after a stop": figure(sum(each.moved for each in outcomes), "== 0"),
        "last axis safe after detection": figure(max(safe, default=0), "<= 5", "SYNC"),
        "values of another SYNC in finished visits": figure(
            sum(each.wrong for each in outcomes), "== 0", f"of {recorded}"
        ),
        "scenarios repeated, this computer kept no time": figure(sum(each.tries - 1 for each in outcomes), ">= 0"),
    }
    for pacing in PACINGS:
        here = [each for each in outcomes if each.pacing == pacing]
        bad = sum(not each.fine for each in here)
        moved = [kind for kind in STRICT if all(each.fine for each in here if each.kind == kind)]
        found[f"scenarios not as stated, {pacing}"] = figure(bad, "== 0", f"of {len(here)}")
        found[f"strict slaves configured and moved, {pacing}"] = figure(len(moved), f"== {len(STRICT)}")
    return found
