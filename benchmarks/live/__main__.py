"""The live page: frames a second, sample to screen, what it costs, what it causes, and the stop button.

python -m benchmarks.live [--out out/live] [--minutes 8] [--clicks 12] [--alone] [cost] [seen] [stopped] ..
"""

from __future__ import annotations

from benchmarks.figure import conclude, write
from benchmarks.live import cost, parts
from benchmarks.program import options

PARTS = ("cost", "seen", "stopped", "mistreated", "paired")
#: How long the page is looked at [s].
SEEN_S = 20.0


def main() -> int:
    """Run the named parts (all by default); exit 1 when a goal is missed."""
    parser = options(__doc__, "out/live", parts=PARTS)
    parser.add_argument("--minutes", type=float, default=8.0, help="of paired runs")
    parser.add_argument("--clicks", type=int, default=12)
    parser.add_argument(
        "--alone",
        action="store_true",
        help="browser and page under a real-time scheduler, as on a computer that does nothing else",
    )
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    jobs = {
        "cost": cost.figures,
        "seen": lambda: parts.seen(out, SEEN_S, alone=arguments.alone),
        "stopped": lambda: parts.stopped(out, arguments.clicks, alone=arguments.alone),
        "mistreated": lambda: parts.mistreated(out),
        "paired": lambda: parts.paired(out, arguments.minutes),
    }
    figures: dict[str, dict] = {}
    for part in arguments.parts:
        figures |= jobs[part]()
        write(figures, out)
    return conclude(figures, out)


if __name__ == "__main__":
    raise SystemExit(main())
