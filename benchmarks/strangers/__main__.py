"""Draw files as strangers bring them, and judge what becomes of each; print the figures, write `summary.json`.

python -m benchmarks.strangers [PART ...] [--out out/strangers]

A part is a module of this package with `figures()`; all of them without a name.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.figure import conclude
from benchmarks.program import figures_of, options

PARTS = sorted(path.stem for path in Path(__file__).parent.glob("[a-z]*.py"))


def main() -> int:
    """Exit 1 when a goal is missed."""
    arguments = options(__doc__, "out/strangers", parts=PARTS).parse_args()
    return conclude(figures_of("strangers", arguments.parts), arguments.out)


if __name__ == "__main__":
    raise SystemExit(main())
