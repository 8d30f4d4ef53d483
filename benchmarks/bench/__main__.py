"""Print every figure of speed and accuracy with its goal, and write them to `summary.json`.

python -m benchmarks.bench [--out out/bench] [wire] [regressor] [estimation]
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

from benchmarks.figure import conclude

PARTS = ("regressor", "estimation", "wire")


def main(argv: list[str]) -> int:
    """Run the named parts (all by default); exit 1 when a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bench", description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="parts to run; all by default")
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    arguments = parser.parse_args(argv)
    figures: dict[str, dict] = {}
    for part in arguments.parts or PARTS:
        figures |= importlib.import_module(f"benchmarks.bench.{part}").figures()
    return conclude(figures, arguments.out)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
