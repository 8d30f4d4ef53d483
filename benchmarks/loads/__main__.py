"""Loads head to head: the gateway, plain least squares, FIGAROH and MuJoCo sysid on the same cells.

python -m benchmarks.loads [--seeds development|test|FIRST:END] [--cells N] [--motion N] [--methods NAMES]
    [--out out/loads]

Of each seed range so many cells are drawn at rest and in motion. Every method answers in a process of its own. The test
seeds are run once for the published table and never tuned on.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

from benchmarks import program


def main() -> int:
    """Draw the cells, let every method answer, print one table for rest and one for motion."""
    parser = program.options(__doc__, "out/loads")
    parser.add_argument("--seeds", default="development", help="development, test or FIRST:END")
    parser.add_argument("--cells", type=int, default=60, help="cells at rest")
    parser.add_argument("--motion", type=int, default=20, help="cells in motion")
    parser.add_argument("--methods", default="", help="comma-separated beginnings of method names (all)")
    parser.add_argument("--answer", nargs=2, metavar=("METHOD", "FOLDER"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    program.one_thread()
    if options.answer:
        from benchmarks.loads.methods import answer_cells

        answer_cells(options.answer[0], Path(options.answer[1]))
        return 0
    return _run(options)


def _run(options: argparse.Namespace) -> int:
    from benchmarks.loads.cells import FIRST, MOTION, REST, write_moving_cells, write_rest_cells
    from benchmarks.loads.methods import METHODS
    from benchmarks.naming.score import print_columns

    if options.seeds in FIRST:
        seeds = range(FIRST[options.seeds], FIRST[options.seeds] + max(options.cells, options.motion))
    elif re.fullmatch(r"\d+:\d+", options.seeds):
        seeds = program.seed_range(options.seeds)
    else:
        raise SystemExit(f"--seeds {options.seeds}: {', '.join(FIRST)} or FIRST:END")
    methods = [name for name in METHODS if name.startswith(tuple(options.methods.split(",")))]
    writers = {REST: (write_rest_cells, options.cells), MOTION: (write_moving_cells, options.motion)}
    columns = {}
    for kind, (write, count) in writers.items():
        if count:
            write(seeds[:count], options.out / kind)
            columns[kind] = {name: _answered(name, options.out / kind) for name in methods}
            print_columns(kind, columns[kind])
    (options.out / "summary.json").write_text(json.dumps(columns, indent=1) + "\n", encoding="utf-8")
    return 0


def _answered(method: str, folder: Path) -> dict[str, str]:
    """Scores of a method that answers in a new process."""
    from benchmarks.loads.methods import answers_file, memory_file
    from benchmarks.loads.score import scores
    from benchmarks.naming.answers import read_answers
    from benchmarks.naming.score import read_truth

    subprocess.run([sys.executable, "-m", "benchmarks.loads", "--answer", method, str(folder)], check=True)
    memory_mib = json.loads(memory_file(folder, method).read_text(encoding="utf-8"))
    return scores(read_truth(folder / "truth"), read_answers(answers_file(folder, method)), memory_mib)


if __name__ == "__main__":
    raise SystemExit(main())
