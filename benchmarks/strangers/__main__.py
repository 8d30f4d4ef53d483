"""Draw files as strangers bring them, and judge what becomes of each; print the figures, write `summary.json`.

python -m benchmarks.strangers [PART ...] [--out out/strangers]

A part is a module of this package with `figures()`; all of them without a name.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path

from benchmarks.figure import conclude

PARTS = sorted(path.stem for path in Path(__file__).parent.glob("[a-z]*.py"))


def main(argv: list[str]) -> int:
    """Exit 1 when a goal is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.strangers", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--out", type=Path, default=Path("out/strangers"))
    arguments = parser.parse_args(argv)
    unknown = set(arguments.parts) - set(PARTS)
    if unknown:
        parser.error(f"{', '.join(sorted(unknown))}: parts are {', '.join(PARTS)}")
    figures: dict[str, dict] = {}
    for part in arguments.parts or PARTS:
        figures |= importlib.import_module(f"benchmarks.strangers.{part}").figures()
    return conclude(figures, arguments.out)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
