"""Many robots over months: ingest, questions, drift, false alarms, re-estimation, memory.

python -m benchmarks.fleet [--out out/fleet] [--robots 1000] [--recordings 40] [drifts] [recordings]

The analysis of 1000 robots and 2000 recordings take an hour and more on two processors; by default 40 recordings are
re-estimated, which is enough to tell how it scales.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from benchmarks.bench.__main__ import show
from benchmarks.fleet import drifts, recordings

PARTS = ("drifts", "recordings")


def main(argv: list[str]) -> int:
    """Run the named parts (all by default); exit 1 when a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fleet", description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="parts to run; all by default")
    parser.add_argument("--out", type=Path, default=Path("out/fleet"))
    parser.add_argument("--robots", type=int, default=1000, help="simulated robots, a check a day for a year each")
    parser.add_argument("--analysed", type=int, help="robots of which drifts are looked for; all by default")
    parser.add_argument("--recordings", type=int, default=40, help="recordings that are estimated anew")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(argv)
    figures: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        if "drifts" in (given.parts or PARTS):
            store, told = drifts.filled(place / "store", given.seed, given.robots, place / "tables")
            figures |= told | drifts.questions(store)
            few = given.analysed or given.robots
            if few < given.robots:
                store = drifts.filled(place / "few", given.seed, few, place / "few-tables")[0]
            figures |= drifts.drifts(store, given.seed, few)
        if "recordings" in (given.parts or PARTS):
            figures |= recordings.scaling(place, given.recordings)
            figures |= recordings.killed(place, given.recordings)
            figures |= recordings.memory(place, max(given.recordings // 2, 4))
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "summary.json").write_text(json.dumps({"figures": figures}, indent=1) + "\n")
    show(figures)
    return 0 if all(figure["met"] is not False for figure in figures.values()) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
