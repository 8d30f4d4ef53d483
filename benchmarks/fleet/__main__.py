"""Many robots over months: ingest, questions, drift, false alarms, re-estimation, memory.

python -m benchmarks.fleet [--out out/fleet] [--robots 1000] [--analysed 1000] [--recordings 2000]
    [store] [drifts] [unlike] [recordings]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks import program
from benchmarks.figure import conclude
from benchmarks.fleet import drifts, recordings

PARTS = ("store", "drifts", "unlike", "recordings")
#: Standard deviation of the logarithm of random walk over noise, in a heterogeneous fleet.
HETEROGENEITY_STD = 0.5


def _drifts(place: Path, plant: drifts.Plant) -> dict[str, dict]:
    """Return the drifts that are detected in a year of these robots."""
    return drifts.drifts(drifts.filled(place / "store", plant, place / "tables")[0], plant)


def _parts(place: Path, options: argparse.Namespace) -> dict[str, dict]:
    """Figures of the parts that are asked for."""
    parts, figures = options.parts, {}
    analysed = options.analysed or options.robots
    if "store" in parts:
        drawn_plant = drifts.Plant(options.seed, options.robots)
        store, figures = drifts.filled(place / "whole" / "store", drawn_plant, place / "whole" / "tables")
        figures |= drifts.questions(store)
    if "drifts" in parts:
        figures |= _drifts(place / "drifts", drifts.Plant(options.seed, analysed))
    if "unlike" in parts:
        found = _drifts(place / "unlike", drifts.Plant(options.seed + 1, analysed, HETEROGENEITY_STD))
        figures |= {f"heterogeneous robots: {name}": counted for name, counted in found.items()}
    if "recordings" in parts:
        figures |= recordings.figures(place / "recordings", options.recordings)
    return figures


def main() -> int:
    """Run the named parts (all by default); exit 1 when a goal is missed."""
    parser = program.options(__doc__, "out/fleet", parts=PARTS)
    parser.add_argument("--robots", type=int, default=1000, help="simulated robots, a check a day for a year each")
    parser.add_argument("--analysed", type=int, help="robots of which drifts are looked for; all by default")
    parser.add_argument("--recordings", type=int, default=2000, help="recordings that are estimated again")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        figures = _parts(Path(name), options)
    return conclude(figures, options.out)


if __name__ == "__main__":
    raise SystemExit(main())
