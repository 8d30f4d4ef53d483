"""Print every figure of speed and accuracy with its goal, and write them to `summary.json`.

python -m benchmarks.bench [--out out/bench] [wire] [regressor] [estimation]
"""

from __future__ import annotations

from benchmarks.figure import conclude
from benchmarks.program import figures_of, options

PARTS = ("regressor", "estimation", "wire")


def main() -> int:
    """Run the named parts (all by default); exit 1 when a goal is missed."""
    arguments = options(__doc__, "out/bench", parts=PARTS).parse_args()
    return conclude(figures_of("bench", arguments.parts), arguments.out)


if __name__ == "__main__":
    raise SystemExit(main())
