"""Blind tests of `diagnose` on drawn cells: one cell a seed, scored against its truth.

python -m benchmarks.blind [--tier drawn|nature] [--seeds dev|test|fresh] [--out out/blind] [--jobs N].

Tier `drawn`, by the simulator's own draws (--limit N, --bus N): development seeds are 0 to 399, and from there to 9999
where more are needed (--first). Test seeds are 10000 to 10999; fresh seeds for a changed model are 20000 to 20999. Both
are run once for the published table and never tuned on.
Tier `nature` (--cells N --diagnosed N --effects N --conditions NAME,..): development seeds from 0, test seeds from
30000, fresh seeds from 96000.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.program import one_thread, options, run

SEEDS = {"dev": range(10000), "test": range(10000, 11000), "fresh": range(20000, 21000)}
COUNT = {"dev": 400, "test": 1000, "fresh": 1000}


def main() -> int:
    """Run the cells over two processes; exit 1 when a goal is missed."""
    parser = options(__doc__, None, jobs=2)
    parser.add_argument("--tier", choices=("drawn", "nature"), default="drawn")
    parser.add_argument("--seeds", choices=sorted(SEEDS), default="dev")
    parser.add_argument("--limit", type=int, default=None, help="so many cells (dev 400, test and fresh 1000)")
    parser.add_argument("--first", type=int, default=0, help="skip so many cells")
    parser.add_argument("--bus", type=int, default=12, help="cells over the bus, from start to report")
    parser.add_argument("--cells", type=int, default=400, help="nature: arms of each condition")
    parser.add_argument("--diagnosed", type=int, default=None, help="nature: so many of them diagnosed too (all)")
    parser.add_argument("--effects", type=int, default=600, help="nature: arms with an effect beyond nuisances")
    parser.add_argument("--conditions", default=None, help="nature: names with commas (all)")
    parser.add_argument("--timed", type=int, default=20, help="nature: number of timed diagnoses of 40 poses")
    arguments = parser.parse_args()
    one_thread()
    if arguments.tier == "nature":
        from benchmarks.blind.nature_tier import run_nature

        return run_nature(arguments, arguments.out or Path("out/blind-nature"))
    seeds = list(SEEDS[arguments.seeds])[arguments.first :][: arguments.limit or COUNT[arguments.seeds]]
    out = arguments.out or Path("out/blind")
    from benchmarks.blind.bus import run_bus_cell
    from benchmarks.blind.cells import run_cell

    cells = run(run_cell, seeds, arguments.jobs, out / "cells.jsonl")
    first = list(SEEDS[arguments.seeds])[: arguments.bus]
    over_bus = run(run_bus_cell, [(seed, str(out / "bus")) for seed in first], arguments.jobs, out / "bus.jsonl")
    return report(cells, over_bus, out)


def report(cells: list[dict], over_bus: list[dict], out: Path) -> int:
    """Print the confusion matrix, the weakest cells and the figures, write summary.json."""
    from benchmarks.blind.figures import bus_figures, confusion, figures, there_and_said, weakest
    from benchmarks.blind.strict_figures import strict_figures
    from benchmarks.figure import conclude, print_table

    rows = confusion(cells)
    print_table(("what is there", "what was said", "cells"), rows, "confusion")
    columns = ("seed", "what is there", "strength", "what was said")
    print_table(columns, weakest(cells), "weakest: not exactly what is there")
    if over_bus:
        runs = [(cell["seed"], cell["cell"], *there_and_said(cell), f"{cell['time_s']:.0f}") for cell in over_bus]
        print_table(("seed", "cell", "what is there", "what was said", "s"), runs, "over the bus")
    result = figures(cells) | strict_figures(cells) | bus_figures(over_bus)
    confused = [{"there": there, "said": said, "cells": count} for there, said, count in rows]
    return conclude(result, out, confusion=confused, bus=over_bus)


if __name__ == "__main__":
    raise SystemExit(main())
